"""The ladder of models: the simplest that explains photographs it has not seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from invrender.brdf.microfacet import Microfacet as Fitted
from invrender.estimate.evidence import choose, climb_ladder, fit_strengths, relative_rms
from invrender.estimate.noise import Weights
from invrender.estimate.search import LADDER, fit
from invrender.estimate.statistics import by_lighting, photo_statistics
from invrender.transport.predict import predict_columns
from synthetic.materials.microfacet import MicrofacetMaterial
from synthetic.materials.rh01 import RH01_MATERIALS, radiometric

MATTE = MicrofacetMaterial(np.array([0.1, 0.2, 0.3]), np.zeros(3), None, 0.1)
ANGLES = np.linspace(0, 180, 8)


def weights_of(photos) -> list[Weights]:
    """Of 1% noise, all samples trusted."""
    return [
        Weights(np.ones_like(photo.radiance), (0.01 * photo.radiance.clip(1e-3)) ** -2.0) for photo in photos
    ]


def drawn_noise(noisy, clean) -> list[float]:
    """Relative RMS of the noise that was added to each photograph."""
    return [relative_rms(n.radiance - c.radiance, n.radiance) for n, c in zip(noisy, clean, strict=True)]


@pytest.mark.parametrize(
    ("material", "chosen"),
    [
        (MATTE, "lambertian"),
        (radiometric(RH01_MATERIALS["bronze"]), "microfacet without Fresnel"),
        (radiometric(RH01_MATERIALS["teflon"]), "microfacet"),
    ],
    ids=["matte", "bronze", "teflon"],
)
def test_chooses_the_smallest_model_that_explains(material: MicrofacetMaterial, chosen: str, bench):
    photos = bench.photograph(material, ANGLES, samples=100)
    for seed in range(3):
        noisy = bench.with_noise(photos, np.random.default_rng(seed))
        steps: list[str] = []
        candidates = climb_ladder(
            noisy, weights_of(photos), lambda outcome="", steps=steps: steps.append(outcome)
        )
        best = choose(candidates)
        assert [candidate.estimate.model for candidate in candidates] == list(LADDER)
        assert candidates[best].estimate.model.name == chosen
        # Little is left but the noise that was drawn: the first and last photographs extrapolate from the others.
        assert_allclose(candidates[best].error, np.mean(drawn_noise(noisy, photos)), rtol=0.1)
        assert steps == [candidate.outcome for candidate in candidates]
        assert steps[0].startswith("lambertian: ")
        assert [candidate.parameters for candidate in candidates] == [3, 7, 8]


def test_error_of_a_photograph_is_by_a_fit_that_has_not_seen_it(bench, rng):
    photos = bench.with_noise(bench.photograph(radiometric(RH01_MATERIALS["delrin"]), ANGLES[:4]), rng)
    weights = weights_of(photos)
    candidates = climb_ladder(photos, weights)
    others = by_lighting(
        photo_statistics(p, w.weight) for p, w in list(zip(photos, weights, strict=True))[1:]
    )
    for candidate in candidates:
        brdf = fit(candidate.estimate.model, others).brdf
        residual = photos[0].radiance - predict_columns(photos[0], brdf, np.ones((1, 3)))
        error = np.linalg.norm(residual) / np.linalg.norm(photos[0].radiance)
        # Started from the fit to all, a fold's steps end within their own tolerance of the other end.
        assert_allclose(candidate.photo_errors[0], error, rtol=1e-4)
    spoilt = [bench.with_radiance(photos[0], 1.5 * photos[0].radiance), *photos[1:]]
    again = climb_ladder(spoilt, weights)
    # The first photograph's error is that of the same prediction against 1.5 times the radiance: about a third.
    assert_allclose(again[2].photo_errors[0], 1 / 3, rtol=0.02)
    assert_allclose(candidates[2].photo_errors[0], 0.01, rtol=0.2)


def lit_on_its_own(bench, material: MicrofacetMaterial, angles) -> tuple[list, dict[str, np.ndarray]]:
    """Photographs each under a lighting of its own, strength of source and ambient unknown, and the truth."""
    photos, truth = [], {}
    for k, angle in enumerate(angles):
        strength = (0.5 + k) * np.array([1.0, 1.2, 0.8])
        source = replace(bench.source, irradiance=strength)
        ambient = replace(bench.area_light, width_rad=1e6, radiance=0.1 * strength)
        told = bench.known_lighting(
            [], [source], name=f"light {k}", recover_irradiance=True, recover_ambient=True
        )
        photos += bench.photograph(material, [angle], [ambient], [source], told, samples=200)
        truth[told.name] = np.stack([strength, 0.1 * strength])
    return photos, truth


def test_strengths_of_an_unseen_lighting_are_fitted(bench, rng):
    material = radiometric(RH01_MATERIALS["teflon"])
    photos, truth = lit_on_its_own(bench, material, ANGLES[::2])
    weights = weights_of(photos)
    estimate = fit(
        LADDER[-1], by_lighting(photo_statistics(p, w.weight) for p, w in zip(photos, weights, strict=True))
    )
    # With the true BRDF the strengths come out in the true scale.
    exact = replace(estimate, brdf=Fitted(material.kd, material.ks, material.mu, material.sigma))
    for photo, weight in zip(photos, weights, strict=True):
        assert_allclose(
            fit_strengths(photo, weight.weight, exact), truth[photo.lighting], rtol=5e-3, equal_nan=False
        )
    # A left-out photograph's own light is refitted, whatever its brightness: its error is the noise.
    noisy = bench.with_noise(photos, rng)
    candidates = climb_ladder(noisy, weights)
    chosen = choose(candidates)
    assert candidates[chosen].estimate.model.name == "microfacet"
    # Its own 6 strengths are fitted to its own 600 numbers, 3 of them by the few that the source reaches.
    assert_allclose(candidates[chosen].photo_errors, drawn_noise(noisy, photos), rtol=0.1)
    # 8 of the BRDF and 3 channels of 2 elements of 4 lightings.
    assert candidates[chosen].parameters == 8 + 24


def test_known_light_has_no_strengths_to_fit(bench):
    photo = bench.photograph(MATTE, [30.0], samples=50)[0]
    estimate = fit(LADDER[0], by_lighting([photo_statistics(photo, np.ones_like(photo.radiance))]))
    assert_allclose(fit_strengths(photo, np.ones_like(photo.radiance), estimate), [[1, 1, 1]], rtol=0)


def test_relative_rms_by_hand():
    assert_allclose(relative_rms(np.array([[3.0, 4.0, 0.0]]), np.array([[0.0, 6.0, 8.0]])), 0.5, rtol=1e-15)
