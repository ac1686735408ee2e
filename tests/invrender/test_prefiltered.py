"""Prefiltered light against sums over directions, and the errors that it states against those that it has.

Light is piecewise constant in few pixels, each of which is summed up over many directions; lobes are those of
`synthetic`, which shares no formula with ours.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.testing import assert_allclose

from capture.lighting import latlong_directions, latlong_solid_angles
from invrender.brdf.form import Angles
from invrender.brdf.lobes import BECKMANN, GGX_FORM, PHONG, RH01_FORM
from invrender.brdf.phong import mirrored_phong, phong_exponent
from invrender.brdf.rh01 import simplified_microfacet
from invrender.prefilter.bounds import LightingEnergy, ball_angles, error_bound
from invrender.prefilter.centred import CentredBrdf, CentredLobe, lambertian_lobe, specular_lobe
from invrender.prefilter.globalmap import global_map
from invrender.prefilter.prefiltered import prefilter, reflected
from invrender.prefilter.reflectionmap import ReflectionMap, axial_coefficients
from recon.harmonics.latlong import integrate_latlong
from synthetic.materials.facets import BeckmannSlopes, GGXSlopes
from synthetic.materials.material import Material
from synthetic.materials.microfacet import MicrofacetMaterial
from synthetic.materials.phong import PhongMaterial
from synthetic.materials.smith import SmithMaterial

from .quadrature import scipy_harmonics

FORMS = (RH01_FORM, BECKMANN, GGX_FORM, PHONG)
NOTHING, ALL = np.zeros(3), np.ones(3)


def specular(form, mu, sigma, strength=1.0) -> CentredLobe:
    def lobe(normals, wi, wo):
        return form.reflected(Angles.between(normals, wi, wo), mu, sigma)

    return specular_lobe("specular", (lobe,), np.broadcast_to(strength, 3))


def witness(form, mu, sigma) -> Material:
    if form is RH01_FORM:
        return MicrofacetMaterial(NOTHING, ALL, mu, sigma)
    if form is PHONG:
        return PhongMaterial(NOTHING, ALL, float(phong_exponent(sigma)))
    return SmithMaterial(NOTHING, ALL, mu, (BeckmannSlopes if form is BECKMANN else GGXSlopes)(sigma, sigma))


@dataclass
class Directions:
    """Directions and solid angles of small parts of a map's pixels, and the light from each."""

    wi: np.ndarray
    light: np.ndarray

    @classmethod
    def of(cls, radiance_map: np.ndarray, parts: int) -> Directions:
        height = parts * len(radiance_map)
        fine = radiance_map.repeat(parts, axis=0).repeat(parts, axis=1)
        light = fine * latlong_solid_angles(height)[:, :, None]
        return cls(latlong_directions(height).reshape(-1, 3), light.reshape(-1, 3))

    def reflected(self, material: Material, normal: np.ndarray, view: np.ndarray) -> np.ndarray:
        """Radiance (3,), by the sum over all directions."""
        tangent = np.cross(normal, view)
        tangent /= np.linalg.norm(tangent)
        frame = np.stack([tangent, np.cross(normal, tangent), normal])
        wi = self.wi @ frame.T
        above = wi[:, 2] > 0
        wi = wi[above]
        brdf = material.kd + material.ks * material.lobe(wi, frame @ view)
        return np.asarray((brdf * wi[:, 2:] * self.light[above]).sum(axis=0))


def random_map(rng: np.random.Generator, height: int) -> np.ndarray:
    """Light of many strengths, and a lamp in one pixel."""
    light = rng.lognormal(sigma=1.0, size=(height, 2 * height, 3))
    light[rng.integers(height), rng.integers(2 * height)] += rng.uniform(0, 60)
    return light


