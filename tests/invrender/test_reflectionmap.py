"""Reflection maps against the reflection integral, summed up over directions, and against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from capture.lighting import latlong_directions
from invrender.brdf.form import Angles, LobeForm
from invrender.brdf.lobes import GGX_FORM, RH01_FORM
from invrender.prefilter.reflectionmap import (
    lobe_coefficients,
    lobe_orders,
    mirrored_coefficients,
    reflected_terms,
    reflection_map,
)
from invrender.theory.convolution import filtered
from invrender.theory.specialcases import phong_transfer
from recon.harmonics.complex import project_sources
from recon.harmonics.latlong import synthesise_latlong

from .quadrature import scipy_harmonics, sphere_grid


def of_form(form: LobeForm, mu: float | None, sigma: float):
    def lobe(normals, wi, wo):
        angles = Angles.between(normals, wi, wo)
        return form.reflected(angles, mu, sigma) * angles.cos_o

    return lobe


def simplified(sigma: float):
    """R02, eq. 5.34, written out, for light from above the horizon."""

    def lobe(normals, wi, wo):
        half = (wi + wo) / np.linalg.norm(wi + wo, axis=-1, keepdims=True)
        theta = np.arccos(np.clip((half * normals).sum(axis=-1), -1, 1))
        lit = (wi * normals).sum(axis=-1) > 0
        return lit * np.exp(-((theta / sigma) ** 2)) / (4 * np.pi * sigma**2)

    return lobe


def frames(mirrored: np.ndarray) -> np.ndarray:
    """Rz(beta) Ry(alpha) (n, 3, 3) of unit directions (n, 3)."""
    alpha, beta = np.arccos(mirrored[:, 2]), np.arctan2(mirrored[:, 1], mirrored[:, 0])
    x = np.stack([np.cos(alpha) * np.cos(beta), np.cos(alpha) * np.sin(beta), -np.sin(alpha)], axis=-1)
    y = np.stack([-np.sin(beta), np.cos(beta), np.zeros_like(beta)], axis=-1)
    return np.stack([x, y, mirrored], axis=-1)


@pytest.mark.parametrize(
    ("lobe", "theta_o"),
    [(of_form(GGX_FORM, 1.5, 0.35), 0.5), (of_form(GGX_FORM, 1.5, 0.35), 1.2), (simplified(0.4), 0.9)],
)
def test_terms_of_one_exitant_angle_add_up_to_the_reflection_integral(rng, lobe, theta_o):
    """[R02, eq. 5.9], any azimuth of the view about the mirrored direction."""
    l_max, height = 5, 12
    lighting = rng.normal(size=((l_max + 1) ** 2, 2))
    rho, _ = mirrored_coefficients(lobe, l_max, l_max, [np.cos(theta_o)])
    q = np.arange(-l_max, l_max + 1)
    terms = (
        reflected_terms(lighting, rho[0][:, np.abs(q)], q, height)
        .transpose(2, 3, 0, 1)
        .reshape(-1, len(q), 2)
    )
    directions, weights = sphere_grid(160)
    light = scipy_harmonics(directions, l_max) @ lighting
    places = np.array([0, 40, 133, 200, 287])  # poles' neighbours among them
    about = frames(latlong_directions(height).reshape(-1, 3)[places])
    for place, frame, phi in zip(places, about, (0.0, 0.7, 2.0, -2.5, -1.0), strict=True):
        view = frame @ [
            np.sin(2 * theta_o) * np.cos(phi),
            np.sin(2 * theta_o) * np.sin(phi),
            np.cos(2 * theta_o),
        ]
        normal = (view + frame[:, 2]) / np.linalg.norm(view + frame[:, 2])
        truth = (weights * lobe(normal, directions, view)) @ light
        found = np.where(q < 0, np.sin(-q * phi), np.cos(q * phi)) @ terms[place]
        # The horizon cuts the lobe, at which the sum over 51,000 directions is good to some 1e-3.
        assert_allclose(found, truth, atol=3e-3 * np.abs(terms).max())


def test_a_source_shows_the_lobe_itself():
    """Delta-like light of a high degree: the radiance is the formula."""
    lobe, l_max, theta_o = simplified(0.15), 32, 0.5
    source = np.array([0.48, -0.6, 0.64])
    rho, _ = mirrored_coefficients(lobe, l_max, 14, [np.cos(theta_o)])
    q = np.arange(-14, 15)
    lighting = project_sources(source[None], np.ones((1, 1)), l_max)
    terms = reflected_terms(lighting, rho[0][:, np.abs(q)], q, 66).reshape(len(q), -1)
    about = frames(latlong_directions(66).reshape(-1, 3))
    for phi in (0.0, 1.0, 2.5, -2.0):
        local = [np.sin(2 * theta_o) * np.cos(phi), np.sin(2 * theta_o) * np.sin(phi), np.cos(2 * theta_o)]
        views = about @ local
        normals = (views + about[:, :, 2]) / np.linalg.norm(views + about[:, :, 2], axis=1, keepdims=True)
        truth = lobe(normals, source, views)
        found = np.where(q < 0, np.sin(-q * phi), np.cos(q * phi)) @ terms
        # Of the peak; what lies above these degrees and orders and beyond the horizon is less.
        assert np.abs(found - truth).max() < 1e-3 * truth.max()


def test_matte_surfaces_under_a_white_sky_are_white():
    def matte(normals, wi, wo):
        return np.maximum((normals * wi).sum(axis=-1), 0) / np.pi

    rho, _ = lobe_coefficients(matte, 3, 2)
    maps = reflection_map(np.ones((64, 128, 1)), rho, 8)
    rng = np.random.default_rng(1)
    views = rng.normal(size=(5, 3))
    views /= np.linalg.norm(views, axis=1, keepdims=True)
    assert_allclose(maps.seen_from(views), 1, atol=1e-3)  # the map's pixels, to second order


def test_symmetric_lobes_are_the_filter_of_the_light_for_all_views(rng):
    """P = 0, and then the map is that of [R02, eq. 2.62]."""

    def phong(normals, wi, wo):
        mirrored = 2 * (normals * wo).sum(axis=-1, keepdims=True) * normals - wo
        return 9 / (2 * np.pi) * np.maximum((mirrored * wi).sum(axis=-1), 0) ** 8

    lighting = rng.normal(size=(49, 3))
    light = synthesise_latlong(lighting, 40)
    rho, _ = lobe_coefficients(phong, 6, 1)
    views = np.array([[0.0, 0, 1], [0.6, 0, 0.8], [0, 0.8, -0.6]])
    found = reflection_map(light, rho, 20).seen_from(views)
    truth = synthesise_latlong(filtered(lighting, phong_transfer(8.0, 6)), 20).real
    # The map's pixels are taken for means over them, which is of second order in their size.
    assert_allclose(
        found, np.broadcast_to(truth.transpose(2, 0, 1), found.shape), atol=6e-3 * np.abs(truth).max()
    )
    assert np.abs(rho[:, 1]).max() < 1e-6 * rho.max()


def test_orders_are_those_of_the_paper():
    """[R02, table 5.5], for 97% of the energy; of as many coefficients, ours are those with fewer."""
    for sigma, (f, p) in {0.1: (24, 3), 0.2: (12, 2), 0.3: (7, 2), 0.4: (5, 2), 0.5: (5, 2)}.items():
        found = lobe_orders(simplified(sigma), 0.03, 28, 4)
        assert np.abs(np.subtract(found, (f, p))).max() <= 1
        assert found <= (f, p)


def test_what_the_orders_leave_out_is_missing_in_what_is_seen():
    """Energy over all normals and views of light that is alike in all degrees up to F, against that of many orders."""
    lobe, l_max = simplified(0.5), 5
    rho, _ = lobe_coefficients(lobe, l_max, 7)
    rng = np.random.default_rng(5)
    light = synthesise_latlong(rng.normal(size=((l_max + 1) ** 2, 60)), 24)
    views, weights = sphere_grid(9)
    rows = np.sin((np.arange(12) + 0.5) * np.pi / 12)
    many = reflection_map(light, rho, 12).seen_from(views)
    few = reflection_map(light, rho[:, :3, :3], 12).seen_from(views)
    missing, whole = (
        np.einsum("vchw,v,h->", part.astype(float) ** 2, weights, rows) for part in (many - few, many)
    )
    power = rho**2 * np.where(np.arange(6) > 0, 2, 1)
    # Random light has its energy per degree to some 10%.
    assert missing / whole == pytest.approx(power[:, 3:].sum() / power.sum(), rel=0.25)
    assert missing / whole < 0.03


def test_wrong_shapes_are_told():
    with pytest.raises(ValueError, match=r"rho is \(4, 3, 4\); it must be"):
        reflection_map(np.ones((8, 16, 3)), np.zeros((4, 3, 4)), 8)
    with pytest.raises(ValueError, match="2 terms under light of degree 1 need"):
        reflected_terms(np.zeros((4, 3)), np.zeros((3, 2)), [0, 1], 8)
    with pytest.raises(ValueError, match="must be in"):
        mirrored_coefficients(simplified(0.3), 3, 2, [0.0])
    with pytest.raises(ValueError, match=r"the lobe: .* not finite"):
        mirrored_coefficients(lambda n, wi, wo: np.full(wi.shape[:-1], np.nan), 3, 2, [1.0])
    with pytest.raises(ValueError, match="take more degrees"):
        lobe_orders(of_form(RH01_FORM, None, 0.1), 0.03, 8, 2)
