"""Transforms on lat-long grids against direct sums, and against ducc0."""

from __future__ import annotations

from pathlib import Path

import cv2
import ducc0
import numpy as np
import pytest
from numpy.testing import assert_allclose

from capture.lighting import latlong_directions
from recon.harmonics.basis import degrees, orders
from recon.harmonics.latlong import (
    analyse_latlong,
    highest_degree,
    map_coefficients,
    project_latlong,
    synthesise_latlong,
    theta_factors,
)

from .quadrature import scipy_harmonics


def from_ducc(coefficients: np.ndarray, l_max: int) -> np.ndarray:
    """Real coefficients in our order from ducc0's, which are complex and of m >= 0 only."""
    l, m = degrees(l_max), orders(l_max)
    found = coefficients[np.abs(m) * (2 * l_max + 1 - np.abs(m)) // 2 + l]
    part = np.where(m < 0, -found.imag, found.real)
    return np.where(m == 0, found.real, np.sqrt(2) * (-1.0) ** m * part)


def ducc_geometry(height: int) -> dict:
    # Pixel centres: Fejer's first rule, half a pixel off the meridian.
    return {"spin": 0, "geometry": "F1", "phi0": np.pi / (2 * height), "nthreads": 1}


@pytest.mark.parametrize("height", [1, 6, 7, 41, 64])
def test_functions_that_the_grid_carries_are_analysed_and_synthesised_exactly(height: int, rng):
    l_max = highest_degree(height)
    coefficients = rng.normal(size=((l_max + 1) ** 2, 2))
    directions = latlong_directions(height).reshape(-1, 3)
    values = (scipy_harmonics(directions, l_max) @ coefficients).reshape(height, 2 * height, 2)
    assert_allclose(synthesise_latlong(coefficients, height), values, atol=1e-11)
    assert_allclose(analyse_latlong(values, l_max), coefficients, atol=1e-12)


def test_one_degree_more_than_the_grid_carries_is_refused_for_good_reason(rng):
    # Products of degree 2 l = 8 are one too many for a rule of 8 rows, which is exact below degree 8.
    directions = latlong_directions(8).reshape(-1, 3)
    l, m = degrees(4), orders(4)
    zonal = scipy_harmonics(directions, 4)[:, (l == 4) & (m == 0)].reshape(8, 16, 1)
    assert abs(analyse_latlong(zonal, 3)).max() < 1e-14
    with pytest.raises(
        ValueError, match=r"l_max is 4; a lat-long grid of 8 rows carries degrees up to 3.*9 rows"
    ):
        analyse_latlong(zonal, 4)


@pytest.mark.parametrize("file", ["Grace_Cathedral.hdr", "uffizi.hdr", "pisa.hdr"])
def test_probes_have_the_coefficients_that_ducc_finds(file: str, data_dir: Path):
    image = cv2.imread(str(data_dir / "probes" / file), cv2.IMREAD_UNCHANGED)[..., ::-1].astype(float)
    height, l_max = len(image), 30
    # Sums with the weights of its own rule: its `analysis_2d` also drops from the map what l_max can't hold.
    weights = ducc0.sht.get_gridweights("F1", height) / (2 * height)
    found = analyse_latlong(image, l_max)
    for channel in range(3):
        weighted = np.ascontiguousarray((image[..., channel] * weights[:, None])[None])
        expected = ducc0.sht.adjoint_synthesis_2d(map=weighted, lmax=l_max, **ducc_geometry(height))
        assert_allclose(found[:, channel], from_ducc(expected[0], l_max), atol=1e-12 * np.abs(found).max())
    smooth = synthesise_latlong(found, height)
    exact = ducc0.sht.analysis_2d(
        map=np.ascontiguousarray(smooth[None, ..., 0]), lmax=l_max, **ducc_geometry(height)
    )
    assert_allclose(found[:, 0], from_ducc(exact[0], l_max), atol=1e-12 * np.abs(found).max())


def test_factors_in_theta_stay_normalised_at_high_degrees():
    node, weight = np.polynomial.legendre.leggauss(301)
    factors = theta_factors(node, 300)
    for m in (0, 1, 150, 300):
        gram = (factors[m, m:] * weight) @ factors[m, m:].T * (2 * np.pi if m == 0 else np.pi)
        assert_allclose(gram, np.eye(301 - m), atol=1e-11)


def test_a_coarse_maps_high_degrees_are_zero_where_asked_for(rng):
    radiance = rng.random((6, 12, 3))
    found = map_coefficients(radiance, 5)
    assert found.shape == (36, 3)
    assert_allclose(found[:9], project_latlong(radiance, 2), rtol=1e-14)
    assert not found[9:].any()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: analyse_latlong(np.zeros((8, 16, 1)), -1), "l_max is -1"),
        (lambda: analyse_latlong(np.zeros((8, 15, 1)), 1), r"\(H, 2H, channels\), not \(8, 15, 1\)"),
        (lambda: analyse_latlong(np.zeros((8, 16)), 1), r"not \(8, 16\)"),
        (
            lambda: project_latlong(np.full((8, 16, 1), np.nan), 1),
            "lat-long grid: 128 of 128 values are not finite",
        ),
        (lambda: synthesise_latlong(np.zeros((5, 1)), 8), "there are 5 coefficients"),
        (
            lambda: synthesise_latlong(np.full((4, 1), np.inf), 8),
            "coefficients: 4 of 4 values are not finite",
        ),
        (lambda: synthesise_latlong(np.zeros((36, 1)), 8), "l_max is 5; a lat-long grid of 8 rows"),
    ],
)
def test_bad_input_gets_a_sentence(call, message: str):
    with pytest.raises(ValueError, match=message):
        call()
