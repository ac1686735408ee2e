"""The lobe's table against the reflection integral over incident directions."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from invrender.theory.brdfcoefficients import outgoing_coefficients
from invrender.theory.operator import view_frames
from invrender.transport.lobe_table import (
    TRANSFERS,
    at_cosines,
    lobe_table,
    over_angles,
    specular_radiance,
    specular_rows,
)
from recon.harmonics.basis import orders

from .quadrature import hemisphere_grid, reflected, scipy_harmonics
from .test_brdfcoefficients import rh01


@pytest.mark.parametrize("sigma", [0.02, 0.1, 0.3, 0.7])
def test_all_roughnesses_and_exitant_angles_are_those_of_the_integral(sigma: float):
    cos = np.array([1.0, 0.9, 0.5, 0.25, 0.15])
    found = at_cosines(over_angles(lobe_table(10).at_angles(sigma)), cos)[:, 0].T
    # By adaptive sums over incident directions: another rule in other variables.
    every = outgoing_coefficients(rh01(sigma, mu=None), 10, cos, tolerance=1e-8)
    expected = every[:, orders(10) >= 0]
    # Wide lobes at grazing angles are the hardest to interpolate between exitant angles.
    assert_allclose(found, expected, atol=2e-6 * np.abs(expected).max())


@pytest.mark.parametrize("sigma", [0.05, 0.4])
def test_slopes_are_those_of_finite_differences(sigma: float):
    table, cos, step = lobe_table(6), np.linspace(0.16, 1, 9), 1e-4
    before, found, after = (
        at_cosines(over_angles(table.at_angles(sigma * np.exp(way))), cos) for way in (-step, 0, step)
    )
    # The differences leave out what is of the third order in the step.
    slopes = (after - before)[:, 0] / (2 * step)
    assert_allclose(found[:, 1], slopes, atol=1e-6 * np.abs(found).max())


def test_rows_of_samples_yield_the_reflected_radiance(bench, rng):
    field = bench.sphere_field(40.0, samples=15)
    lighting = rng.normal(size=49)
    rows = field.mean_over_rays(specular_rows(field, 6, 0.15)[0])
    frames = view_frames(field.normals, field.views)
    local = np.einsum("nkj,nk->nj", frames, field.views)
    rays = reflected(
        rh01(0.15, mu=None),
        lambda ways: scipy_harmonics(ways, 6) @ lighting,
        frames,
        local,
        hemisphere_grid(60, 300),
    )
    expected = field.mean_over_rays(rays)
    # Rows are in single precision.
    assert_allclose(rows @ lighting, expected, atol=3e-6 * np.abs(expected).max())


@pytest.mark.parametrize(
    ("transfer", "factor"), [("mirror", lambda _: 1.0), ("filtered", lambda x: np.exp(-(x**2)))]
)
def test_coarser_transfers_are_light_in_the_mirror_direction(bench, transfer, factor):
    field, sigma = bench.sphere_field(40.0, samples=15), 0.15
    l = np.repeat(np.arange(7), 2 * np.arange(7) + 1)
    # Householder's reflection of each view at the plane through the normal's axis.
    mirrors = 2 * np.einsum("ni,nj->nij", field.normals, field.normals) - np.eye(3)
    at_mirror = scipy_harmonics(np.einsum("nij,nj->ni", mirrors, field.views), 6)
    rows, slopes = map(field.mean_over_rays, specular_rows(field, 6, sigma, transfer))
    assert_allclose(rows, field.mean_over_rays(at_mirror * factor(sigma * l)), atol=2e-6)
    ends = [factor(sigma * np.exp(way) * l) for way in (-1e-4, 1e-4)]
    assert_allclose(slopes, field.mean_over_rays(at_mirror * (ends[1] - ends[0]) / 2e-4), atol=2e-6)


def test_all_transfers_agree_on_a_narrow_lobe(bench, rng):
    field = bench.sphere_field(40.0, samples=40)
    field = field.where(field.cos_exitant > 0.6)
    light = rng.normal(size=(25, 3))
    exact, filtered, mirror = (specular_radiance(field, light, 0.01, transfer) for transfer in TRANSFERS)
    # Of order (sigma l)^2, which is 0.0016 at the highest degree.
    assert_allclose(mirror, exact, atol=0.004 * np.abs(exact).max())
    assert_allclose(filtered, exact, atol=0.004 * np.abs(exact).max())
