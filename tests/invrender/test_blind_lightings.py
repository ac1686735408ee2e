"""Factorization under several unknown lightings at once, against photographs by brute-force integration."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from invrender.estimate.unknown_light import BlindLight, BlindSolution, factorize_blind, predict_blind
from recon.harmonics.basis import evaluate_harmonics, sphere_directions
from recon.sampling import lightfield
from recon.sampling.lightfield import LightField
from synthetic.lights.arealight import AreaLight
from synthetic.lights.sources import DirectionalSource
from synthetic.materials.microfacet import MicrofacetMaterial
from synthetic.materials.rh01 import RH01_MATERIALS, radiometric
from synthetic.render.lobes import reflected_radiance

NOISE, FLOOR = 0.01, 0.001
TEFLON = radiometric(RH01_MATERIALS["teflon"])
Light = tuple[list[AreaLight], list[DirectionalSource]]


def photograph(
    bench: SimpleNamespace, material: MicrofacetMaterial, light: Light, angle: float, samples: int
) -> LightField:
    field = bench.sphere_field(angle, samples, 90.0)
    radiance = reflected_radiance(material, *light, field.normals, field.views)
    return replace(field, radiance=field.mean_over_rays(radiance))


def noisy(photo: LightField, rng: np.random.Generator) -> LightField:
    deviation = np.hypot(NOISE * photo.radiance, FLOOR * photo.radiance.mean())
    return replace(photo, radiance=photo.radiance + deviation * rng.standard_normal(deviation.shape))


def first_coefficients(light: Light) -> np.ndarray:
    """Harmonic coefficients of a light up to degree 2, (9, 3), by equal solid angles."""
    grid = sphere_directions(20000)
    total = sum((area.radiance_from(grid) for area in light[0]), np.zeros((len(grid), 3)))
    total = 4 * np.pi / len(grid) * evaluate_harmonics(grid, 2).T @ total
    for source in light[1]:
        total = total + evaluate_harmonics(source.direction[None], 2).T * source.irradiance
    return np.asarray(total)


def first_coefficients_of(light: BlindLight) -> np.ndarray:
    """The same of a recovered light."""
    sources = light.sources
    return light.coefficients[:9] + sum(
        (
            evaluate_harmonics(direction[None], 2).T * irradiance
            for direction, irradiance in zip(sources.directions, sources.irradiances, strict=True)
        ),
        np.zeros((9, 3)),
    )


def degrees_apart(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.degrees(2 * np.arcsin(np.linalg.norm(a - b) / 2)))


def three_lights(bench: SimpleNamespace) -> dict[str, Light]:
    """A window and a lamp; a brighter, redder lamp; a soft light from below."""
    return {
        "window": ([bench.area_light], [bench.source]),
        "lamp": (
            [AreaLight(bench.direction(60, 0), np.array([0.3, 0.3, 0.3]), width_rad=0.6)],
            [DirectionalSource(bench.direction(70, 50), np.array([3.0, 2.4, 1.8]))],
        ),
        "soft": ([AreaLight(bench.direction(80, -30), np.array([2.0, 2.0, 2.0]), width_rad=0.5)], []),
    }


def errors(found: BlindSolution, truth: MicrofacetMaterial) -> tuple[np.ndarray, np.ndarray]:
    """Errors and standard deviations of shares, mu and sigma."""
    assert found.mu is not None
    assert found.sigma is not None
    share = truth.ks / (truth.kd + truth.ks)
    error = [*(found.brdf_share - share), found.mu - truth.mu, found.sigma - truth.sigma]
    return np.array(error), np.sqrt(np.diag(found.covariance))[:5]


VIEWS = {"window": (0, 70, 140), "lamp": (10, 60), "soft": (30, 90, 120, 150)}


@pytest.fixture(scope="module")
def lit(bench: SimpleNamespace) -> tuple[list[LightField], list[str]]:
    """Nine photographs with noise, and whose light each is under."""
    lights, rng = three_lights(bench), np.random.default_rng(11)
    of = [name for name, views in VIEWS.items() for _ in views]
    angles = [angle for views in VIEWS.values() for angle in views]
    photos = [
        noisy(photograph(bench, TEFLON, lights[name], angle, 400), rng)
        for name, angle in zip(of, angles, strict=True)
    ]
    return photos, of


def test_three_lightings_and_what_they_shine_on(
    bench: SimpleNamespace, lit: tuple[list[LightField], list[str]]
):
    photos, of = lit
    found = factorize_blind(photos, of, orders=[8, 12], ladder=False)
    error, std = errors(found, TEFLON)
    # Five numbers, three of them much alike: one set in two hundred is beyond three.
    assert (np.abs(error) < 3 * std).all()
    scale, off = TEFLON.kd + TEFLON.ks, []
    for name, light in three_lights(bench).items():
        seen = found.lights[name]
        # In the gauge Kd + Ks = 1 radiance is larger by their sum: lightings keep their strengths among each other.
        truth = first_coefficients(light) * scale
        off.append(first_coefficients_of(seen) / truth[0] - truth / truth[0])
        assert len(seen.sources.directions) == len(light[1])
        for direction, way, source in zip(
            seen.sources.directions, seen.sources.direction_std_deg, light[1], strict=True
        ):
            # Two ways, neither worse than `way`.
            assert degrees_apart(direction, source.direction) < 3 * np.sqrt(2) * way < 0.1
        for found_here, own_std, source in zip(
            seen.sources.irradiances, seen.sources.irradiance_std, light[1], strict=True
        ):
            assert (np.abs(found_here - source.irradiance * scale) < 3.5 * own_std).all()
    # The lamp was seen from two sides that lie close together: its slow light is known to 1%.
    assert_allclose(np.array(off), 0, atol=0.02)
    assert np.abs(off[0]).max() < 0.003
    # The window says less alone than all of them do; the other two would even get the model wrong.
    window = [photo for photo, own in zip(photos, of, strict=True) if own == "window"]
    alone = factorize_blind(window, orders=[8, 12], ladder=False)
    assert (errors(alone, TEFLON)[1] > std).all()


def test_working_on_photographs_together_changes_nothing(
    bench: SimpleNamespace, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
):
    lights = three_lights(bench)
    order = ["window", "soft", "soft", "window"]
    photos = [
        noisy(photograph(bench, TEFLON, lights[name], 30 * k, 90 + 10 * k), rng)
        for k, name in enumerate(order)
    ]
    together = factorize_blind(photos, order, orders=[4], ladder=False)
    monkeypatch.setattr(lightfield, "_POOL", 1)
    apart = factorize_blind(photos, order, orders=[4], ladder=False)
    # Searches end within what sums in another order, in single precision, make of them.
    assert_allclose(together.brdf_share, apart.brdf_share, rtol=1e-4)
    assert_allclose([together.mu, together.sigma], [apart.mu, apart.sigma], rtol=1e-4)
    assert_allclose(np.diag(together.covariance), np.diag(apart.covariance), rtol=1e-2)
    for name in ("window", "soft"):
        assert_allclose(together.lights[name].coefficients, apart.lights[name].coefficients, atol=1e-3)
    # What is told of photographs is told in their order.
    assert [len(own.trust) for own in together.weights] == [len(photo) for photo in photos]
    assert_allclose(together.candidates[0].photo_errors, apart.candidates[0].photo_errors, rtol=1e-3)
    for own, other in zip(together.weights, apart.weights, strict=True):
        assert_allclose(own.weight, other.weight, rtol=1e-2)


@pytest.mark.sweep
def test_one_light_under_two_names_is_the_same_light(bench: SimpleNamespace, rng: np.random.Generator):
    light = three_lights(bench)["window"]
    photos = [
        noisy(photograph(bench, TEFLON, light, angle, 300), rng) for angle in (0, 35, 70, 105, 140, 175)
    ]
    one = factorize_blind(photos, orders=[8], ladder=False)
    two = factorize_blind(photos, ["a", "b"] * 3, orders=[8], ladder=False)
    (error, std), (other, other_std) = errors(one, TEFLON), errors(two, TEFLON)
    # Seen through less that is shared, but hardly: half of the photographs show all of this light. Standard deviations
    # go by residuals, which clusters know to a fifth.
    assert_allclose(other_std, std, rtol=0.3)
    assert (np.abs(error - other) < std).all()
    for a, b in ((two.lights["a"], two.lights["b"]), (one.light, two.lights["a"])):
        assert degrees_apart(a.sources.directions[0], b.sources.directions[0]) < 0.1
        assert_allclose(a.normalised_coefficients[:9], b.normalised_coefficients[:9], atol=0.006)
        assert_allclose(a.sources.irradiances, b.sources.irradiances, rtol=0.01)
    assert not two.warnings
    lonely = factorize_blind(photos, ["a"] * 5 + ["b"], orders=[4], ladder=False)
    # At so low a degree lamps stand in for the window; that some are no points is told first.
    warning = lonely.warnings[-1]
    assert warning.startswith("a single photograph was taken under lighting 'b'")


def test_lamps_in_the_dark_are_told_from_a_single_side(
    bench: SimpleNamespace, rng: np.random.Generator, few_forms: None
):
    ways = [(-30, 20), (40, 45), (10, 70), (75, 10)]
    lamps = [
        DirectionalSource(bench.direction(*way), np.full(3, 1.0 + 0.3 * k)) for k, way in enumerate(ways)
    ]
    photos = [noisy(photograph(bench, TEFLON, ([], [lamp]), 0, 300), rng) for lamp in lamps]
    names = [f"lamp {k}" for k in range(len(lamps))]
    found = factorize_blind(photos, names, orders=[0, 2])
    assert found.model == "microfacet, lighting of degree 0, 4 sources"
    # Lamps in the dark leave no light that could take up what the formula doesn't explain.
    assert not found.warnings
    error, std = errors(found, TEFLON)
    assert (np.abs(error) < 3 * std).all()
    for name, lamp in zip(names, lamps, strict=True):
        (seen,) = found.lights[name].sources.directions
        assert degrees_apart(seen, lamp.direction) < 0.3
    strengths = np.array([found.lights[name].sources.irradiances[0] for name in names])
    assert_allclose(
        strengths / strengths[0], [lamp.irradiance / lamps[0].irradiance for lamp in lamps], rtol=0.02
    )
    # Each photograph is predicted in its own light.
    for photo, name in zip(photos, names, strict=True):
        left = photo.radiance - predict_blind(found, photo, found.lights[name])
        assert np.sqrt(np.mean(left**2)) < 1.1 * NOISE * np.sqrt(np.mean(photo.radiance**2))


def test_lightings_must_be_named_for_each_photograph(lit: tuple[list[LightField], list[str]]):
    photos, of = lit
    with pytest.raises(ValueError, match="lightings of 8 photographs; there are 9"):
        factorize_blind(photos, of[:8])
    few = [photos[0], photos[1].where(np.arange(len(photos[1])) < 5)]
    with pytest.raises(ValueError, match="5 samples under lighting 'b' for 31 unknowns"):
        factorize_blind(few, ["a", "b"])
