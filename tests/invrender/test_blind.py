"""Factorization under wholly unknown light, against photographs by brute-force integration over incident directions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from capture.source_region import SourceRegion
from invrender.estimate.clusters import tile_of
from invrender.estimate.unknown_light import factorize_blind, predict_blind
from invrender.estimate.unknown_light.lighting_design import LightingDesign
from invrender.estimate.unknown_light.projection import light_scale
from invrender.estimate.unknown_light.start import NOTHING, Search
from invrender.estimate.unknown_light.uncertainty import blind_uncertainty
from recon.harmonics.basis import evaluate_harmonics, sphere_directions
from recon.sampling.lightfield import LightField
from synthetic.lights.arealight import AreaLight
from synthetic.lights.sources import DirectionalSource
from synthetic.materials.microfacet import MicrofacetMaterial
from synthetic.materials.rh01 import RH01_MATERIALS, radiometric
from synthetic.render.lobes import reflected_radiance

NOISE, FLOOR = 0.01, 0.001
TEFLON = radiometric(RH01_MATERIALS["teflon"])


def photographs(
    bench: SimpleNamespace,
    material: MicrofacetMaterial,
    views: int,
    samples: int,
    lights: Sequence[AreaLight] | None = None,
    sources: Sequence[DirectionalSource] | None = None,
    radius_px: float = 90.0,
) -> list[LightField]:
    """Photographs of a sphere from `views` angles, `samples` in all, without noise."""
    lights = [bench.area_light] if lights is None else lights
    sources = [bench.source] if sources is None else sources
    angles = np.linspace(0, 177, views) if views > 3 else [0, 60, 120][:views]
    photos = []
    for angle in angles:
        field = bench.sphere_field(angle, samples // views, radius_px)
        radiance = reflected_radiance(material, lights, sources, field.normals, field.views)
        photos.append(replace(field, radiance=field.mean_over_rays(radiance)))
    return photos


def noisy(photos: Sequence[LightField], rng: np.random.Generator) -> list[LightField]:
    deviations = [np.hypot(NOISE * photo.radiance, FLOOR * photo.radiance.mean()) for photo in photos]
    return [
        replace(photo, radiance=photo.radiance + deviation * rng.standard_normal(deviation.shape))
        for photo, deviation in zip(photos, deviations, strict=True)
    ]


def share(material: MicrofacetMaterial) -> np.ndarray:
    return np.asarray(material.ks / (material.kd + material.ks))


def first_coefficients(lights: Sequence[AreaLight], sources: Sequence[DirectionalSource]) -> np.ndarray:
    """Harmonic coefficients of all light up to degree 2 over that of degree 0, (9, 3), by equal solid angles."""
    grid = sphere_directions(20000)
    radiance = sum(light.radiance_from(grid) for light in lights)
    total = 4 * np.pi / len(grid) * evaluate_harmonics(grid, 2).T @ radiance
    for source in sources:
        total = total + evaluate_harmonics(source.direction[None], 2).T * source.irradiance
    return np.asarray(total / total[0])


def degrees_apart(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.degrees(2 * np.arcsin(np.linalg.norm(a - b) / 2)))


def test_standard_deviations_of_the_light_hold_what_hangs_together(
    bench: SimpleNamespace, rng: np.random.Generator
):
    views, degree, material, stains = 8, 8, TEFLON, 0.02
    photos = photographs(bench, material, views, 3200)
    designs = [LightingDesign.of([photo], degree) for photo in photos]
    assert material.mu is not None
    truth = NOTHING.with_source(bench.source.direction)
    truth = replace(truth, specular_share=share(material), mu=material.mu, sigma=material.sigma)
    grid = sphere_directions(20000)
    light = 4 * np.pi / len(grid) * evaluate_harmonics(grid, 2).T @ bench.area_light.radiance_from(grid)
    light = light * (material.kd + material.ks)
    # Away from the lamp's horizon, where a highlight ends abruptly.
    clear = [np.abs(photo.sample_normals @ bench.source.direction) > 0.05 for photo in photos]
    ratios = []
    for _ in range(2):
        seen = []
        for photo in noisy(photos, rng):
            tile = np.unique(tile_of(photo), return_inverse=True)[1]
            gain = 1 + stains * rng.standard_normal(tile.max() + 1)
            seen.append(replace(photo, radiance=photo.radiance * gain[tile, None]))
        own = [replace(design, field=photo) for design, photo in zip(designs, seen, strict=True)]
        weights = [
            keep[:, None] / ((NOISE**2 + stains**2) * photo.radiance**2)
            for keep, photo in zip(clear, photos, strict=True)
        ]
        search = Search(own, weights, [np.ones_like(weight) for weight in weights], light_scale(own))
        fit = search.fit(truth, degree)
        ratios.append((fit.light[0][:9] - light) / blind_uncertainty(search, fit).light_std[0][:9])
    # 1.4, for the light takes up a part of the stains; 2.4 were residuals taken for independent.
    assert np.sqrt(np.mean(np.square(ratios))) < 1.7


# What the design asks for: share, mu, sigma.
MANY, FEW = (0.001, 0.015, 0.0003), (0.002, 0.03, 0.0006)


@pytest.mark.parametrize(
    ("name", "views", "samples", "limits"),
    [
        pytest.param("teflon", 12, 12000, MANY, marks=pytest.mark.sweep),
        ("teflon", 3, 6000, FEW),
        # With more of specular reflection fewer samples will do.
        pytest.param("steel", 12, 4000, MANY, marks=pytest.mark.sweep),
        pytest.param("painted", 12, 4000, MANY, marks=pytest.mark.sweep),
    ],
)
def test_brdf_light_and_source_are_found_from_photographs_alone(
    bench: SimpleNamespace,
    rng: np.random.Generator,
    name: str,
    views: int,
    samples: int,
    limits: tuple[float, float, float],
):
    material = radiometric(RH01_MATERIALS[name])
    photos = noisy(photographs(bench, material, views, samples), rng)
    found = factorize_blind(photos, ladder=False)
    assert_allclose(found.brdf_share, share(material), atol=limits[0])
    assert (found.mu is None) == (material.mu is None)
    if found.mu is not None:
        assert_allclose(found.mu, material.mu, atol=limits[1])
    assert_allclose(found.sigma, material.sigma, atol=limits[2])
    assert len(found.light.sources.directions) == 1
    assert degrees_apart(found.light.sources.directions[0], bench.source.direction) < 0.05
    truth = first_coefficients([bench.area_light], [bench.source])
    assert_allclose(found.light.normalised_coefficients[:9], truth, atol=0.003)
    assert {"kd_normalised", "ks_normalised", "sigma"} <= found.quantities.keys()
    assert {quantity.status for quantity in found.quantities.values()} == {"determined"}
    # Few photographs are left out by tiles: without one of three the light would not be seen from all sides.
    assert len(found.candidates[0].deviance) == (views if views > 3 else 10)
    # A view that no photograph shows, from above them all, is predicted far below its noise.
    unseen = bench.sphere_field(30.0, 2000, seed=5)
    expected = unseen.mean_over_rays(
        reflected_radiance(material, [bench.area_light], [bench.source], unseen.normals, unseen.views)
    )
    error = predict_blind(found, unseen) - expected
    assert np.sqrt(np.mean(error**2)) < 0.3 * NOISE * np.sqrt(np.mean(expected**2))


@pytest.mark.sweep
def test_errors_are_those_that_the_covariance_states(bench: SimpleNamespace, rng: np.random.Generator):
    # Light of few degrees, so that six fits are quick; hardly any of it is beyond degree 5.
    light = AreaLight(bench.area_light.axis, bench.area_light.radiance, width_rad=0.7)
    clean = photographs(bench, TEFLON, 6, 1000, lights=[light])
    scores = []
    for _ in range(6):
        found = factorize_blind(noisy(clean, rng), orders=[5], ladder=False)
        assert found.mu is not None
        assert found.sigma is not None
        across = found.light.sources.directions[0] - bench.source.direction
        std = np.sqrt(np.diag(found.covariance))
        error = [*(found.brdf_share - share(TEFLON)), found.mu - 1.78, found.sigma - 0.12]
        way = np.radians(found.light.sources.direction_std_deg[0]) * np.sqrt(2)
        scores.append([*(error / std[:5]), np.linalg.norm(across) / way])
    rms = np.sqrt(np.mean(np.square(scores), axis=0))
    # Six draws scatter by 0.3; shares of three channels, mu and sigma are correlated.
    assert 0.6 < np.sqrt(np.mean(rms[:5] ** 2)) < 1.4
    assert (rms < 1.8).all()
    # That of the direction is the worse of two ways: it may be smaller.
    assert rms[5] > 0.3


def test_a_lambertian_object_is_told_and_shows_light_up_to_degree_two(
    bench: SimpleNamespace, rng: np.random.Generator
):
    matte = MicrofacetMaterial(TEFLON.kd, 0 * TEFLON.ks, TEFLON.mu, TEFLON.sigma)
    found = factorize_blind(noisy(photographs(bench, matte, 5, 1600), rng), orders=[4, 6])
    assert found.model.startswith("lambertian")
    assert found.sigma is None
    assert found.light.determined_degree == 2
    # Nothing at all of degree 3 passes: what is known of it is the prior.
    assert_allclose(found.light.degree_shares[3], 0, atol=0.01)
    assert found.light.doubt is not None
    assert found.light.doubt.status == "undetermined"
    assert "above 2" in found.light.doubt.reason
    assert "passes no odd degrees above 1" in found.light.doubt.reason
    assert "mirror ball" in found.light.doubt.remedy
    # Antipodes differ by light of degree 1 only, which only the demand that light be positive tells apart.
    axis = found.light.sources.directions[0]
    assert min(degrees_apart(axis, way * bench.source.direction) for way in (-1, 1)) < 0.2


def test_the_ladder_needs_fresnel_light_and_source_and_no_more(
    bench: SimpleNamespace, rng: np.random.Generator, few_forms: None
):
    found = factorize_blind(noisy(photographs(bench, TEFLON, 5, 1500), rng), orders=[4, 8])
    assert found.model == "microfacet, lighting of degree 8, 1 source"
    chosen = found.candidates[found.chosen]
    # Noise, relative, is 1%; whoever leaves something out predicts unseen photographs clearly worse.
    assert chosen.error < 1.1 * NOISE
    assert (
        min(candidate.error for k, candidate in enumerate(found.candidates) if k != found.chosen)
        > 1.3 * chosen.error
    )


@pytest.mark.sweep
def test_models_that_leave_much_are_judged_on_a_part_and_nothing_else_changes(
    bench: SimpleNamespace, rng: np.random.Generator, few_forms: None, monkeypatch: pytest.MonkeyPatch
):
    photos = noisy(photographs(bench, TEFLON, 9, 9000), rng)
    looked = factorize_blind(photos, orders=[4, 8])
    monkeypatch.setattr("invrender.estimate.unknown_light.ladder._Glance.of", lambda *_: None)
    whole = factorize_blind(photos, orders=[4, 8])
    assert looked.model == whole.model
    assert [candidate.name for candidate in looked.candidates] == [each.name for each in whole.candidates]
    best = whole.candidates[whole.chosen].error
    for part, all_of_them in zip(looked.candidates, whole.candidates, strict=True):
        if all_of_them.error > 2.5 * best:
            # A quarter of the samples, of which highlights keep more.
            assert part.error > 2 * best
        else:
            assert part.error == pytest.approx(all_of_them.error, rel=0.01)
    numbers = [np.array([*each.brdf_share, each.mu, each.sigma]) for each in (looked, whole)]
    # Steps of fits end at a part of a standard deviation.
    assert (np.abs(numbers[1] - numbers[0]) < 0.05 * np.sqrt(np.diag(whole.covariance))[:5]).all()


def test_sources_are_told_apart_down_to_the_width_of_the_lobe(
    bench: SimpleNamespace, rng: np.random.Generator
):
    beside = [
        DirectionalSource(bench.direction(azimuth, elevation), np.array([0.8, 0.7, 0.9]))
        for azimuth, elevation in ((60, 60), (-16, 25))
    ]
    apart, together = (
        factorize_blind(
            noisy(photographs(bench, TEFLON, 5, 1500, sources=[bench.source, other]), rng),
            orders=[8],
            ladder=False,
        )
        for other in beside
    )
    assert len(apart.light.sources.directions) == 2
    for source in (bench.source, beside[0]):
        assert min(degrees_apart(d, source.direction) for d in apart.light.sources.directions) < 0.15
    # 3.6 degrees beside each other under a lobe of 6.9: one source, between the two, and a warning.
    assert len(together.light.sources.directions) == 1
    widened, sigma = together.quantities["sigma"], TEFLON.sigma
    assert widened.value is not None
    assert widened.std is not None
    assert abs(widened.value[0] - sigma) < 3 * widened.std[0]
    assert degrees_apart(together.light.sources.directions[0], bench.source.direction) < 3.6
    assert "nearer to another than the lobe is wide" in together.warnings[0]
    assert "treated as one" in together.warnings[0]


def test_sources_stay_within_the_region_that_was_given(bench: SimpleNamespace, rng: np.random.Generator):
    # Light of few degrees, so that fits are quick.
    light = AreaLight(bench.area_light.axis, bench.area_light.radiance, width_rad=0.7)
    photos = noisy(photographs(bench, TEFLON, 5, 800, lights=[light]), rng)
    near = SourceRegion(bench.direction(-10, 35), 0.4)
    found = factorize_blind(photos, orders=[5], source_regions={"light": near}, ladder=False)
    assert degrees_apart(found.light.sources.directions[0], bench.source.direction) < 0.05
    away = SourceRegion(bench.direction(160, -40), 0.4)
    found = factorize_blind(photos, orders=[5], source_regions={"light": away}, ladder=False)
    assert not len(found.light.sources.directions)


def test_regions_off_the_sphere_of_directions_are_refused():
    with pytest.raises(ValueError, match=r"length 2, outside the sphere of directions"):
        SourceRegion(np.array([0.0, 0.0, 2.0]), 0.2)
    with pytest.raises(ValueError, match=r"radius is 4\.0 rad, outside the sphere of directions"):
        SourceRegion(np.array([0.0, 0.0, 1.0]), 4.0)


def _one(photos: list[LightField]) -> list[LightField]:
    return photos[:1]


def _few(photos: list[LightField]) -> list[LightField]:
    return [photo.where(np.arange(len(photo)) < 5) for photo in photos]


def _missing(photos: list[LightField]) -> list[LightField]:
    return [photos[0], replace(photos[1], radiance=np.full_like(photos[1].radiance, np.nan))]


def _negative(photos: list[LightField]) -> list[LightField]:
    return [replace(photo, radiance=-photo.radiance) for photo in photos]


def _one_angle(photos: list[LightField]) -> list[LightField]:
    return [replace(photo, views=photo.normals) for photo in photos]


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (_one, "there are 1 photographs; one can't separate light from reflectance"),
        (_few, "10 samples for 31 unknowns"),
        (_missing, "photograph 1: 900 of 900 radiances are not finite"),
        (_negative, "100% of the radiances are zero or negative"),
        (_one_angle, "one exitant angle, 0.0 degrees"),
    ],
)
def test_photographs_that_determine_nothing_are_refused(bench: SimpleNamespace, spoil, message: str):
    photos = photographs(bench, TEFLON, 2, 600, sources=[])
    with pytest.raises(ValueError, match=message):
        factorize_blind(spoil(photos))


def test_a_solution_near_another_starts_from_its_candidates_and_outliers_do_not_spoil_it(
    bench: SimpleNamespace, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
):
    photos = noisy(photographs(bench, TEFLON, 4, 1600), rng)
    dusty = []
    for photo in photos:
        dust = np.where(rng.random(len(photo)) < 0.02, 30, 1)
        dusty.append(replace(photo, radiance=photo.radiance * dust[:, None]))
    first = factorize_blind(dusty, orders=[4], ladder=False)
    # One percent less of all light, and no search: the reflectance is the same.
    less = [photo.less(0.01 * photo.radiance) for photo in dusty]
    monkeypatch.setattr("invrender.estimate.unknown_light.factorize.robust_start", None)
    second = factorize_blind(less, orders=[4], ladder=False, near=first)
    std = np.sqrt(np.diag(first.covariance))
    numbers = [np.array([*each.brdf_share, each.mu, each.sigma]) for each in (first, second)]
    assert (np.abs(numbers[1] - numbers[0]) < 0.5 * std[:5]).all(), (numbers, std)
    assert_allclose(second.light.coefficients[0], 0.99 * first.light.coefficients[0], rtol=0.01)
