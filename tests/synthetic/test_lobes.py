"""The reflection integral against closed forms, and against a plain sum over a grid of the whole sphere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from synthetic.lights.arealight import AreaLight
from synthetic.lights.sources import DirectionalSource
from synthetic.materials.fresnel import fresnel_dielectric
from synthetic.materials.microfacet import MicrofacetMaterial
from synthetic.materials.rh01 import RH01_MATERIALS, radiometric
from synthetic.render.lobes import _irradiance_by_angle, irradiance, reflected_radiance

Floats = np.ndarray

MATTE = MicrofacetMaterial(np.array([0.1, 0.2, 0.3]), np.zeros(3), None, 0.1)
# exp((cos - 1) / 1e12) is 1 to rounding: uniform light.
UNIFORM = AreaLight(np.array([0.2, 0.3, 0.9]), np.array([1.0, 2.0, 4.0]), 1e6)
SOFT = AreaLight(np.array([-0.2, 0.8, 0.6]), np.array([1.0, 2.0, 3.0]), 0.35)


def surface_points(rng: np.random.Generator, cos_o: Floats) -> tuple[Floats, Floats]:
    """Normals and views (n, 3) all over the sphere of directions, seen at the given cosines."""
    views = rng.normal(size=(len(cos_o), 3))
    views /= np.linalg.norm(views, axis=1, keepdims=True)
    tangent = np.cross(views, rng.normal(size=views.shape))
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    return cos_o[:, None] * views + np.sqrt(1 - cos_o[:, None] ** 2) * tangent, views


def plain_radiance(
    material: MicrofacetMaterial, light: AreaLight, normals: Floats, views: Floats, order: int
) -> Floats:
    """The witness: rho L cos_i summed over one grid about the light's axis, the whole BRDF at once."""
    node, weight = np.polynomial.legendre.leggauss(order)
    phi = np.arange(2 * order) * np.pi / order
    first = np.cross(light.axis, [1.0, 0.0, 0.0])
    first /= np.linalg.norm(first)
    ring = np.cos(phi)[:, None] * first + np.sin(phi)[:, None] * np.cross(light.axis, first)
    directions = node[:, None, None] * light.axis + np.sqrt(1 - node**2)[:, None, None] * ring
    directions = directions.reshape(-1, 3)
    incident = np.repeat(weight, 2 * order) * np.pi / order * light.profile(directions @ light.axis)
    return np.array(
        [
            light.radiance
            * (material.evaluate(n, directions, wo).T @ (incident * np.maximum(directions @ n, 0)))
            for n, wo in zip(normals, views, strict=True)
        ]
    )


def test_lambertian_under_uniform_light_returns_its_albedo(rng: np.random.Generator) -> None:
    normals, views = surface_points(rng, rng.uniform(0.01, 1, 50))
    radiance = reflected_radiance(MATTE, [UNIFORM], [], normals, views)
    assert_allclose(radiance, np.tile(np.pi * MATTE.kd * UNIFORM.radiance, (50, 1)), rtol=1e-10)  # rounding


def test_irradiance_of_the_soft_light_in_closed_form() -> None:
    # Facing the light: 2 pi int_0^1 c exp((c - 1) / w^2) dc = 2 pi (w^2 - w^4 (1 - exp(-1 / w^2))).
    w2 = SOFT.width_rad**2
    below = w2**2 * (1 - np.exp(-1 / w2))
    assert_allclose(irradiance(SOFT, SOFT.axis[None]), [2 * np.pi * (w2 - below)], rtol=1e-8)
    # Facing away, what is left comes from beyond the equator: int_-1^0 of -c exp((c - 1) / w^2) dc.
    away = 2 * np.pi * np.exp(-1 / w2) * (w2**2 * (1 - np.exp(-1 / w2)) - w2 * np.exp(-1 / w2))
    assert_allclose(irradiance(SOFT, -SOFT.axis[None]), [away], rtol=1e-8)


