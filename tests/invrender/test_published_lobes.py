"""Lobes of skin and of fibres, and the orders that their maps take, against R02's section 5.7.1."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from capture.lighting import latlong_directions
from invrender.brdf.bagher2012 import ShiftedGammaBrdf
from invrender.brdf.kajiya_kay import kajiya_kay
from invrender.brdf.lafortune import SKIN, LafortuneBrdf, LafortuneLobe
from invrender.brdf.low2012 import AbcBrdf
from invrender.output.prefilter.brdfs import chosen_brdf
from invrender.prefilter.energy import isotropic_fraction
from invrender.prefilter.prefiltered import prefilter
from invrender.prefilter.reflectionmap import axial_lobe_coefficients, lobe_coefficients

from .quadrature import scipy_harmonics, sphere_grid

UP = np.array([0.0, 0, 1])


def polar(theta: float, phi: float = 0.0) -> np.ndarray:
    return np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])


def test_skin_is_the_sum_of_its_lobes_as_printed():
    """In red, from 60 to 60 degrees: mirrored x x' = -3/4, z z' = 1/4; straight up z z' = 1."""
    mirrored = [
        1.131747 * 0.75 - 1.209182 / 4,
        0.546570 * 0.75 + 0.380123 / 4,
        0.998888 * 0.75 + 0.857998 / 4,
    ]
    grazing = sum(np.array(mirrored) ** [6.421658, 3.685044, 64.208486])
    red = SKIN.specular(0)
    assert red(UP, polar(np.pi / 3, np.pi), polar(np.pi / 3)) == pytest.approx(grazing * 0.5)
    assert red(UP, UP, UP) == pytest.approx(0.380123**3.685044 + 0.857998**64.208486)
    assert red(UP, -UP, UP) == 0
    # Reciprocal but for the cosine.
    one, other = polar(0.4, 1.0), polar(1.2, -0.5)
    for channel in range(3):
        lobe = SKIN.specular(channel)
        assert lobe(UP, one, other) / np.cos(0.4) == pytest.approx(lobe(UP, other, one) / np.cos(1.2))


def test_a_lobe_with_equal_coefficients_is_phongs():
    """C_z = -C_xy = 1: the cosine to the mirrored view, to the power."""
    grey = LafortuneBrdf((0, 0, 0), (LafortuneLobe((-1,) * 3, (1,) * 3, (9,) * 3),))
    wi, wo = polar(0.8, 2.0), polar(0.3, -0.6)
    mirrored = polar(0.3, np.pi - 0.6)
    assert grey.specular(1)(UP, wi, wo) == pytest.approx((mirrored @ wi) ** 9 * np.cos(0.8))


def test_skin_takes_order_4_for_97_percent_of_its_energy():
    """[R02, section 5.7.1], of the whole BRDF about the mirrored view: over the channels; green alone misses it."""
    held, total = np.zeros(6), 0.0
    for channel, albedo in enumerate(SKIN.albedo):

        def skin(normals, wi, wo, channel=channel, albedo=albedo):
            matte = albedo / np.pi * np.maximum((normals * wi).sum(axis=-1), 0)
            return SKIN.specular(channel)(normals, wi, wo) + matte

        rho, energy = lobe_coefficients(skin, 30, 5)
        shares = isotropic_fraction(rho, energy)[-1]
        assert shares[4] == pytest.approx(0.97, abs=0.005)
        held, total = held + energy * shares, total + energy
    assert held[3] < 0.97 * total < held[4]


# Alumina oxide in red, and white paint in blue [Bagher et al. 2012]; blue rubber in red [Low et al. 2012].
GAMMAS = (
    ShiftedGammaBrdf(0.316, 0.0086, 0.05, 0.378, 0.03, -0.71, 12.0, 3.3, 6.7e-8, 354.0, 0.527),
    ShiftedGammaBrdf(0.325, 0.108, 0.538, 0.889, 1.8e-13, -0.367, 3.6, 2.23, 0.028, 7.4, 0.155),
)
RUBBER = AbcBrdf(0.035403, 1.295714, 37.265717, 1.565906, 1.448611)


@pytest.mark.parametrize("brdf", [*GAMMAS, RUBBER])
def test_fits_of_measured_brdfs_are_reciprocal_and_end_at_the_horizon(brdf, rng):
    one, other = rng.normal(size=(2, 40, 3))
    one, other = (np.abs(v) * [1, 0, 1] + v * [0, 1, 0] for v in (one, other))
    one, other = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (one, other))
    assert_allclose(brdf(UP, one, other) / one[:, 2], brdf(UP, other, one) / other[:, 2], rtol=1e-9)
    assert (brdf(UP, one, other) >= 0).all()
    assert (brdf(UP, one * [1, 1, -1], other) == 0).all()


def test_fits_of_measured_brdfs_are_as_printed_straight_up():
    """theta_h = theta_d = 0, nothing masked."""
    for gamma in GAMMAS:
        density = gamma.kappa * np.exp(-gamma.alpha) / (np.pi * gamma.alpha**gamma.p)
        assert gamma(UP, UP, UP) == pytest.approx(
            (gamma.rho_d + gamma.rho_s * (gamma.f0 - gamma.f1) * density) / np.pi
        )
    fresnel = (0.448611 / 2.448611) ** 2
    assert RUBBER(UP, UP, UP) == pytest.approx((0.035403 + fresnel * 1.295714) / np.pi)