def views_about(centres: np.ndarray, angles: np.ndarray, phi: np.ndarray) -> np.ndarray:
    """Views (n, 3) at angles (n,) and azimuths (n,) in the frames Rz(beta) Ry(alpha) of unit directions (n, 3)."""
    alpha, beta = np.arccos(centres[:, 2]), np.arctan2(centres[:, 1], centres[:, 0])
    x = np.stack([np.cos(alpha) * np.cos(beta), np.cos(alpha) * np.sin(beta), -np.sin(alpha)], axis=-1)
    y = np.stack([-np.sin(beta), np.cos(beta), np.zeros_like(beta)], axis=-1)
    local = np.stack([np.sin(angles) * np.cos(phi), np.sin(angles) * np.sin(phi), np.cos(angles)])
    return local[0][:, None] * x + local[1][:, None] * y + local[2][:, None] * centres


def errors_of_pair(rng, count: int, parts: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Errors (count, 3) of a random lobe's map under random light, at random pixels and views, rms and bound."""
    form = FORMS[rng.integers(len(FORMS))]
    sigma, mu = rng.uniform(0.2, 0.5), float(rng.uniform(1.3, 1.8))
    mu = None if form is PHONG or rng.random() < 0.3 else mu
    lobe, light = specular(form, mu, sigma), random_map(rng, 6)
    f, p = int(rng.integers(2, 9)), int(rng.integers(0, 4))
    rho, _ = lobe.coefficients(f, p)
    rows = 24
    maps = reflected(lobe, rho, integrate_latlong(light, f), rows).maps
    cos = np.sqrt((1 + rng.uniform(-0.97, 1, count)) / 2)
    bound = error_bound(
        lobe, rho, LightingEnergy.of(integrate_latlong(light, 24), light), cos, np.full(count, 1 / count)
    )
    # Pixels that stand for equal areas.
    row = np.arccos(rng.uniform(-1, 1, count)) / np.pi * rows
    row, column = row.astype(int), rng.integers(0, 2 * rows, count)
    centres = latlong_directions(rows)[row, column]
    phi = rng.uniform(0, 2 * np.pi, count)
    views = views_about(centres, 2 * np.arccos(cos), phi)
    normals = centres + views
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    local = views_about(np.array([[0.0, 0, 1]]).repeat(count, 0), 2 * np.arccos(cos), phi)
    shown = np.einsum("nk,kcn->nc", scipy_harmonics(local, p), maps[:, :, row, column])
    shown = shown * lobe.factor(cos)[:, None]
    sums, material = Directions.of(light, parts), witness(form, mu, sigma)
    truth = np.array([sums.reflected(material, *pair) for pair in zip(normals, views, strict=True)])
    return shown - truth, bound.rms, bound.largest


def check_pairs(pairs: int, count: int, parts: int) -> None:
    rng = np.random.default_rng(2026)
    ratios = []
    for _ in range(pairs):
        error, rms, largest = errors_of_pair(rng, count, parts)
        assert (np.abs(error) <= largest).all()
        ratios.append((error / rms) ** 2)
    # What is stated as RMS is the RMS, not only a bound of it.
    assert 0.8 < np.mean(ratios) < 1.25, np.mean(ratios)


def test_errors_of_twenty_random_pairs_of_lobe_and_light_are_within_the_bound():
    check_pairs(20, 8, 10)


@pytest.mark.sweep
def test_errors_of_many_random_pairs_of_lobe_and_light_are_within_the_bound():
    check_pairs(100, 60, 20)


def test_a_map_of_steps_has_the_coefficients_of_its_steps(rng):
    """Whatever its height; against the sum over small parts of its pixels."""
    light = random_map(rng, 3)
    sums = Directions.of(light, 50)
    assert_allclose(integrate_latlong(light, 7), scipy_harmonics(sums.wi, 7).T @ sums.light, atol=4e-3)
    assert_allclose(
        integrate_latlong(np.ones((2, 4, 1)), 1), [[np.sqrt(4 * np.pi)], [0], [0], [0]], atol=1e-14
    )


def test_energies_of_a_map_of_steps_add_up(rng):
    light = random_map(rng, 4)
    whole = (light**2 * latlong_solid_angles(4)[..., None]).sum(axis=(0, 1))
    low, high = (LightingEnergy.of(integrate_latlong(light, l_max), light) for l_max in (4, 32))
    for found in (low, high):
        assert_allclose(found.power.sum(axis=0) + found.rest, whole, rtol=1e-12)
    # An edge leaves an energy above l that falls as 1 / l.
    assert (high.rest < 0.3 * low.rest).all()


def test_the_global_map_is_the_local_one_seen_from_the_world(rng):
    """[R02, eq. 5.12] as written, with scipy's harmonics of the view in the frame of each pixel."""
    local = ReflectionMap(rng.normal(size=(16, 2, 6, 12)).astype(np.float32))
    centres = latlong_directions(6).reshape(-1, 3)
    for viewer in np.array([[0.0, 0, 1], [0.6, 0, -0.8], [0.48, -0.6, 0.64]]):
        x, y = (views_about(centres, np.full(72, np.pi / 2), np.full(72, phi)) for phi in (0, np.pi / 2))
        seen = np.stack([x @ viewer, y @ viewer, centres @ viewer], axis=-1)
        truth = np.einsum("nk,kcn->cn", scipy_harmonics(seen, 3), local.maps.reshape(16, 2, -1))
        found = global_map(local).seen_from(viewer[None])[0].reshape(2, -1)
        assert_allclose(found, truth, atol=1e-5)


def test_a_lobe_about_the_normal_has_the_coefficients_of_the_clamped_cosine():
    def matte(normals, wi, wo):
        return np.maximum((normals * wi).sum(axis=-1), 0)

    found, energies = axial_coefficients(matte, 4, 1, [1.0, 0.3, -0.9])
    # A_l = pi, 2 pi / 3, pi / 4, 0, -pi / 24, each over Lambda_l = sqrt(4 pi / (2 l + 1)).
    cosine = np.pi * np.array([1, 2 / 3, 1 / 4, 0, -1 / 24]) * np.sqrt((2 * np.arange(5) + 1) / (4 * np.pi))
    assert_allclose(found[:, :, 0], [cosine] * 3, atol=1e-12)
    assert_allclose(found[:, :, 1], 0, atol=1e-12)
    assert_allclose(energies, 2 * np.pi / 3, rtol=1e-12)


def test_a_glossy_ball_is_what_the_sum_over_directions_says_within_what_is_stated(rng):
    """Any normals and views, between the maps' pixels."""
    light, view = random_map(rng, 6), np.array([0.48, -0.6, 0.64])
    kd, ks = np.array([0.1, 0.2, 0.05]), np.array([0.03, 0.02, 0.04])
    brdf = CentredBrdf("glossy", (lambertian_lobe("diffuse", kd), specular(RH01_FORM, 1.5, 0.25, ks)))
    found = prefilter(light, brdf)
    assert found.lobes[0].orders == (2, 0)
    cos = rng.uniform(0.15, 1, 20)
    normals = views_about(np.repeat(view[None], 20, 0), np.arccos(cos), rng.uniform(0, 6.3, 20))
    sums, material = Directions.of(light, 14), MicrofacetMaterial(kd, ks, 1.5, 0.25)
    truth = np.array([sums.reflected(material, normal, view) for normal in normals])
    shown = found.radiance(normals, view)
    at_these = [
        error_bound(
            part.lobe,
            part.rho,
            LightingEnergy.of(integrate_latlong(light, 30), light),
            cos,
            np.full(20, 0.05),
        )
        for part in found.lobes
    ]
    stated = at_these[0] + at_these[1]
    between = 0.05 * np.abs(shown).max(axis=0)
    assert all(part.between_pixels < 0.05 for part in found.lobes)
    assert (np.abs(shown - truth) <= stated.largest + between).all()
    assert (
        np.sqrt(np.mean((shown - truth) ** 2)) < 1.3 * np.sqrt(np.mean(stated.rms**2)) + 0.01 * truth.mean()
    )
    # The one map of a distant viewer shows the same.
    single = found.lobes[1].seen_from(view)
    rows = single.shape[1]
    centres = latlong_directions(rows)[rows // 2, ::5]
    half = (centres + view) / np.linalg.norm(centres + view, axis=1, keepdims=True)
    assert_allclose(
        single[:, rows // 2, ::5].T,
        found.lobes[1].radiance(half, np.broadcast_to(view, half.shape)),
        rtol=1e-3,
    )


def test_lobes_of_the_thesis_are_as_printed(rng):
    """[R02, eq. 5.26 and 5.34], at angles that are known: the mirrored view, and 0.3 rad from it in the plane."""
    normal, view = np.array([0.0, 0, 1]), np.array([0.6, 0, 0.8])
    turned = np.arctan2(-0.6, 0.8) + np.array([0.0, 0.3])
    wi = np.stack([np.sin(turned), 0 * turned, np.cos(turned)], axis=-1)
    assert_allclose(mirrored_phong(7.0)(normal, wi, view), 8 / (2 * np.pi) * np.cos([0, 0.3]) ** 7)
    half = np.exp(-((np.array([0, 0.15]) / 0.2) ** 2)) / (4 * np.pi * 0.2**2)
    assert_allclose(simplified_microfacet(0.2)(normal, wi, view), half)
    assert simplified_microfacet(0.2)(normal, -wi, view).tolist() == [0, 0]


def test_pictures_of_a_ball_weigh_mirrored_directions_evenly():
    cos, weights = ball_angles(20)
    assert weights.sum() == pytest.approx(1)
    # Over a disc of pixels at radius sin(theta): of cos^4, the integral of 2 sin cos^5 is 1/3.
    assert weights @ cos**4 == pytest.approx(1 / 3)
    bound = prefilter(LIGHT, MATTE).bound
    steep = bound.cos_angles < 0.5
    part = bound.up_to(60)
    assert part.weights.sum() == pytest.approx(1)
    whole = bound.weights[~steep].sum() * part.picture_rms**2 + bound.weights[steep] @ bound.rms[steep] ** 2
    assert_allclose(whole, bound.picture_rms**2)


def test_light_from_all_sides_comes_back_as_the_albedo():
    brdf = CentredBrdf("two", (lambertian_lobe("diffuse", 0.1 * ALL), specular(GGX_FORM, 1.5, 0.3, 0.04)))
    found = prefilter(np.ones((8, 16, 3)), brdf, epsilon=0.01)
    cos = found.bound.cos_angles
    views = np.stack([np.sqrt(1 - cos**2), 0 * cos, cos], axis=-1)
    normals = np.repeat([[0.0, 0, 1]], len(cos), 0)
    left = np.abs(found.radiance(normals, views) - found.albedo)
    # There the bound is attained: degree 0 alone is lit.
    assert (left <= 1.01 * found.bound.largest + 1e-4).all()
    assert_allclose(found.albedo[-1], 0.1 * np.pi + 0.04, rtol=0.1)


MATTE = CentredBrdf("matte", (lambertian_lobe("diffuse", 0.2 * ALL),))
GLOSS = CentredBrdf("gloss", (specular(GGX_FORM, None, 0.3, 0.8),))
LIGHT = np.ones((4, 8, 3))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: prefilter(np.ones((4, 6, 3)), MATTE), "radiance_map is 6x4 pixels; a lat-long map is"),
        (lambda: prefilter(-LIGHT, MATTE), "negative radiance"),
        (lambda: prefilter(np.full((4, 8, 3), np.nan), MATTE), "96 values that are not finite"),
        (lambda: prefilter(LIGHT, MATTE, epsilon=0.0), "epsilon is 0.0; .* must be in"),
        (lambda: prefilter(LIGHT, MATTE, epsilon=np.nan), "epsilon is nan"),
        (
            lambda: prefilter(LIGHT, CentredBrdf("snow", (lambertian_lobe("diffuse", 0.4 * ALL),))),
            "snow: reflects 1.26 times the light that it receives",
        ),
        (
            lambda: prefilter(LIGHT, GLOSS, orders=(3000, 3)),
            r"F = 3000, P = 3 on 30000 rows takes \S+ GB, more than 2",
        ),
        (lambda: prefilter(LIGHT, GLOSS, orders=(-1, 3)), "F is -1; it must be an integer >= 0"),
        (lambda: prefilter(LIGHT, MATTE, rows=0), "rows"),
        (lambda: CentredLobe("pair", (max, max), ALL, True), "there are 2 lobes"),
    ],
)
def test_what_cannot_be_prefiltered_is_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()
