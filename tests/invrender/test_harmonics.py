"""Spherical harmonics against scipy, and projections against what they project."""

from __future__ import annotations

import csv
from pathlib import Path

import cv2
import numpy as np
import pytest
import sphericart
from numpy.testing import assert_allclose
from threadpoolctl import threadpool_limits

from capture.lighting import latlong_directions, latlong_solid_angles
from recon.harmonics import basis
from recon.harmonics.basis import degrees, evaluate_harmonics, orders, to_degree
from recon.harmonics.complex import evaluate_complex, project_sources, to_complex, to_real
from recon.harmonics.latlong import project_latlong

from .quadrature import scipy_complex, scipy_harmonics, sphere_grid

AXES = np.concatenate([np.eye(3), -np.eye(3)])


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


def test_complex_harmonics_are_scipys(rng):
    scattered = rng.normal(size=(100, 3))
    directions = np.concatenate([AXES, scattered / np.linalg.norm(scattered, axis=1, keepdims=True)])
    assert_allclose(evaluate_complex(directions, 12), scipy_complex(directions, 12), atol=1e-13)


def test_harmonics_take_one_thread_whoever_loaded_openmp(monkeypatch):
    threads = []

    class Watched(sphericart.SphericalHarmonics):
        def compute(self, directions):
            threads.extend(pool["num_threads"] for pool in basis._OPENMP.info())
            return super().compute(directions)

    monkeypatch.setattr("sphericart.SphericalHarmonics", Watched)
    with threadpool_limits(2, user_api="openmp"):
        evaluate_harmonics(AXES, 4)
    assert set(threads) == {1}


def test_the_first_complex_harmonics_are_as_printed():
    # [R02, eq. 2.27], in which the sign of Y_11 shows the Condon-Shortley phase.
    x, y, z = 0.48, 0.6, 0.64
    found = evaluate_complex([[x, y, z]], 2)[0]
    eighth, fifteen = np.sqrt(3 / (8 * np.pi)), np.sqrt(15 / (8 * np.pi))
    printed = {
        0: np.sqrt(1 / (4 * np.pi)),
        2: np.sqrt(3 / (4 * np.pi)) * z,
        3: -eighth * (x + 1j * y),
        6: 0.5 * np.sqrt(5 / (4 * np.pi)) * (3 * z * z - 1),
        7: -fifteen * z * (x + 1j * y),
        8: 0.5 * fifteen * (x + 1j * y) ** 2,
    }
    for place, value in printed.items():
        assert_allclose(found[place], value, rtol=1e-14)
    l, m = degrees(2), orders(2)
    mirrored = l * l + l - m
    assert_allclose(found[mirrored], (-1.0) ** m * found.conj(), rtol=1e-14)  # Y_l-m = (-1)^m conj(Y_lm)


def test_a_function_is_the_same_in_both_bases(rng):
    coefficients = rng.normal(size=(64, 2))
    directions, _ = sphere_grid(6)
    found = scipy_complex(directions, 7) @ to_complex(coefficients)
    assert_allclose(found, scipy_harmonics(directions, 7) @ coefficients, atol=1e-12)
    assert_allclose(to_real(to_complex(coefficients)), coefficients, atol=1e-14)


def test_what_is_no_real_function_has_no_real_coefficients():
    with pytest.raises(ValueError, match=r"not those of a real function: f_l-m differs .* of the largest"):
        to_real([1.0, 0.0, 0.0, 1.0])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: evaluate_harmonics([[0, 0, 1.0]], -1), r"l_max is -1; it must be an integer >= 0"),
        (
            lambda: evaluate_harmonics([[0, 0, 1.0], [0, 2.0, 0]], 2),
            r"directions\[1\] is \[0.0, 2.0, 0.0\].*length",
        ),
        (lambda: evaluate_harmonics([[0, 0, 1.0], [np.nan, 0, 0]], 2), r"directions\[1\] is \[nan"),
        (lambda: evaluate_harmonics([[0, 0, 1.0]], 150), r"l_max is 150; .* up to degree 140"),
        (lambda: to_degree(np.zeros(4), -3), "l_max is -3"),
        (lambda: to_complex(np.zeros(10)), r"there are 10 coefficients.*1, 4, 9, 16"),
        (lambda: to_degree(np.zeros(0), 2), r"there are 0 coefficients"),
    ],
)
def test_bad_input_gets_a_sentence(call, message: str):
    with pytest.raises(ValueError, match=message):
        call()


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
    assert np.abs(found - published).max() < 0.01  # published with two digits