def test_fits_of_measured_brdfs_are_as_printed_at_60_degrees():
    """Mirrored: theta_h = 0, theta_d = 60 degrees. Low's half angle at 20 degrees beside."""
    view, mirrored = polar(np.pi / 3), polar(np.pi / 3, np.pi)
    gamma = GAMMAS[1]
    masking = 1 + 2.23 * (1 - np.exp(0.028 * (np.pi / 3 - 0.155) ** 7.4))
    fresnel = gamma.f0 - gamma.f1 / 2 + (1 - gamma.f0) / 32
    density = gamma.kappa * np.exp(-gamma.alpha) / (np.pi * gamma.alpha**gamma.p)
    truth = (0.325 * 0.5 + 0.108 * fresnel * masking**2 * density / 0.5) / np.pi
    assert gamma(UP, mirrored, view) == pytest.approx(truth)
    wi, wo = polar(np.radians(50), np.pi), polar(np.radians(10), np.pi)
    half = np.radians(30)
    sine = np.sin(np.radians(20)) / 1.448611
    s, p = (
        np.sin(np.radians(20) - np.arcsin(sine)) / np.sin(np.radians(20) + np.arcsin(sine)),
        np.tan(np.radians(20) - np.arcsin(sine)) / np.tan(np.radians(20) + np.arcsin(sine)),
    )
    gloss = (s**2 + p**2) / 2 * 1.295714 / (1 + 37.265717 * (1 - np.cos(half))) ** 1.565906
    masked = min(1, 2 * np.cos(half) * np.cos(np.radians(50)) / np.cos(np.radians(20)))
    truth = 0.035403 / np.pi * np.cos(np.radians(50)) + gloss * masked / (np.pi * np.cos(np.radians(10)))
    assert RUBBER(UP, wi, wo) == pytest.approx(truth)


def test_fibres_are_brightest_on_their_cone():
    lobe = kajiya_kay(8.0)
    view = polar(0.7)
    thetas = np.linspace(0.1, 3.0, 59)
    for phi in (0.0, 2.0):
        values = lobe(UP, np.stack([polar(theta, phi) for theta in thetas]), view)
        assert_allclose(values, np.maximum(np.cos(thetas + 0.7 - np.pi), 0) ** 8, atol=1e-12)
        assert thetas[values.argmax()] == pytest.approx(np.pi - 0.7, abs=0.03)


def test_fibres_of_exponent_32_take_order_8():
    """[R02, section 5.7.1]: P = 8 for s = 32 and an error below 0.03, without any dependence on the azimuth."""
    rho, energy = axial_lobe_coefficients(kajiya_kay(32.0), 30, 9)
    shares = isotropic_fraction(rho, energy)[-1]
    assert shares[7] < 0.97 < shares[8]
    assert np.abs(rho[:, :, 1:]).max() < 1e-9 * rho.max()


def test_what_fibres_reflect_is_the_sum_over_directions(rng):
    """Light of few degrees, given at the pixels of a fine map; any tangents and views."""
    found = chosen_brdf("kajiya-kay:6", {}).brdf
    assert found.axis == "tangent"
    light = rng.uniform(0, 1, (3, 6, 3)).repeat(12, axis=0).repeat(12, axis=1)
    maps = prefilter(light, found, epsilon=0.001, rows=80)
    directions, weights = sphere_grid(80)
    row = np.minimum((np.arccos(directions[:, 2]) / np.pi * 3).astype(int), 2)
    column = (np.arctan2(directions[:, 1], directions[:, 0]) % (2 * np.pi) / np.pi * 3).astype(int)
    seen = light[::12, ::12][row, column] * weights[:, None]
    tangents, views = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in rng.normal(size=(2, 12, 3)))
    ridge = np.arccos(directions @ tangents.T) + np.arccos((tangents * views).sum(axis=1)) - np.pi
    lobe = np.maximum(np.cos(ridge), 0) ** 6
    truth = lobe.T @ seen
    # Scaled by what a view across the fibre sees of light from all sides.
    truth /= weights @ np.maximum(np.sqrt(1 - directions[:, 2] ** 2), 0) ** 6
    left = np.abs(maps.radiance(tangents, views) - truth)
    assert left.max() < 0.02 * truth.max()
    assert (maps.albedo < 1.001).all()
    assert maps.lobes[0].left_out < 0.001


def test_skin_under_light_of_few_degrees_is_the_sum_over_directions(rng):
    found = chosen_brdf("skin", {}).brdf
    coefficients = 0.2 * rng.normal(size=(9, 3)) + np.array([[4.0], *[[0.0]] * 8])
    directions, weights = sphere_grid(100)
    light = scipy_harmonics(directions, 2) @ coefficients
    radiance_map = (scipy_harmonics(latlong_directions(48).reshape(-1, 3), 2) @ coefficients).reshape(
        48, 96, 3
    )
    maps = prefilter(radiance_map, found)
    views = np.stack([polar(theta, 0.3) for theta in (0.1, 0.5, 0.9, 1.2)])
    normals = np.repeat(UP[None], 4, axis=0)
    truth = np.stack(
        [
            [
                weights
                @ (
                    (
                        SKIN.specular(c)(UP, directions, view)
                        + SKIN.albedo[c] / np.pi * directions[:, 2].clip(0)
                    )
                    * light[:, c]
                )
                for c in range(3)
            ]
            for view in views
        ]
    )
    bound = maps.bound
    largest = np.stack(
        [np.interp(views[:, 2], bound.cos_angles, bound.largest[:, c]) for c in range(3)], axis=-1
    )
    assert (np.abs(maps.radiance(normals, views) - truth) < 1.05 * largest + 0.01 * truth.max()).all()
