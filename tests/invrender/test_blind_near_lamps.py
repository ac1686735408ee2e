"""Near lamps under unknown light: their distances are found with all else, against radiance computed ray by ray."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from invrender.estimate.unknown_light import BlindSolution, factorize_blind
from invrender.estimate.unknown_light.lamp_frame import LampFrame
from recon.sampling.lightfield import LightField
from synthetic.lights.sources import PointSource
from synthetic.render.lobes import reflected_radiance

from .test_blind import TEFLON, noisy, share

TOWARDS = np.array([0.48, 0.6, 0.64])


def near_photographs(
    bench: SimpleNamespace, lamps: Sequence[PointSource], lit: bool, angles: Sequence[float]
) -> list[LightField]:
    """Photographs without noise of a sphere under near lamps, beside an area light or in the dark."""
    photos = []
    for angle in angles:
        field = bench.sphere_field(angle, 600, 90.0)
        areas = [bench.area_light] if lit else []
        radiance = reflected_radiance(TEFLON, areas, [], field.normals, field.views)
        for lamp in lamps:
            towards, _, irradiance = lamp.at(field.positions)
            cos = np.maximum((field.normals * towards).sum(axis=1), 0)[:, None]
            radiance = radiance + TEFLON.evaluate(field.normals, towards, field.views) * cos * irradiance
        photos.append(replace(field, radiance=field.mean_over_rays(radiance)))
    return photos


def lamp_at(
    bench: SimpleNamespace, radii: float, irradiance: float = 1.0, towards: np.ndarray = TOWARDS
) -> PointSource:
    """A lamp so many radii from the sphere's centre, and its irradiance there."""
    frame = LampFrame.of([bench.sphere_field(0.0, 50)])
    distance = radii * frame.radius
    return PointSource(frame.centre + distance * towards, np.full(3, irradiance * distance**2))


def distance_scores(found: BlindSolution, lamp: PointSource) -> np.ndarray:
    """How far the one lamp's distance and Ks's share, mu and sigma are off, in standard deviations."""
    sources = found.light.sources
    assert sources.closeness is not None
    assert sources.closeness_std is not None
    true = 1 / np.linalg.norm(lamp.position - sources.centre)
    truths = {"ks_normalised": share(TEFLON), "mu": TEFLON.mu, "sigma": TEFLON.sigma}
    others = [
        (found.quantities[name].value - truth) / found.quantities[name].std for name, truth in truths.items()
    ]
    return np.concatenate([(sources.closeness - true) / sources.closeness_std, *others])


def assert_places(found: BlindSolution, lamps: Sequence[PointSource]) -> None:
    """The lamps of an only light are as near as they are, to their error bars, which are small."""
    sources = found.light.sources
    assert sources.closeness is not None
    assert sources.closeness_std is not None
    true = sorted(1 / np.linalg.norm(lamp.position - sources.centre) for lamp in lamps)
    order = np.argsort(sources.closeness)
    assert (np.abs(sources.closeness[order] - true) < 4 * sources.closeness_std[order]).all()
    assert (sources.closeness_std < 0.02 * sources.closeness).all()


def test_the_frame_of_a_sphere_is_the_sphere(bench: SimpleNamespace) -> None:
    seen = bench.sphere_field(0.0, 200)
    frame = LampFrame.of([seen])
    assert_allclose(seen.positions, frame.centre + frame.radius * seen.normals, atol=1e-9)


@pytest.mark.parametrize("lit", [False, True])
def test_a_near_lamp_is_found_where_it_is(
    bench: SimpleNamespace, lit: bool, rng: np.random.Generator
) -> None:
    """Taken for distant it leaves 14% of the radiance, and the share of Ks is 0.29 in place of 0.11."""
    lamp = lamp_at(bench, 6.0, 4.0 if lit else 1.0)
    photos = noisy(near_photographs(bench, [lamp], lit, [0, 60, 120]), rng)
    found = factorize_blind(photos, orders=[6] if lit else [0], ladder=False)
    assert found.model.endswith("1 source (near)")
    z = distance_scores(found, lamp)
    # Six numbers, the channels' shares correlated.
    assert np.sqrt(np.mean(z**2)) < 2
    assert found.light.sources.closeness_std[0] < 0.02 * found.light.sources.closeness[0]
    assert found.light.sources.directions[0] @ TOWARDS > np.cos(np.radians(0.2))


@pytest.mark.parametrize("seed", range(3))
def test_a_distant_lamp_stays_distant(bench: SimpleNamespace, seed: int) -> None:
    photos = near_photographs(bench, [lamp_at(bench, 1e6)], False, [0, 60, 120])
    found = factorize_blind(noisy(photos, np.random.default_rng(seed)), orders=[0], ladder=False)
    assert found.model.endswith("1 source")
    assert found.light.sources.closeness is None


def test_lamps_of_several_lightings_have_distances_of_their_own(
    bench: SimpleNamespace, rng: np.random.Generator
) -> None:
    lamps = [lamp_at(bench, 5.0), lamp_at(bench, 1e6), lamp_at(bench, 12.0)]
    photos = [
        photo for lamp in lamps for photo in noisy(near_photographs(bench, [lamp], False, [20, 90]), rng)
    ]
    names = [name for name in "abc" for _ in range(2)]
    found = factorize_blind(photos, names, orders=[0], ladder=False)
    a, b, c = (found.lights[name].sources for name in "abc")
    assert b.closeness is None
    for lamp, sources in ((lamps[0], a), (lamps[2], c)):
        true = 1 / np.linalg.norm(lamp.position - sources.centre)
        assert abs(sources.closeness[0] - true) < 4 * sources.closeness_std[0] < 0.1 * true


@pytest.mark.sweep
@pytest.mark.parametrize("lit", [False, True])
def test_light_of_a_high_degree_hides_no_near_lamps(
    bench: SimpleNamespace, lit: bool, rng: np.random.Generator
) -> None:
    """Light of degree 10 takes up what two near lamps do: no distance was found, and much was left."""
    lamps = [lamp_at(bench, 5.0, 4.0), lamp_at(bench, 6.0, 3.0, np.array([0.6, -0.64, 0.48]))]
    photos = noisy(near_photographs(bench, lamps, lit, range(-60, 61, 20)), rng)
    found = factorize_blind(photos, orders=[0, 10])
    assert found.model.endswith("2 sources (near)")
    assert_places(found, lamps)


def test_a_second_near_lamp_is_sought_beside_a_first(bench: SimpleNamespace) -> None:
    lamps = [lamp_at(bench, 5.0, 4.0), lamp_at(bench, 16.0, 3.0, np.array([0.6, -0.64, 0.48]))]
    photos = noisy(near_photographs(bench, lamps, True, range(-60, 61, 20)), np.random.default_rng(1))
    found = factorize_blind(photos, orders=[4], ladder=False)
    assert found.model.endswith("2 sources (near)")
    assert_places(found, lamps)


@pytest.mark.sweep
def test_bars_of_distances_hold(bench: SimpleNamespace) -> None:
    lamp, scores = lamp_at(bench, 6.0), []
    clean = near_photographs(bench, [lamp], False, [0, 60, 120])
    for seed in range(24):
        found = factorize_blind(noisy(clean, np.random.default_rng(seed)), orders=[0], ladder=False)
        scores.append(distance_scores(found, lamp))
    rms = np.sqrt(np.mean(np.square(scores), axis=0))
    # 24 draws give an RMS to 15%.
    assert (rms < 1.4).all()
    assert (rms > 0.6).all()
