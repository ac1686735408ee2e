"""Spherical harmonics against scipy, and projections against what they project."""

from __future__ import annotations

import csv
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.special import sph_harm_y

from capture.lighting import latlong_directions, latlong_solid_angles
from invrender.theory.harmonics import project_sources
from invrender.theory.latlong import project_latlong
from recon.harmonics import evaluate_harmonics

AXES = np.concatenate([np.eye(3), -np.eye(3)])


def scipy_harmonics(directions: np.ndarray, l_max: int) -> np.ndarray:
    """The real orthonormal harmonics from scipy's complex ones, which carry the Condon-Shortley phase."""
    theta = np.arctan2(np.hypot(directions[:, 0], directions[:, 1]), directions[:, 2])
    phi = np.arctan2(directions[:, 1], directions[:, 0])
    columns = []
    for degree in range(l_max + 1):
        for order in range(-degree, degree + 1):
            value = sph_harm_y(degree, abs(order), theta, phi) * (-1) ** order
            part = value.imag if order < 0 else value.real
            columns.append(part * (np.sqrt(2) if order else 1))
    return np.stack(columns, axis=1)


def sphere_grid(order: int) -> tuple[np.ndarray, np.ndarray]:
    """Directions and weights that integrate polynomials of degree below 2 * order exactly."""
    node, weight = np.polynomial.legendre.leggauss(order)
    phi = np.arange(2 * order) * np.pi / order
    ring = np.sqrt(1 - node**2)[:, None]
    z = np.broadcast_to(node[:, None], (order, 2 * order))
    directions = np.stack([ring * np.cos(phi), ring * np.sin(phi), z], axis=-1)
    return directions.reshape(-1, 3), np.repeat(weight, 2 * order) * np.pi / order


def test_values_order_and_signs_are_those_of_the_real_form_without_phase(rng):
    scattered = rng.normal(size=(200, 3))
    directions = np.concatenate([AXES, scattered / np.linalg.norm(scattered, axis=1, keepdims=True)])
    assert len(np.unique(np.sign(scattered), axis=0)) == 8  # all octants
    expected = scipy_harmonics(directions, 14)
    # Rounding, which recurrences carry through 14 degrees.
    assert_allclose(evaluate_harmonics(directions, 14), expected, atol=1e-12, equal_nan=False)


def test_the_first_degree_is_y_z_x():
    # By hand: sqrt(3 / 4 pi) times the coordinates (y, z, x), in this order; l * l + l + m is 3 for Y[1,1].
    expected = np.sqrt(3 / (4 * np.pi)) * AXES[:, [1, 2, 0]]
    assert_allclose(evaluate_harmonics(AXES, 1)[:, 1:], expected, atol=1e-15)


def test_gram_matrix_is_the_identity():
    directions, weights = sphere_grid(14)  # exact for products of two of degree 12
    basis = evaluate_harmonics(directions, 12)
    assert_allclose(basis.T @ (weights[:, None] * basis), np.eye(169), atol=1e-12, equal_nan=False)


def test_projection_of_a_map_finds_what_it_was_made_of(rng):
    coefficients = rng.normal(size=(36, 3))
    errors = []
    for height in (32, 64, 128):
        directions = latlong_directions(height).reshape(-1, 3)
        radiance = (scipy_harmonics(directions, 5) @ coefficients).reshape(height, 2 * height, 3)
        found = project_latlong(radiance, 7)
        errors.append(np.abs(found - np.pad(coefficients, ((0, 28), (0, 0)))).max())
    # A pixel's value at its centre for its mean: second order in the pixel, (pi / 128)^2 * 35 / 24 = 9e-4 for
    # degree 5, and 16 times less from 32 rows to 128.
    assert errors[2] < 2e-3
    assert_allclose(errors[0] / errors[2], 16, rtol=0.1)


def test_a_source_is_a_delta_function(rng):
    directions = np.array([[0.6, 0.0, 0.8], [0.0, 0.0, -1.0], [-0.48, 0.6, -0.64]])
    irradiances = rng.random((3, 3))
    function = rng.normal(size=49)
    # Reproducing: the integral of a function of degree 6 against the sources is its values there.
    overlap = function @ project_sources(directions, irradiances, 6)
    expected = (scipy_harmonics(directions, 6) @ function) @ irradiances
    assert_allclose(overlap, expected, rtol=1e-12)


def test_a_source_is_the_limit_of_a_bright_pixel():
    height, row, column = 90, 20, 130
    radiance = np.zeros((height, 2 * height, 3))
    radiance[row, column] = [1.0, 2.0, 3.0]
    irradiance = radiance[row, column] * latlong_solid_angles(height)[row]
    centre = latlong_directions(height)[row, column]
    expected = project_sources(centre, irradiance[None], 9)
    assert_allclose(project_latlong(radiance, 9), expected, rtol=1e-12, atol=1e-15)


# In the probes' frame y is up. Their images have -z in the centre and +x to the right; the published
# coefficients are those of the image mirrored, turned about y and scaled: what is turned, by how much and the
# scales come from the data's README, as do the RMS errors, of which 0.0029 is the rounding to two digits.
PROBES = {
    "Grace Cathedral": ("Grace_Cathedral.hdr", 180, 0.3127, 0.0032),
    "Uffizi Gallery": ("uffizi.hdr", 90, 0.1005, 0.0022),
}


@pytest.mark.parametrize("probe", PROBES)
def test_published_coefficients_of_light_probes(probe: str, data_dir: Path):
    file, turn_deg, scale, stated_rms = PROBES[probe]
    image = cv2.imread(str(data_dir / "probes" / file), cv2.IMREAD_UNCHANGED)[..., ::-1]
    with open(data_dir / "probes" / "published_sh9.csv", newline="") as lines:
        rows = [row for row in csv.DictReader(lines) if row["probe"] == probe]
    published = np.array([[float(row[channel]) for channel in "RGB"] for row in rows])
    assert published.shape == (9, 3)

    width = image.shape[1]
    # Our map's Z is the probe's y, X its z, Y its x. An image column at angle a from the centre looks along
    # (x, z) = (sin a, -cos a); mirrored and turned by t, along (sin(a + t - 180), cos(a + t - 180)).
    shift = (turn_deg - 180) / 360 * width
    assert shift == int(shift)
    ours = project_latlong(np.roll(image, int(shift) + width // 2, axis=1), 2)

    # The same function's coefficients in the probe's axes, from its values all over the sphere.
    directions, _ = sphere_grid(4)
    values = evaluate_harmonics(directions[:, [2, 0, 1]], 2) @ ours
    found = scale * np.linalg.lstsq(scipy_harmonics(directions, 2), values, rcond=None)[0]
    rms = np.sqrt(np.mean((found - published) ** 2))
    assert rms < 1.03 * stated_rms  # printed with two digits
