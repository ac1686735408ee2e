"""Lamps that are looked for only where whoever saw the room says that they are."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from capture.source_region import SourceRegion
from invrender.estimate.unknown_light import factorize_blind
from synthetic.lights.arealight import AreaLight
from synthetic.lights.sources import DirectionalSource
from synthetic.materials.microfacet import MicrofacetMaterial

from .test_blind import TEFLON
from .test_blind_failures import photographs

ANGLES = [0, 72, 144, 216, 288]


@pytest.mark.parametrize(
    "order", [pytest.param(0, id="dark"), pytest.param(6, id="lit", marks=pytest.mark.sweep)]
)
def test_lamps_are_found_in_their_regions_only(bench: SimpleNamespace, rng: np.random.Generator, order: int):
    other = DirectionalSource(bench.direction(110, 20), 0.5 * bench.source.irradiance)
    lights = [bench.area_light] if order else []
    samples = 500 if order else 250
    photos = photographs(bench, rng, TEFLON, ANGLES, lights, [bench.source, other], samples=samples)
    lamps = np.array([bench.source.direction, other.direction])

    def found(regions: dict[str, SourceRegion]) -> np.ndarray:
        own = factorize_blind(photos, orders=[order], source_regions=regions, ladder=False)
        return own.light.sources.directions

    # Light of degree 6 is too smooth for the window: three lamps more stand in for it.
    assert len(found({})) == (5 if order else 2)
    both = found({"light": SourceRegion(lamps, np.full(2, 0.3))})
    assert (np.sort(np.degrees(np.arccos(np.clip(both @ lamps.T, -1, 1))), axis=0)[0] < 0.5).all()
    assert len(both) == 2
    first = SourceRegion(lamps[0], 0.3)
    assert first.holds(found({"light": first})).all()


def test_a_region_is_of_its_lighting_alone_and_an_empty_one_is_said(
    bench: SimpleNamespace, rng: np.random.Generator
):
    def seen(along: list[float]) -> list:
        return photographs(bench, rng, TEFLON, along, [bench.area_light], [bench.source], samples=200)

    photos, names = seen(ANGLES) + seen(ANGLES), ["day"] * 5 + ["night"] * 5
    away = {
        "night": SourceRegion(-bench.source.direction, 0.4),
        "unheard of": SourceRegion(np.eye(3)[0], 0.1),
    }
    found = factorize_blind(photos, names, orders=[6], source_regions=away, ladder=False)
    assert len(found.lights["day"].sources.directions) == 1
    assert not len(found.lights["night"].sources.directions)
    said = [warning for warning in found.warnings if "source region" in warning]
    assert len(said) == 1
    assert "'night'" in said[0]


def test_a_region_says_on_which_side_a_lamp_is_that_shading_shows(
    bench: SimpleNamespace, rng: np.random.Generator
):
    """A Lambertian body shows a weak lamp and its antipode alike beside light of degree 1."""
    sky = AreaLight(np.array([0.0, 0.0, 1.0]), np.ones(3), width_rad=30.0)
    lamp = DirectionalSource(np.array([0.8, 0.4, 0.4]), np.full(3, 0.3 * np.pi))
    matte = MicrofacetMaterial(TEFLON.kd, 0 * TEFLON.ks, TEFLON.mu, TEFLON.sigma)
    photos = photographs(bench, rng, matte, ANGLES, [sky], [lamp], samples=200)
    for side in (1, -1):
        region = SourceRegion(side * lamp.direction, 0.5)
        found = factorize_blind(photos, orders=[4], source_regions={"light": region})
        (way,) = found.light.sources.directions
        assert side * way @ lamp.direction > np.cos(np.radians(1))
        assert found.light.sources.direction_std_deg[0] < 1
        assert not any("opposite side" in warning for warning in found.warnings)
    open_to = replace(region, radii=np.array([np.pi]))
    found = factorize_blind(photos, orders=[4], source_regions={"light": open_to})
    assert any("opposite side" in warning for warning in found.warnings)
