"""Damped Gauss-Newton steps on a state that is no vector."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from capture.gaussnewton import LocalProblem, damped_step, gauss_newton

Floats = NDArray[np.float64]
TRUTH = Rotation.from_rotvec([0.5, -1.0, 1.4])
ARROWS = np.random.default_rng(3).normal(size=(30, 3))
NOISE = np.random.default_rng(4).normal(size=(30, 3))


def residuals(std: float, rotation: Rotation) -> Floats:
    """Of arrows that a rotation should bring onto others, known to a standard deviation."""
    return ((TRUTH.apply(ARROWS) - rotation.apply(ARROWS)) / std + NOISE).ravel()


def rows(std: float, rotation: Rotation) -> Floats:
    return (np.cross(np.eye(3)[:, None], rotation.apply(ARROWS)).transpose(1, 2, 0) / std).reshape(-1, 3)


def about(std: float, rotation: Rotation) -> LocalProblem[Rotation]:
    slopes, left = rows(std, rotation), residuals(std, rotation)
    return LocalProblem(
        partial(damped_step, slopes.T @ slopes, slopes.T @ left),
        slopes.T @ left,
        lambda step: Rotation.from_rotvec(step) * rotation,
        lambda there: float(left @ left - residuals(std, there) @ residuals(std, there)),
    )


@pytest.mark.parametrize("std", [1e-6, 0.05])
def test_search_ends_within_a_share_of_the_standard_deviation(std: float) -> None:
    found = gauss_newton(Rotation.identity(), partial(about, std), least=1e-4, most_steps=50)
    best = least_squares(lambda vector: residuals(std, Rotation.from_rotvec(vector)), found.as_rotvec())
    off = rows(std, found) @ (Rotation.from_rotvec(best.x) * found.inv()).as_rotvec()
    assert off @ off < 1e-4
    # Nothing is promised there, and nothing tried.
    assert gauss_newton(found, partial(about, std), least=1e-4, most_steps=50) is found


def test_damping_rises_until_a_step_gains_and_falls_again() -> None:
    """Rosenbrock's valley: from (-1.2, 1) an undamped step makes the cost a hundred times as large."""
    dampings: list[float] = []

    def left(at: Floats) -> Floats:
        return np.array([-10 * (at[1] - at[0] ** 2), at[0] - 1])

    def valley(at: Floats) -> LocalProblem[Floats]:
        slopes = np.array([[-20 * at[0], 10], [-1, 0]])

        def step(damping: float) -> Floats:
            dampings.append(damping)
            return damped_step(slopes.T @ slopes, slopes.T @ left(at), damping)

        return LocalProblem(
            step,
            slopes.T @ left(at),
            lambda step: at + step,
            lambda there: float(left(at) @ left(at) - left(there) @ left(there)),
        )

    found = gauss_newton(np.array([-1.2, 1.0]), valley, least=1e-12, most_steps=100)
    np.testing.assert_allclose(found, [1, 1], atol=1e-5)
    assert max(dampings) > dampings[0]
    assert dampings[-1] < dampings[0]


def test_failed_steps_end_where_costs_cannot_be_compared() -> None:
    tried: list[Rotation] = []

    def blind(rotation: Rotation) -> LocalProblem[Rotation]:
        return replace(about(0.05, rotation), gain=lambda there: tried.append(there) or -1.0)

    start = Rotation.from_rotvec([1e-2, 0, 0]) * TRUTH
    assert gauss_newton(start, blind, 1e-4, 50, told_apart=1e3) is start
    assert len(tried) == 1
    # Otherwise damping rises until a step promises nothing.
    assert gauss_newton(start, blind, 1e-4, 50) is start
    assert len(tried) > 3


def test_parameters_without_information_stay() -> None:
    matrix, right = np.diag([4.0, 0.0, 1.0]), np.array([2.0, 3.0, 1.0])
    np.testing.assert_allclose(damped_step(matrix, right, 1.0), [0.25, 0.0, 0.5])
