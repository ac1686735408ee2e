"""Stated standard deviations against the scatter of estimates over fresh draws of noise."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from capture.lighting import Lighting
from invrender.brdf.lobes import GGX_FORM
from invrender.brdf.microfacet import SIGMA_RANGE, Microfacet
from invrender.estimate.jacobian import Parameters, pack
from invrender.estimate.models import Estimate
from invrender.estimate.noise import fit_noise, photo_weights
from invrender.estimate.search import LADDER, fit
from invrender.estimate.solution import factorize
from invrender.estimate.statistics import by_lighting, photo_statistics
from invrender.estimate.uncertainty import uncertainty_of
from invrender.transport.columns import PhotoColumns
from invrender.transport.predict import predict_columns
from synthetic.lights.sources import DirectionalSource
from synthetic.materials.rh01 import RH01_MATERIALS, radiometric

from .fewforms import few_forms_tried

TEFLON = radiometric(RH01_MATERIALS["teflon"])
ANGLES = np.linspace(0, 180, 10)
Report = Callable[[Parameters], Callable[[np.ndarray], np.ndarray]]


def solve(photos: Sequence[PhotoColumns], report: Report, start: Estimate) -> tuple[np.ndarray, np.ndarray]:
    """Reported values and standard deviations: two fits and the covariance, without the ladder.

    Nothing is added for what the model lacks, so that the deviations are those of the noise alone.
    """
    first = fit(LADDER[-1], statistics_of(photos, [np.ones_like(p.radiance) for p in photos]), start)
    predictions = [predict_columns(p, first.brdf, first.strengths[p.lighting]) for p in photos]
    residuals = [p.radiance - q for p, q in zip(photos, predictions, strict=True)]
    noise = fit_noise(predictions, residuals)
    weights = [photo_weights(noise, *pair).weight for pair in zip(predictions, residuals, strict=True)]
    estimate = fit(LADDER[-1], statistics_of(photos, weights), first)
    parameters = pack(estimate, {p.lighting: p.elements for p in photos})
    numbers = report(parameters)
    covariance = uncertainty_of(numbers, parameters, estimate, photos, weights).covariance
    assert_allclose(covariance, covariance.T, rtol=1e-9)
    return numbers(parameters.vector), np.sqrt(np.diag(covariance))


def statistics_of(photos: Sequence[PhotoColumns], weights: Sequence[np.ndarray]):
    return by_lighting(photo_statistics(p, w) for p, w in zip(photos, weights, strict=True))


def everything(parameters: Parameters) -> Callable[[np.ndarray], np.ndarray]:
    """In known light each number is its own: mu, sigma, Kd, Ks."""
    return lambda vector: vector


def free_of_the_gauge(parameters: Parameters) -> Callable[[np.ndarray], np.ndarray]:
    """mu, sigma, the share of Ks, and each strength times the albedo: what the scale leaves alone."""
    names = [name for name in parameters.places if "/" in name]

    def numbers(vector: np.ndarray) -> np.ndarray:
        brdf = parameters.brdf(vector)
        strengths = [brdf.kd * vector[parameters.places[name]] for name in names]
        return np.concatenate([[brdf.mu, brdf.sigma], brdf.ks / (brdf.kd + brdf.ks), *strengths])

    return numbers


def simulate(photos, report: Report, perturb, draws: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Truth (k,), estimates and stated deviations (draws, k)."""
    start = fit(LADDER[-1], statistics_of(photos, [1 / p.radiance**2 for p in photos]))
    runs = [solve(perturb(), report, start) for _ in range(draws)]
    # What the fit finds without noise: it differs from the truth by our quadratures, a test of their own.
    truth = report(parameters := pack(start, {p.lighting: p.elements for p in photos}))(parameters.vector)
    return truth, np.array([run[0] for run in runs]), np.array([run[1] for run in runs])


def coverage(truth: np.ndarray, estimates: np.ndarray, stated: np.ndarray) -> np.ndarray:
    return (np.abs(estimates - truth) < 1.96 * stated).mean(axis=0)


@pytest.fixture(scope="module")
def known(bench) -> list[PhotoColumns]:
    return bench.photograph(TEFLON, ANGLES)


@pytest.fixture(scope="module")
def unknown(bench) -> list[PhotoColumns]:
    """Six photographs, two to a lighting whose source's irradiance and ambient are to be found."""
    photos = []
    for k, pair in enumerate(([0.0, 100.0], [30.0, 130.0], [60.0, 160.0])):
        strength = 1 + 0.3 * np.sin(k + np.arange(3))
        source = replace(bench.source, irradiance=strength)
        ambient = replace(bench.area_light, width_rad=1e6, radiance=0.1 * strength[::-1])
        told = bench.known_lighting(
            [], [source], name=f"light {k}", recover_irradiance=True, recover_ambient=True
        )
        photos += bench.photograph(TEFLON, pair, [ambient], [source], told, samples=200)
    return photos


def test_stated_deviations_are_the_scatter_in_known_light(known, bench, rng):
    truth, estimates, stated = simulate(known, everything, lambda: bench.with_noise(known, rng), draws=50)
    assert truth.shape == (8,)
    scatter = estimates.std(axis=0, ddof=1)
    # A scatter over 50 draws is known to 10%, and the largest of three answers is stated, 10% more on average.
    ratio = stated.mean(axis=0) / scatter
    assert ((ratio > 0.8) & (ratio < 1.5)).all(), ratio
    # 95% of 50 draws, 47.5 +- 1.5: two and a half deviations below.
    assert (coverage(truth, estimates, stated) >= 0.87).all()
    assert (np.abs((estimates.mean(axis=0) - truth) / scatter) < 4 / np.sqrt(50)).all()  # no bias, 4 sigma


