"""The one-standard-error rule."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import norm

from capture.selection import as_good, excess, plausibility, simplest


def test_standard_error_is_that_of_the_paired_difference() -> None:
    mean, error = excess(np.array([3.0, 7.0, 5.0]), np.array([1.0, 4.0, 4.0]))
    assert mean == pytest.approx(2.0)
    assert error == pytest.approx(1 / np.sqrt(3))


def test_fewest_parameters_win_among_candidates_within_one_standard_error() -> None:
    best = np.array([1.0, 5.0, 1.0, 5.0])
    near, far = best + np.array([0.3, -0.1, 0.3, -0.1]), best + np.array([0.3, 0.2, 0.3, 0.2])
    # The differences' means are 0.1 and 0.25, their standard errors 0.115 and 0.029.
    assert simplest([far, near, best], [1, 2, 3]) == 1
    assert simplest([best, near, far], [3, 2, 1]) == 1
    assert simplest([far, near, best], [1, 2, 3], negligible=0.3) == 0
    assert simplest([near, near, best], [2, 2, 3]) == 0


def test_paired_comparison_sees_what_unequal_groups_hide() -> None:
    best = np.array([1.0, 5.0, 1.0, 5.0])
    worse = 1.1 * best
    assert not as_good(worse, best)
    assert as_good(worse, best, standard_errors=3.0)
    assert as_good(worse, best, paired=False)


def test_single_group_has_no_standard_error() -> None:
    assert not as_good(np.array([1.1]), np.array([1.0]))
    assert as_good(np.array([1.0]), np.array([1.0]))


def test_rule_keeps_the_true_model_about_as_often_as_one_standard_error_says() -> None:
    """Of two equally good candidates the simpler is lost where the mean exceeds one standard error: 16%."""
    rng = np.random.default_rng(0)
    draws = [rng.normal(1, 0.3, (2, 40)) for _ in range(2000)]
    lost = np.mean([simplest(losses, [1, 2]) == 1 for losses in draws])
    assert lost == pytest.approx(0.16, abs=0.03)


def test_plausibility_is_the_ratio_of_likelihoods_of_paired_differences() -> None:
    rng = np.random.default_rng(3)
    best = rng.normal(5.0, 2.0, 9)
    losses = best + rng.normal(0.3, 0.4, 9)
    off = losses - best

    def likelihood(mean: float) -> float:
        return float(norm.logpdf(off, mean, np.sqrt(np.mean((off - mean) ** 2))).sum())

    assert_allclose(plausibility(losses, best), np.exp(likelihood(0.0) - likelihood(float(off.mean()))))
    assert plausibility(best, losses) == 1.0
    assert plausibility(np.array([1.1]), np.array([1.0])) == 0.0
