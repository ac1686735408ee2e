"""Stated deviations of recovered light against its errors, over lights with lamps that no degree holds, and noise."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from invrender.inverse_lighting.coefficients import estimate_coefficients
from invrender.inverse_lighting.dual import estimate_dual
from invrender.inverse_lighting.known_brdf import known_brdf
from invrender.transport.harmonic_rows import PhotoRows, photo_rows
from recon.harmonics.complex import project_sources
from synthetic.lights.sources import DirectionalSource
from synthetic.materials.microfacet import MicrofacetMaterial as Truth
from synthetic.render.lobes import reflected_radiance

BRDF = known_brdf([0.05], [0.2], None, 0.2)
DEGREE, SPARE = 12, 4
# A half circle, as gantries have it: light from behind it shows in grazing highlights only.
VIEWS = tuple(range(0, 180, 12))
LIGHTS, NOISE = 6, 0.002
# Highest degree of what is not lamps.
SMOOTH = 4


@pytest.fixture(scope="module")
def black(bench: SimpleNamespace) -> list[PhotoRows]:
    return [photo_rows(bench.sphere_field(angle, 250), BRDF, DEGREE + SPARE) for angle in VIEWS]


def photographed(black: list[PhotoRows], rng: np.random.Generator) -> tuple[list[PhotoRows], np.ndarray]:
    """Photographs with noise under one to three lamps and smooth light, and that light's coefficients."""
    directions = rng.standard_normal((int(rng.integers(1, 4)), 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    irradiances = rng.uniform(0.3, 1.5, (len(directions), 1)) * np.ones(3)
    smooth = 0.3 * rng.standard_normal(((SMOOTH + 1) ** 2, 1)) * np.ones(3)
    smooth[0] = 4
    lamps = [DirectionalSource(*pair) for pair in zip(directions, irradiances, strict=True)]
    photos = []
    for photo in black:
        field = photo.field
        truth = Truth(BRDF.kd, BRDF.ks, BRDF.mu, BRDF.sigma or 0)
        # Lamps whole, by the formula of the synthetic package.
        seen = field.mean_over_rays(reflected_radiance(truth, [], lamps, field.normals, field.views))
        seen = seen + photo.predict(BRDF, smooth)
        seen = seen + NOISE * np.hypot(seen, seen.mean()) * rng.standard_normal(seen.shape)
        photos.append(replace(photo, field=replace(field, radiance=seen)))
    coefficients = project_sources(directions, irradiances, DEGREE)
    coefficients[: len(smooth)] += smooth
    return photos, coefficients


def test_deviations_of_both_methods_are_those_of_their_errors_under_any_lamps(
    black: list[PhotoRows], rng: np.random.Generator
) -> None:
    ratios = []
    for _ in range(LIGHTS):
        photos, truth = photographed(black, rng)
        direct = estimate_coefficients(photos, BRDF, DEGREE)
        dual = estimate_dual(photos, BRDF, direct)
        both = ((direct.values - truth)[:9] / direct.std[:9], (dual.nine - truth[:9]) / dual.nine_std)
        ratios.append([np.sqrt(np.mean(ratio**2)) for ratio in both])
    # Errors of one light's 27 numbers hang together: their RMS strays by about a fourth from light to light.
    assert np.min(ratios) > 0.45
    assert np.max(ratios) < 1.5
    assert (np.sqrt(np.mean(np.square(ratios), axis=0)) > 0.8).all()
    assert (np.sqrt(np.mean(np.square(ratios), axis=0)) < 1.3).all()
