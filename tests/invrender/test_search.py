"""The nested search: it finds what the photographs were made of, whatever the units, order and gauge."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from invrender.estimate.linear import recovers_light
from invrender.estimate.models import Estimate, Model
from invrender.estimate.search import LADDER, fit
from invrender.estimate.statistics import Statistics, by_lighting, photo_statistics
from invrender.transport.columns import PhotoColumns
from invrender.transport.predict import predict_columns
from synthetic.materials.microfacet import MicrofacetMaterial
from synthetic.materials.rh01 import RH01_MATERIALS, radiometric

LAMBERTIAN, METAL, DIELECTRIC = LADDER
ANGLES = np.linspace(0, 180, 8)


def statistics_of(photos: list[PhotoColumns]) -> tuple[Statistics, ...]:
    """With weights of relative noise, as the second fit has them."""
    return by_lighting(photo_statistics(p, 1 / (p.radiance**2 + 1e-6)) for p in photos)


def model_of(material: MicrofacetMaterial) -> Model:
    return DIELECTRIC if material.mu else METAL


# One with a base and a lobe, and one of a metal; the others differ in their numbers alone.
MATERIALS = [
    name if name in ("teflon", "steel") else pytest.param(name, marks=pytest.mark.slow)
    for name in RH01_MATERIALS
]


def assert_same_brdf(one: Estimate, other: Estimate, scale: float = 1.0) -> None:
    """Within what the simplex leaves: it stops at 1e-6 in log sigma and log(mu - 1)."""
    assert_allclose(one.brdf.kd * scale, other.brdf.kd, rtol=1e-5, equal_nan=False)
    assert_allclose(one.brdf.ks * scale, other.brdf.ks, rtol=1e-4, equal_nan=False)
    assert_allclose(one.brdf.sigma, other.brdf.sigma, rtol=2e-5)
    assert_allclose(one.brdf.mu, other.brdf.mu, rtol=1e-4)


@pytest.fixture(scope="module")
def teflon_photos(bench):
    return bench.photograph(radiometric(RH01_MATERIALS["teflon"]), ANGLES)


@pytest.mark.parametrize("name", MATERIALS)
def test_all_materials_in_known_light(name: str, bench):
    material = radiometric(RH01_MATERIALS[name])
    photos = bench.photograph(material, ANGLES)
    estimate = fit(model_of(material), statistics_of(photos))
    # The only errors are of the quadratures, theirs and ours (0.1% per sample), averaged over a thousand samples.
    # The budget is 0.3% of Kd and Ks, 0.01 in mu and 0.0003 in sigma.
    assert_allclose(estimate.brdf.kd, material.kd, rtol=5e-4, atol=1e-4 * material.ks.max(), equal_nan=False)
    assert_allclose(estimate.brdf.ks, material.ks, rtol=1e-3, equal_nan=False)
    assert_allclose(estimate.brdf.sigma, material.sigma, atol=1e-4)
    if material.mu:
        assert_allclose(estimate.brdf.mu, material.mu, atol=2e-3)
    assert_allclose(estimate.strengths["light"], np.ones((1, 3)), rtol=0)


@pytest.mark.parametrize("name", MATERIALS)
def test_all_materials_in_light_of_unknown_strength(name: str, bench):
    # Each photograph has a lighting of its own: a source whose direction alone is known, and an ambient.
    material = radiometric(RH01_MATERIALS[name])
    photos = []
    truth = {}
    ambient = replace(bench.area_light, width_rad=1e6)
    for k, angle in enumerate(ANGLES[::2]):
        strength = 1 + 0.3 * np.sin(k + np.arange(3))
        source = replace(bench.source, irradiance=strength)
        light = replace(ambient, radiance=0.1 * strength[::-1])
        told = bench.known_lighting(
            [], [source], name=f"light {k}", recover_irradiance=True, recover_ambient=True
        )
        photos += bench.photograph(material, [angle], [light], [source], told)
        truth[told.name] = np.stack([strength, light.radiance])
    statistics = statistics_of(photos)
    assert recovers_light(statistics)
    estimate = fit(model_of(material), statistics)
    share = estimate.brdf.ks / (estimate.brdf.kd + estimate.brdf.ks)
    # Budget for unknown light: 0.001 in the share, 0.015 in mu, 0.0003 in sigma.
    assert_allclose(share, material.ks / (material.kd + material.ks), atol=5e-4, equal_nan=False)
    assert_allclose(estimate.brdf.sigma, material.sigma, atol=1e-4)
    if material.mu:
        assert_allclose(estimate.brdf.mu, material.mu, atol=5e-3)
    # The gauge: the sources' mean is 1 per channel, and all else relative to it.
    scale = np.mean([strengths[0] for strengths in truth.values()], axis=0)
    for lighting, strengths in truth.items():
        assert_allclose(estimate.strengths[lighting] * scale, strengths, rtol=5e-3, equal_nan=False)
    assert_allclose(estimate.brdf.kd / scale, material.kd, rtol=2e-3, atol=3e-4 * material.ks.max())


def test_known_light_beside_unknown_fixes_the_scale(bench):
    material = radiometric(RH01_MATERIALS["delrin"])
    told = bench.known_lighting(recover_irradiance=True)  # the map is known
    photos = bench.photograph(material, ANGLES, told=told)
    estimate = fit(DIELECTRIC, statistics_of(photos))
    # As bright as the map tells, and the source measured against it.
    assert_allclose(estimate.brdf.kd, material.kd, rtol=2e-3)
    assert_allclose(estimate.strengths["light"], [np.ones(3), bench.source.irradiance], rtol=3e-3)


def test_a_lambertian_object_has_no_specular_part(bench, rng):
    matte = MicrofacetMaterial(np.array([0.1, 0.2, 0.3]), np.zeros(3), None, 0.1)
    photos = bench.photograph(matte, ANGLES)
    flat = fit(LAMBERTIAN, statistics_of(photos))
    assert_allclose(flat.brdf.kd, matte.kd, rtol=5e-4)  # the map's pixels and degrees
    assert flat.brdf.sigma is None
    assert flat.brdf.mu is None
    for photographs in (photos, bench.with_noise(photos, rng)):
        estimate = fit(DIELECTRIC, statistics_of(photographs))
        # Never below zero, where noise alone would put it half of the time. Without noise the 0.1% that the
        # map's pixels leave are fitted by a lobe as broad as half a radian; with it, a few standard deviations.
        assert (estimate.brdf.ks >= 0).all()
        assert (estimate.brdf.ks < 6e-3 * estimate.brdf.kd).all()


def test_a_mirror_has_no_diffuse_part(bench, rng):
    mirror = MicrofacetMaterial(np.zeros(3), np.array([0.5, 0.6, 0.7]), None, 0.15)
    for photos in (p := bench.photograph(mirror, ANGLES), bench.with_noise(p, rng)):
        estimate = fit(METAL, statistics_of(photos))
        assert (estimate.brdf.kd >= 0).all()
        assert (estimate.brdf.kd < 2e-3 * mirror.ks).all()
        assert_allclose(
            estimate.brdf.ks, mirror.ks, rtol=4e-3
        )  # 0.1% is a standard deviation of the noisy one


@pytest.mark.parametrize("factor", [1e-4, 40.0])
def test_brighter_light_makes_a_darker_object(factor: float, bench):
    material = radiometric(RH01_MATERIALS["teflon"])
    lights = [replace(bench.area_light, radiance=factor * bench.area_light.radiance)]
    sources = [replace(bench.source, irradiance=factor * bench.source.irradiance)]
    told = bench.known_lighting(lights, sources)
    photos = bench.photograph(material, ANGLES[::3], told=told)
    unscaled = bench.photograph(material, ANGLES[::3])
    weights = [1 / (p.radiance**2 + 1e-6) for p in photos]
    scaled_fit = fit(
        DIELECTRIC, by_lighting(photo_statistics(p, w) for p, w in zip(photos, weights, strict=True))
    )
    reference = fit(DIELECTRIC, statistics_of(unscaled))
    assert_same_brdf(scaled_fit, reference, scale=factor)


def test_units_of_the_photographs_change_the_scale_alone(teflon_photos, bench):
    bright = [bench.with_radiance(photo, 1e5 * photo.radiance) for photo in teflon_photos]
    weights = [1 / (photo.radiance**2 + 1e-6) for photo in teflon_photos]
    estimate = fit(
        DIELECTRIC, by_lighting(photo_statistics(p, w) for p, w in zip(bright, weights, strict=True))
    )
    assert_same_brdf(estimate, fit(DIELECTRIC, statistics_of(teflon_photos)), scale=1e-5)


def test_order_of_photographs_does_not_matter(teflon_photos, bench, rng):
    noisy = bench.with_noise(teflon_photos, rng)
    forwards = fit(DIELECTRIC, statistics_of(noisy))
    shuffled = fit(DIELECTRIC, statistics_of([noisy[k] for k in rng.permutation(len(noisy))]))
    assert_same_brdf(shuffled, forwards)
    assert_allclose(shuffled.cost, forwards.cost, rtol=1e-8)


def test_a_start_nearby_reaches_the_same_minimum(teflon_photos, bench, rng):
    statistics = statistics_of(bench.with_noise(teflon_photos, rng))
    from_scratch = fit(DIELECTRIC, statistics)
    other = fit(DIELECTRIC, statistics_of(bench.with_noise(teflon_photos, rng)))
    assert_same_brdf(fit(DIELECTRIC, statistics, start=other), from_scratch)


def test_no_other_parameters_fit_better(teflon_photos, bench, rng):
    noisy = bench.with_noise(teflon_photos, rng)
    best = fit(DIELECTRIC, statistics_of(noisy))

    def cost(brdf: MicrofacetMaterial) -> float:
        total = 0.0
        for photo, clean in zip(noisy, noisy, strict=True):
            residual = photo.radiance - predict_columns(photo, brdf, np.ones((1, 3)))
            total += float((residual**2 / (clean.radiance**2 + 1e-6)).sum())
        return total

    lowest = cost(best.brdf)
    for change in (0.999, 1.001):
        for name in ("kd", "ks", "mu", "sigma"):
            moved = replace(best.brdf, **{name: getattr(best.brdf, name) * change})
            assert cost(moved) > lowest