def test_lambertian_under_one_source(rng: np.random.Generator) -> None:
    source = DirectionalSource(np.array([0.0, 0.6, 0.8]), np.array([1.0, 2.0, 3.0]))
    normals, views = surface_points(rng, rng.uniform(0.01, 1, 50))
    radiance = reflected_radiance(MATTE, [], [source], normals, views)
    cos_i = np.clip(normals @ source.direction, 0, None)
    assert (cos_i == 0).any()
    assert_allclose(radiance, cos_i[:, None] * MATTE.kd * source.irradiance, rtol=1e-12, atol=1e-300)


def test_specular_peak_under_one_source_by_hand() -> None:
    # Teflon, light and viewer 60 degrees to either side of the normal: theta_h = 0, cos_i = cos_o = 1/2.
    teflon = radiometric(RH01_MATERIALS["teflon"])
    side = np.sqrt(3) / 2
    source = DirectionalSource(np.array([side, 0.0, 0.5]), np.ones(3))
    radiance = reflected_radiance(teflon, [], [source], np.array([[0, 0, 1.0]]), np.array([[-side, 0, 0.5]]))
    # Snell: sin_t = 0.866 / 1.78 = 0.48653, cos_t = 0.87367.
    # r_s = (0.5 - 1.55514) / (0.5 + 1.55514) = -0.51341; r_p = (0.89 - 0.87367) / 1.76367 = 0.00926.
    # F = (0.26359 + 0.00009) / 2 = 0.13184; F(0) = (0.78 / 2.78)^2 = 0.078723; F / F(0) = 1.67473.
    # S = 1 / (pi 0.0144) = 22.1049; lobe = 1.67473 x 22.1049 / (4 x 0.5) = 18.5099.
    # Kd = 0.243634 of which cos_i = 1/2 counts; Ks = 0.0301121.
    expected = 0.243634 / 2 + 0.0301121 * 18.5099
    assert_allclose(radiance[0], np.full(3, expected), rtol=2e-4)  # five digits carried


@pytest.mark.parametrize("name", ["teflon", "steel", "painted"])
def test_two_orders_of_quadrature_agree(name: str, rng: np.random.Generator) -> None:
    material = radiometric(RH01_MATERIALS[name])
    normals, views = surface_points(rng, np.geomspace(1e-3, 1, 800))
    coarse = reflected_radiance(material, [SOFT], [], normals, views)
    fine = reflected_radiance(material, [SOFT], [], normals, views, order=40)
    # Documented: 1e-4 of the specular part, grazing views included. The floor is 1e-6 of the brightest.
    assert_allclose(coarse, fine, rtol=1e-4, atol=1e-6 * fine.max())


@pytest.mark.parametrize(
    ("name", "width"), [("teflon", 0.35), ("steel", 0.35), ("painted", 0.6), ("teflon", 4.0)]
)
def test_tables_of_integrals_agree_with_the_integrals(
    name: str, width: float, rng: np.random.Generator
) -> None:
    material, light = radiometric(RH01_MATERIALS[name]), replace(SOFT, width_rad=width)
    normals, views = surface_points(rng, np.linspace(1e-3, 1, 1000))
    # Seen along the normal, and with the light behind the viewer and before: the poles of the table's angles.
    poles = [(light.axis, light.axis), (views[-1], light.axis), (views[-1], -light.axis)]
    normals = np.concatenate([normals, [n if n @ v > 0 else -n for n, v in poles]])
    views = np.concatenate([views, [v for _, v in poles]])
    exact = reflected_radiance(material, [light], [], normals, views)
    found = reflected_radiance(material, [light], [], normals, views, tabled=True)
    assert np.sqrt(((found - exact) ** 2).mean()) < 1e-5 * np.sqrt((exact**2).mean())
    # Documented: splines are off by less than 1e-5 of the peak; of narrow lobes beside the horizon by a few times that.
    assert_allclose(found, exact, atol=5e-5 * exact.max())


