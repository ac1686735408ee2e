"""The convolution formulas against the reflection integral, summed up over directions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from invrender.theory.brdfcoefficients import (
    anisotropic_coefficients,
    fixed_exitant_coefficients,
    isotropic_coefficients,
    outgoing_coefficients,
)
from invrender.theory.convolution import (
    anisotropic_light_field,
    anisotropic_radiance,
    filtered,
    fixed_exitant,
    isotropic_light_field,
    isotropic_radiance,
    local_directions,
    normalisation,
    radial_coefficients,
)
from recon.harmonics.basis import clamped_cosine_transfer, degrees, orders
from recon.harmonics.complex import to_complex
from recon.harmonics.rotations import euler_angles
from recon.harmonics.wigner import wigner_D

from .quadrature import (
    hemisphere_grid,
    reflected,
    reflected_everywhere,
    scipy_complex,
    scipy_harmonics,
    sphere_grid,
)
from .test_brdfcoefficients import brushed, glossy, rh01

ROTATIONS = Rotation.random(12, random_state=8).as_matrix()


def light_of(coefficients: np.ndarray):
    """Radiance of given directions, from real coefficients, by scipy."""
    l_max = round(np.sqrt(len(coefficients))) - 1
    return lambda directions: scipy_harmonics(directions, l_max) @ coefficients


def random_transfer(l_max: int, p_max: int, rng) -> np.ndarray:
    """A random isotropic transfer function rho_lpq of q >= 0, zero where q > min(l, p)."""
    rho = rng.normal(size=(l_max + 1, p_max + 1, min(l_max, p_max) + 1))
    l, p, q = np.ogrid[: rho.shape[0], : rho.shape[1], : rho.shape[2]]
    return np.where(q <= np.minimum(l, p), rho, 0)


def as_anisotropic(rho: np.ndarray) -> np.ndarray:
    """rho_ln,pq of an isotropic rho_lpq [R02, eq. 2.47]."""
    l_max, p_max = rho.shape[0] - 1, rho.shape[1] - 1
    l, n, p, q = degrees(l_max)[:, None], orders(l_max)[:, None], degrees(p_max), orders(p_max)
    inner = np.minimum(np.abs(q), rho.shape[2] - 1)
    return np.where((n == q) & (np.abs(q) <= l), rho[l, p, inner], 0)


def over_the_sphere(rho: np.ndarray, light, rotations: np.ndarray, exitant: np.ndarray) -> np.ndarray:
    """Integral (n,) of light times the band-limited transfer function of rho_ln,pq [R02, eq. 2.11 and 2.38]."""
    incident, weight = sphere_grid(10)
    l_max, p_max = (round(np.sqrt(size)) - 1 for size in rho.shape)
    transfer = scipy_complex(incident, l_max).conj() @ rho @ scipy_complex(exitant, p_max).T
    radiance = np.stack([light(incident @ rotation.T) for rotation in rotations], axis=1)
    return np.sum(weight[:, None] * radiance * transfer, axis=0)


@pytest.mark.parametrize(("l_max", "p_max"), [(4, 4), (5, 2), (2, 5)])
def test_isotropic_reflection_is_a_product_of_coefficients(l_max: int, p_max: int, rng):
    # Random light and transfer, both band-limited: exact but for rounding [R02, eq. 2.54 and 2.55].
    lighting, rho = rng.normal(size=(l_max + 1) ** 2), random_transfer(l_max, p_max, rng)
    exitant = rng.normal(size=(12, 3))
    exitant /= np.linalg.norm(exitant, axis=1, keepdims=True)
    found = isotropic_radiance(isotropic_light_field(to_complex(lighting), rho), ROTATIONS, exitant)
    expected = over_the_sphere(as_anisotropic(rho), light_of(lighting), ROTATIONS, exitant)
    assert_allclose(found, expected, atol=1e-11)


def test_anisotropic_reflection_is_a_product_of_coefficients(rng):
    # [R02, eq. 2.40, 2.42 and 2.43], likewise.
    lighting = rng.normal(size=25)
    rho = rng.normal(size=(25, 16)) + 1j * rng.normal(size=(25, 16))
    l, n, p, q = degrees(4), orders(4), degrees(3), orders(3)
    mirrored = rho[np.ix_(l * l + l - n, p * p + p - q)].conj()
    rho = rho + (-1.0) ** (n[:, None] + q) * mirrored  # a real function
    exitant = rng.normal(size=(12, 3))
    exitant /= np.linalg.norm(exitant, axis=1, keepdims=True)
    found = anisotropic_radiance(anisotropic_light_field(to_complex(lighting), rho), ROTATIONS, exitant)
    assert_allclose(found, over_the_sphere(rho, light_of(lighting), ROTATIONS, exitant), atol=1e-11)


def frames_and_weights(order: int, turns: int) -> tuple[np.ndarray, np.ndarray]:
    """Frames over all normals and, if turns > 1, turns about them; weights of the integral over alpha, beta, gamma."""
    normals, weight = sphere_grid(order)
    alpha, beta = np.arccos(normals[:, 2]), np.arctan2(normals[:, 1], normals[:, 0])
    gamma = np.arange(turns) * 2 * np.pi / turns
    angles = np.stack([np.repeat(beta, turns), np.repeat(alpha, turns), np.tile(gamma, len(alpha))], axis=1)
    step = 2 * np.pi / turns if turns > 1 else 1.0
    return Rotation.from_euler("ZYZ", angles).as_matrix(), np.repeat(weight, turns) * step


@dataclass(frozen=True, eq=False)
class LightField:
    """Radiance (s, n) of a glossy body in frames (s, 3, 3) towards exitant directions (n, 3), weights of both."""

    lighting: np.ndarray
    frames: np.ndarray
    frame_weight: np.ndarray
    exitant: np.ndarray
    exitant_weight: np.ndarray
    radiance: np.ndarray


@pytest.fixture(scope="module")
def glossy_field() -> LightField:
    """By brute force over all orientations and exitant directions, under light of degree 3."""
    lighting = np.random.default_rng(11).normal(size=16)
    frames, frame_weight = frames_and_weights(4, 1)
    exitant, exitant_weight = hemisphere_grid(12, 10)
    incident = hemisphere_grid(20, 30)
    radiance = reflected_everywhere(glossy, light_of(lighting), frames, exitant, incident)
    return LightField(lighting, frames, frame_weight, exitant, exitant_weight, radiance)


@pytest.mark.parametrize("cosine_powers", [0, 1])
def test_the_reflected_light_field_of_a_glossy_body_has_those_coefficients(
    cosine_powers: int, glossy_field: LightField
):
    # [R02, eq. 2.54, 2.58, 2.59]: the field projected.
    l_max, p_max, field = 3, 2, glossy_field
    rho = isotropic_coefficients(glossy, l_max, p_max, reciprocal=cosine_powers == 1)
    expected = isotropic_light_field(to_complex(field.lighting), rho)

    radiance = field.radiance * field.exitant[:, 2] ** cosine_powers
    basis = scipy_complex(field.exitant, p_max)
    matrices = wigner_D(l_max, *euler_angles(field.frames))
    for lm, (l, m) in enumerate(zip(degrees(l_max), orders(l_max), strict=True)):
        for pq, q in enumerate(orders(p_max)):
            if abs(q) <= l:
                own = matrices[l][:, m + l, q + l] / normalisation(l)[l]
                towards = radiance @ (basis[:, pq].conj() * field.exitant_weight)
                assert_allclose((own.conj() * field.frame_weight) @ towards, expected[lm, pq], atol=1e-10)


def test_the_light_field_of_a_brushed_body_has_those_coefficients(rng):
    # [R02, eq. 2.42 and 2.43] by brute force over the five angles.
    l_max, p_max = 2, 1
    lighting = rng.normal(size=9)
    frames, frame_weight = frames_and_weights(3, 5)
    exitant, exitant_weight = hemisphere_grid(9, 14)
    incident = hemisphere_grid(16, 30)
    expected = anisotropic_light_field(to_complex(lighting), anisotropic_coefficients(brushed, l_max, p_max))
    radiance = reflected_everywhere(brushed, light_of(lighting), frames, exitant, incident)
    towards = radiance @ (scipy_complex(exitant, p_max).conj() * exitant_weight[:, None])
    for l, matrix in enumerate(wigner_D(l_max, *euler_angles(frames))):
        scale = np.sqrt((2 * l + 1) / (8 * np.pi**2))
        projected = scale * np.einsum("s,smn,sk->mnk", frame_weight, matrix.conj(), towards)
        own = expected[l * l : (l + 1) ** 2, l_max - l : l_max + l + 1]
        assert_allclose(projected, own, atol=1e-9)


@pytest.mark.parametrize("sigma", [0.1, 0.3])
def test_one_exitant_angle_needs_no_expansion_over_them(sigma: float, rng):
    # [R02, eq. 2.56 and 2.57], RH01's lobe included, whose integral over exitant angles has no limit.
    l_max, cos, phi = 4, 0.6, 0.9
    lighting = rng.normal(size=25)
    rho = fixed_exitant_coefficients(outgoing_coefficients(rh01(sigma), l_max, [cos])[0])
    coefficients = fixed_exitant(to_complex(lighting), rho)
    found = np.zeros(len(ROTATIONS), complex)
    for l, matrix in enumerate(wigner_D(l_max, *euler_angles(ROTATIONS))):
        own = coefficients[l * l : (l + 1) ** 2, l_max - l : l_max + l + 1]
        wave = np.exp(1j * np.arange(-l, l + 1) * phi) / np.sqrt(2 * np.pi) / normalisation(l)[l]
        found += np.einsum("smq,mq,q->s", matrix, own, wave)
    sin = np.sqrt(1 - cos**2)
    exitant = np.tile([sin * np.cos(phi), sin * np.sin(phi), cos], (len(ROTATIONS), 1))
    expected = reflected(rh01(sigma), light_of(lighting), ROTATIONS, exitant, hemisphere_grid(100, 300))
    assert_allclose(found, expected, atol=1e-9)


def test_a_fixed_direction_of_a_brushed_body_needs_no_expansion_either(rng):
    # [R02, eq. 2.44].
    lighting = rng.normal(size=16)
    towards = np.array([0.48, -0.36, 0.8])
    directions, weight = hemisphere_grid(24, 40)
    rho = (brushed(directions, towards) * directions[:, 2] * weight) @ scipy_complex(directions, 3)
    coefficients = anisotropic_light_field(to_complex(lighting), rho[:, None])[..., 0]
    found = np.zeros(len(ROTATIONS), complex)
    for l, matrix in enumerate(wigner_D(3, *euler_angles(ROTATIONS))):
        own = coefficients[l * l : (l + 1) ** 2, 3 - l : 3 + l + 1]
        found += np.sqrt((2 * l + 1) / (8 * np.pi**2)) * np.einsum("smn,mn->s", matrix, own)
    exitant = np.tile(towards, (len(ROTATIONS), 1))
    expected = reflected(brushed, light_of(lighting), ROTATIONS, exitant, hemisphere_grid(30, 50))
    assert_allclose(found, expected, atol=1e-10)


def test_reflection_about_a_central_direction_filters_the_lighting(rng):
    # [R02, eq. 2.60 to 2.62]: u(C.L) = (C.L)^3 on its hemisphere, at central directions C.
    lighting = rng.normal(size=36)
    l = np.arange(6)
    node, weight = np.polynomial.legendre.leggauss(12)
    cos, weight = (node + 1) / 2, weight / 2
    zonal = scipy_harmonics(np.stack([np.sqrt(1 - cos**2), 0 * cos, cos], axis=1), 5)[:, l * l + l]
    transfer = normalisation(5) * (2 * np.pi * (weight * cos**3) @ zonal)
    assert_allclose(radial_coefficients(transfer), transfer / np.sqrt(4 * np.pi / (2 * l + 1)))
    expected = [
        np.sum(w * d[:, 2] ** 3 * light_of(lighting)(d @ rotation.T))
        for rotation in ROTATIONS
        for d, w in [hemisphere_grid(12, 24)]
    ]
    centres = ROTATIONS[:, :, 2]
    assert_allclose(scipy_harmonics(centres, 5) @ filtered(lighting, transfer), expected, atol=1e-12)
    # The same in complex coefficients, and for several channels at once.
    complex_way = scipy_complex(centres, 5) @ filtered(to_complex(lighting), transfer)
    assert_allclose(complex_way, expected, atol=1e-12)
    assert_allclose(filtered(np.stack([lighting] * 2, axis=1), transfer)[:, 1], filtered(lighting, transfer))


def test_directions_of_the_world_are_told_in_local_axes():
    towards = np.array([[0.0, 0.6, 0.8]] * len(ROTATIONS))
    local = local_directions(ROTATIONS, towards)
    assert_allclose(np.einsum("njk,nk->nj", ROTATIONS, local), towards, atol=1e-14)
    assert_allclose(local[:, 2], ROTATIONS[:, :, 2] @ towards[0], atol=1e-14)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: filtered(np.zeros(9), clamped_cosine_transfer(3)),
            r"transfer is \(4,\); .* degree 2 needs \(3,\)",
        ),
        (
            lambda: isotropic_light_field(np.zeros(9), np.zeros((4, 2, 2))),
            "lighting is of degree 2 and the BRDF of 3",
        ),
        (
            lambda: isotropic_light_field(np.zeros(9), np.zeros((3, 2, 3))),
            "of degrees 2 and 1 it has 2 orders",
        ),
        (
            lambda: anisotropic_light_field(np.zeros(9), np.zeros((4, 4))),
            "lighting is of degree 2 and the BRDF of 1",
        ),
        (lambda: fixed_exitant(np.zeros(8), np.zeros((3, 3))), "there are 8 coefficients"),
        (lambda: filtered([np.nan], [1.0]), "lighting: 1 of 1 values are not finite"),
        (lambda: isotropic_light_field(np.zeros(4), np.full((2, 2, 2), np.nan)), "rho: 8 of 8 values"),
        (
            lambda: isotropic_radiance(np.full((1, 1), np.inf), np.eye(3)[None], [[0, 0, 1.0]]),
            "coefficients: 1 of 1",
        ),
        (
            lambda: isotropic_radiance([[1j]], np.eye(3)[None], [[0, 0, 1.0]]),
            "not those of a real light field",
        ),
        (
            lambda: fixed_exitant(np.zeros(4), np.zeros((2, 3))),
            r"rho is \(2, 3\); of degree 1 it must be \(2, 2\)",
        ),
        (lambda: local_directions(2 * np.eye(3)[None], [[0, 0, 1.0]]), "rotation isn't one"),
        (lambda: local_directions(np.eye(3)[None], [[0, 0, 2.0]]), "of length 1"),
    ],
)
def test_bad_input_gets_a_sentence(call, message: str):
    with pytest.raises(ValueError, match=message):
        call()
