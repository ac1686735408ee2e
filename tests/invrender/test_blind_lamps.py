"""Lamps that are no points, under unknown light, against photographs under many small ones all over a disc."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from invrender.estimate.unknown_light import BlindSolution, factorize_blind
from recon.harmonics.basis import evaluate_harmonics, sphere_directions
from synthetic.lights.arealight import AreaLight
from synthetic.lights.sources import DirectionalSource
from synthetic.materials.microfacet import MicrofacetMaterial
from synthetic.materials.rh01 import RH01_MATERIALS, radiometric
from synthetic.render.lobes import reflected_radiance

from .test_blind import TEFLON, noisy, photographs

MATERIAL = replace(TEFLON, sigma=0.06)
RADIUS_DEG, POINTS = 3.0, 61


def disc(source: DirectionalSource) -> list[DirectionalSource]:
    """A source as points that are spread evenly over a disc (Vogel's spiral)."""
    first = np.cross(source.direction, [0, 0, 1])
    axes = np.stack([first, np.cross(source.direction, first)]) / np.linalg.norm(first)
    place = np.arange(POINTS) + 0.5
    radius = np.tan(np.radians(RADIUS_DEG)) * np.sqrt(place / POINTS)
    angle = place * np.pi * (3 - np.sqrt(5))
    ways = source.direction + (radius * [np.cos(angle), np.sin(angle)]).T @ axes
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    return [DirectionalSource(way, source.irradiance / POINTS) for way in ways]


def light_scores(
    found: BlindSolution, material: MicrofacetMaterial, light: AreaLight, irradiance: np.ndarray
) -> np.ndarray:
    """Errors of the lamp's irradiance and of the first nine coefficients beside it, in their standard deviations."""
    grid = sphere_directions(20000)
    true = 4 * np.pi / len(grid) * evaluate_harmonics(grid, 2).T @ light.radiance_from(grid)
    total = material.kd + material.ks
    own, sources = found.light, found.light.sources
    smooth = (own.coefficients[:9] - true * total) / own.coefficients_std[:9]
    return np.vstack([smooth, (sources.irradiances - irradiance * total) / sources.irradiance_std])


@pytest.mark.parametrize("is_wide", [True, pytest.param(False, marks=pytest.mark.sweep)])
def test_a_wide_lamp_is_seen_to_be_wide_and_error_bars_hold_it(
    bench: SimpleNamespace, rng: np.random.Generator, is_wide: bool
):
    light = AreaLight(bench.area_light.axis, bench.area_light.radiance, width_rad=0.7)
    lamps = disc(bench.source) if is_wide else [bench.source]
    photos = noisy(photographs(bench, MATERIAL, 6, 2000, lights=[light], sources=lamps), rng)
    found = factorize_blind(photos, orders=[6], ladder=False)
    z = light_scores(found, MATERIAL, light, bench.source.irradiance)
    # Thirty numbers, correlated as the channels' lamp is one; without the width's part the wide lamp's lie at 2.
    assert np.sqrt(np.mean(z**2)) < 1.5
    assert abs(found.quantities["sigma"].value[0] - MATERIAL.sigma) < 3 * found.quantities["sigma"].std[0]
    told = [text for text in found.warnings if "looks like a disc" in text]
    assert len(told) == is_wide
    if is_wide:
        # Two highlights' widths off, where the first order is a rough one.
        degrees = float(told[0].split("disc of ")[1].split()[0])
        assert degrees == pytest.approx(RADIUS_DEG, rel=0.2)
    else:
        # A point's numbers are known as well as before.
        assert (found.light.sources.irradiance_std < 0.01 * found.light.sources.irradiances).all()


def test_a_lamp_whose_highlights_are_a_few_pixels_is_found(bench: SimpleNamespace, rng: np.random.Generator):
    """An even choice of the samples that the search begins with has one of each highlight, or none."""
    material = replace(TEFLON, ks=TEFLON.kd / 9, sigma=0.03)
    light = AreaLight(bench.area_light.axis, bench.area_light.radiance, width_rad=0.7)
    photos = noisy(photographs(bench, material, 6, 12000, lights=[light], radius_px=40.0), rng)
    found = factorize_blind(photos, orders=[4], ladder=False)
    assert len(found.light.sources.directions) == 1
    assert found.light.sources.directions[0] @ bench.source.direction > np.cos(np.radians(0.1))
    for name, truth in (("ks_normalised", 0.1), ("mu", material.mu), ("sigma", 0.03)):
        quantity = found.quantities[name]
        assert quantity.status == "determined"
        assert (np.abs(quantity.value - truth) < 4 * quantity.std).all()


@pytest.mark.parametrize("lit", [pytest.param(False, marks=pytest.mark.sweep), True])
def test_many_lamps_are_found_in_the_dark_and_beside_a_window(bench: SimpleNamespace, lit: bool):
    ways = [(-20, 25), (130, 20), (60, 60), (200, 10), (-70, -20), (95, -40)]
    lamps = [DirectionalSource(bench.direction(*way), np.full(3, 1 + 0.3 * k)) for k, way in enumerate(ways)]
    lights = [bench.area_light] if lit else []
    material = radiometric(RH01_MATERIALS["delrin"]) if lit else TEFLON
    photos = []
    for angle in np.linspace(0, 300, 6 if lit else 4):
        field = bench.sphere_field(angle, 250 if lit else 300, 90.0)
        radiance = reflected_radiance(material, lights, lamps, field.normals, field.views)
        photos.append(replace(field, radiance=field.mean_over_rays(radiance)))
    # In the dark the diffuse part alone shows two of them, light of degree 10 all; beside a window delrin's highlights
    # look like nonsense at first, and what is judged anew is not the worse for it.
    orders = [10] if lit else [0, 10]
    found = factorize_blind(noisy(photos, np.random.default_rng(1)), orders=orders, ladder=not lit)
    assert found.model == f"microfacet, lighting of degree {orders[0]}, {len(lamps)} sources"
    mu = found.quantities["mu"]
    # 0.0034 and 0.001 are what noise does; with five of them beside the window 0.028 was stated.
    assert abs(mu.value[0] - material.mu) < 3 * mu.std[0] < 0.012