@pytest.mark.parametrize("name", ["teflon", "steel"])
def test_agrees_with_a_plain_sum_over_the_sphere(name: str, rng: np.random.Generator) -> None:
    material = radiometric(RH01_MATERIALS[name])
    normals, views = surface_points(rng, np.linspace(0.1, 1, 16))
    expected = plain_radiance(material, SOFT, normals, views, order=300)
    radiance = reflected_radiance(material, [SOFT], [], normals, views)
    # The plain grid's own error: it meets the horizon, where the integrand jumps, at a spacing of 0.01 rad.
    assert_allclose(radiance, expected, rtol=5e-3, atol=1e-4 * expected.max())
    assert np.median(np.abs(radiance / expected - 1)) < 1e-5


def test_narrow_lobe_is_a_mirror(rng: np.random.Generator) -> None:
    material = MicrofacetMaterial(np.zeros(3), np.array([0.2, 0.3, 0.4]), 1.5, 0.01)
    cos_o = np.linspace(0.3, 1, 60)
    normals, views = surface_points(rng, cos_o)
    mirrored = 2 * cos_o[:, None] * normals - views
    fresnel = fresnel_dielectric(1.5, cos_o) / 0.04
    expected = fresnel[:, None] * material.ks * SOFT.radiance * SOFT.profile(mirrored @ SOFT.axis)[:, None]
    radiance = reflected_radiance(material, [SOFT], [], normals, views)
    # To second order in 2 sigma / width (0.057)^2, with the light's curvature: 1%, grazing a little more.
    assert_allclose(radiance, expected, rtol=0.03)


def test_narrow_area_light_tends_to_a_directional_source(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Its irradiance is smooth where it is looked at: a quarter of the table's angles, which no other test keeps.
    monkeypatch.setattr("synthetic.render.lobes._IRRADIANCE_NODES", 65)
    monkeypatch.setattr("synthetic.render.lobes._irradiance_by_angle", _irradiance_by_angle.__wrapped__)
    # Two formulas of one limit: energy 2 pi w^2 L as irradiance, from one direction.
    material = radiometric(RH01_MATERIALS["steel"])
    axis, width = np.array([0.1, -0.5, 0.8]), 0.02
    spot = AreaLight(axis, np.ones(3), width)
    source = DirectionalSource(axis, np.full(3, 2 * np.pi * width**2))
    normals, views = surface_points(rng, np.linspace(0.4, 1, 100))
    lit = normals @ spot.axis > 0.3
    broad = reflected_radiance(material, [spot], [], normals[lit], views[lit], order=100)
    sharp = reflected_radiance(material, [], [source], normals[lit], views[lit])
    # Second order in width / sigma = 0.1, relative to the peak.
    assert_allclose(broad, sharp, atol=0.02 * sharp.max(), rtol=0.02)


def test_lights_add_up_and_turning_everything_changes_nothing(rng: np.random.Generator) -> None:
    material = radiometric(RH01_MATERIALS["delrin"])
    source = DirectionalSource(np.array([0.5, 0.1, 0.4]), np.array([2.0, 1.0, 0.5]))
    normals, views = surface_points(rng, rng.uniform(0.05, 1, 200))
    together = reflected_radiance(material, [SOFT, UNIFORM], [source], normals, views)
    apart = sum(
        reflected_radiance(material, area, sources, normals, views)
        for area, sources in (([SOFT], []), ([UNIFORM], []), ([], [source]))
    )
    assert_allclose(together, apart, rtol=1e-12)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.linalg.det(turn)
    turned = reflected_radiance(
        material,
        [AreaLight(turn @ SOFT.axis, SOFT.radiance, SOFT.width_rad), UNIFORM],
        [DirectionalSource(turn @ source.direction, source.irradiance)],
        normals @ turn.T,
        views @ turn.T,
    )
    assert_allclose(turned, together, rtol=1e-5)  # single precision within the lobe


def test_poles_backs_and_nothing_at_all_stay_finite() -> None:
    material = radiometric(RH01_MATERIALS["teflon"])
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    radiance = reflected_radiance(material, [SOFT], [], axes, axes)  # seen along the normal: any tangent
    assert np.isfinite(radiance).all()
    assert (radiance > 0).all()
    behind = reflected_radiance(material, [SOFT], [], axes, -axes)
    assert (behind == 0).all()
    assert reflected_radiance(material, [SOFT], [], np.empty((0, 3)), np.empty((0, 3))).shape == (0, 3)