def test_stated_deviations_are_the_scatter_in_light_of_unknown_strength(unknown, bench, rng):
    truth, estimates, stated = simulate(
        unknown, free_of_the_gauge, lambda: bench.with_noise(unknown, rng), draws=20
    )
    assert truth.shape == (2 + 3 + 18,)
    ratio = stated.mean(axis=0) / estimates.std(axis=0, ddof=1)
    # As above with 16%, for 23 numbers at once: up to three deviations.
    assert ((ratio > 0.7) & (ratio < 1.7)).all(), ratio
    covered = coverage(truth, estimates, stated)
    assert (covered >= 0.8).all(), covered  # 95% of 20 draws is 19 +- 1: three below
    assert covered.mean() >= 0.92


def test_stains_of_the_surface_widen_the_intervals(bench, rng, few_forms):
    lamps = [bench.source, replace(bench.source, direction=bench.direction(110, 40))]
    photos = bench.photograph(TEFLON, ANGLES[::2], [], lamps, samples=80)
    told = bench.known_lighting([], lamps)
    clean = factorize(bench.with_noise(photos, rng), [told]).quantities
    truth = {"mu": TEFLON.mu, "sigma": TEFLON.sigma, "kd": TEFLON.kd, "ks": TEFLON.ks}
    covered: dict[str, list[float]] = {name: [] for name in truth}
    for _ in range(4):
        # Cells about 0.2 rad across, whose albedo strays by 5%: they are seen alike in every photograph.
        seeds = rng.normal(size=(300, 3))
        seeds /= np.linalg.norm(seeds, axis=1, keepdims=True)
        albedo = 0.05 * rng.standard_normal(300)
        stained = []
        for photo in photos:
            cell = (photo.field.sample_normals @ seeds.T).argmax(axis=1)
            matte = Microfacet(TEFLON.kd, np.zeros(3), None, None)
            change = albedo[cell, None] * predict_columns(photo, matte, np.ones((1, 3)))
            stained.append(bench.with_radiance(photo, photo.radiance + change))
        quantities = factorize(bench.with_noise(stained, rng), [told]).quantities
        for name, true in truth.items():
            found = quantities[name]
            assert (found.std > 3 * clean[name].std).all(), name
            covered[name].append(float((np.abs(found.value - true) < 1.96 * found.std).mean()))
    shares = {name: float(np.mean(hits)) for name, hits in covered.items()}
    # 95% of 4 draws is 3.8 +- 0.4, of four such 15.2 +- 0.9: over two deviations below. Channels stray together.
    assert min(shares.values()) >= 0.6, shares
    assert np.mean(list(shares.values())) >= 0.84, shares


def test_a_lobe_as_wide_as_can_be_is_not_told_from_the_base(bench, rng):
    lamps = [replace(bench.source, direction=bench.direction(angle, 20)) for angle in (20, 60, 100, 140)]
    told = bench.known_lighting([], lamps)
    brdf = Microfacet(TEFLON.kd, np.full(3, 0.5), None, SIGMA_RANGE[1], GGX_FORM)
    photos = bench.predicted_photographs(brdf, ANGLES[::2], told, 150)
    with few_forms_tried(GGX_FORM, tables=False):
        quantities = factorize(bench.with_noise(photos, rng), [told]).quantities
    kd, ks = quantities["kd"], quantities["ks"]
    assert quantities["sigma"].value is None
    assert kd.std is not None
    assert ks.std is not None
    # A base of another form may be all of it: Ks is off by all that it is, or by nothing, each as likely.
    assert_allclose(ks.std, np.sqrt(0.5) * 0.5, rtol=0.02)
    # And Kd by what a base in its place would add.
    assert (kd.std > 0.1 * TEFLON.kd).all()
    assert kd.status == "weak"


def test_a_maps_coarse_pixels_are_part_of_sigmas_uncertainty(bench, rng, few_forms):
    # A window of two by two pixels of 5.6 degrees, lamps all over it in truth: between pixels a map is interpolated.
    rows, sigma = 32, 0.05
    pixel = np.pi / rows
    coarse = np.zeros((rows, 2 * rows, 3), np.float32)
    coarse[12:14, 20:22] = 50.0
    within = (np.arange(10) + 0.5) / 5
    theta, phi = (part.ravel() for part in np.meshgrid((12 + within) * pixel, (20 + within) * pixel))
    towards = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
    power = 50 * np.sin(theta) * (pixel / 5) ** 2
    window = [DirectionalSource(way, np.full(3, e)) for way, e in zip(towards, power, strict=True)]
    told = Lighting("light", coarse, np.zeros((0, 3)), np.zeros((0, 3)))
    angles = np.degrees(21 * pixel) + np.linspace(-90, 90, 8)
    material = replace(TEFLON, sigma=sigma)
    photos = bench.photograph(material, angles, [], window, told, samples=120)
    found = factorize(bench.with_noise(photos, rng), [told]).quantities["sigma"]
    assert found.value is not None
    assert abs(found.value[0] - sigma) < 2 * found.std[0]
