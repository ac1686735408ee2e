"""A distribution of normals without a formula: what it can be, and how it judges those that have one."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import nnls

from invrender.brdf.form import Angles, LobeForm
from invrender.brdf.lobes import BECKMANN, GGX_FORM, PLASTICS
from invrender.brdf.microfacet import Microfacet
from invrender.brdf.richer import HAZY, TABULATED, core_width, facet_density, tabulated
from invrender.estimate.explanation import explain
from invrender.estimate.solution import solution_of
from invrender.output.report.pictures import normals_figure

ANGLES = np.linspace(0, 180, 8)


def test_a_table_of_gaussians_is_long_tailed_if_need_be() -> None:
    # GGX is a sum of Gaussians of slopes, by Bernstein's theorem; five of them an octave apart come within 4% of its
    # peak's radiance everywhere, and within a tenth of it itself to eight times its width.
    theta = np.geomspace(1e-3, 0.4, 200)
    widths = 0.03 * 2.0 ** np.arange(5)
    angles = Angles(theta, np.cos(theta), np.cos(theta), np.ones_like(theta))
    lobes = np.stack([BECKMANN.shape(angles, width) for width in widths], axis=1)
    truth = GGX_FORM.shape(angles, 0.05)
    shares = nnls(lobes / truth[:, None], np.ones_like(theta))[0]
    assert np.abs(lobes @ shares - truth).max() < 0.04 * truth.max()
    assert np.abs(lobes @ shares / truth - 1).max() < 0.15


def test_any_base_of_a_form_has_a_table_above_it() -> None:
    coated, under = TABULATED.values()
    assert (coated.coat is None, coated.interface, under.interface) == (False, False, True)
    assert tabulated(GGX_FORM) == (coated,)
    assert tabulated(PLASTICS[GGX_FORM]) == (coated, under)


@pytest.mark.parametrize("beyond", [0.0, 0.3, 0.8])
def test_a_table_is_the_sum_of_its_parts_and_falls(beyond: float) -> None:
    numbers = {"beyond": beyond, "beyond_2": 0.5, "beyond_4": 0.2, "beyond_8": 0.9}
    form = TABULATED[BECKMANN].with_numbers(numbers)
    shares, widths = np.transpose(form.parts)
    assert_allclose(widths, [1, 2, 4, 8, 16])
    assert_allclose(shares.sum(), 1)
    assert_allclose(shares[1:].sum(), beyond)
    theta = np.linspace(0, 0.5, 300)
    # The viewer along the facets' half vector: the shape is the density, but for factors that don't rise.
    angles = Angles(theta, np.cos(theta), np.cos(theta), np.ones_like(theta))
    expected = sum(s * BECKMANN.shape(angles, min(w * 0.01, 0.3)) for s, w in form.parts)
    assert_allclose(form.shape(angles, 0.01), expected, rtol=1e-12)
    density = sum(s * BECKMANN.density(theta, w * 0.01) for s, w in form.parts)
    assert (np.diff(density) <= 0).all()


def test_a_sum_is_as_wide_as_its_core() -> None:
    assert core_width(GGX_FORM, 0.1, GGX_FORM) == 1.0
    # Far wider lobes don't widen it much.
    hazy = HAZY[GGX_FORM].with_numbers({"haze": 0.3, "spread": 10.0})
    assert core_width(hazy, 0.02, GGX_FORM) == pytest.approx(1, rel=0.01)
    # All of the table at twice sigma; slopes are tangents, so that twice as wide is twice the angle to sigma^2 only.
    twice = TABULATED[BECKMANN].with_numbers(
        {"beyond": 1.0, "beyond_2": 0.0, "beyond_4": 0.0, "beyond_8": 0.0}
    )
    assert core_width(twice, 0.02, BECKMANN) == pytest.approx(2.0, rel=3e-3)
    # GGX falls to half its height at 0.6436 sigma, a Gaussian at 0.8326.
    assert core_width(twice, 0.02, GGX_FORM) == pytest.approx(2 * 0.8326 / 0.6436, rel=3e-3)


@pytest.mark.slow
def test_what_no_formula_has_is_tabulated(bench) -> None:
    # Three lobes, the middle one the weakest: no haze around a core, and no plastic.
    numbers = {"coat": 0.5, "beyond": 0.6, "beyond_2": 1.0, "beyond_4": 0.7, "beyond_8": 0.0}
    truth = Microfacet(
        np.array([0.2, 0.15, 0.1]), np.full(3, 0.06), 1.5, 0.02, TABULATED[BECKMANN].with_numbers(numbers)
    )
    told = bench.known_lighting()
    photos = bench.predicted_photographs(truth, ANGLES, told, 160)
    known = explain(bench.with_noise(photos, np.random.default_rng(0)), [told])
    solution = solution_of(known, [told])
    assert solution.estimate.brdf.form.family is truth.form.family
    assert solution.candidates[solution.chosen].error < 0.8 * min(
        candidate.error
        for candidate in solution.candidates
        if candidate.estimate.model.form.family is not truth.form.family
    )
    for name in ("kd", "ks"):
        found = solution.quantities[name]
        assert (np.abs(found.value - getattr(truth, name)) < 4 * found.std).all(), name
    # The facets' distribution itself, where its lobes may stand in for each other.
    theta = np.linspace(0, 0.3, 100)
    angles = Angles(theta, np.cos(theta), np.cos(theta), np.ones_like(theta))
    found, true = (
        brdf.ks[0] * brdf.form.shape(angles, brdf.sigma) for brdf in (solution.estimate.brdf, truth)
    )
    assert np.abs(found - true).max() < 0.05 * true.max()
    figure = normals_figure(solution.candidates, solution.chosen)
    assert figure is not None
    lines = figure.axes[0].lines
    assert [line.get_linestyle() for line in lines].count("--") == 1
    assert len(lines) == 2
    assert normals_figure(solution.candidates[:1], 0) is None


@pytest.mark.parametrize("form", [GGX_FORM, BECKMANN, HAZY[GGX_FORM], TABULATED[BECKMANN]])
def test_facets_cover_the_surface_once(form: LobeForm) -> None:
    # Of any distribution of normals the projected area is that of the surface [Walter et al. 2007, eq. 4].
    theta = np.linspace(0, np.pi / 2, 20_001)
    integrand = facet_density(form, theta, 0.05) * np.cos(theta) * 2 * np.pi * np.sin(theta)
    # Gaussian slopes of the widest part reach the horizon; trapezoids of a ten-thousandth of a radian.
    assert np.trapezoid(integrand, theta) == pytest.approx(1, abs=2e-4)
