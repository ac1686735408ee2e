"""Harmonic BRDF coefficients from photographs, judged by integrals over the BRDF itself and by brute-force light."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from invrender.brdf.microfacet import Microfacet
from invrender.inverse_brdf.harmonic import HarmonicBRDF, estimate_harmonic
from invrender.inverse_brdf.reciprocal import (
    below_horizon,
    energy_bounds,
    full_coefficients,
    local_light,
    mean_power,
    rows,
    unknowns,
)
from invrender.inverse_brdf.slices import (
    harmonic_transfer,
    parametric_transfer,
    plane_of_incidence,
    ringing,
    slice_directions,
    slice_grid,
)
from invrender.theory.brdfcoefficients import isotropic_coefficients
from invrender.theory.convolution import isotropic_light_field, isotropic_radiance
from invrender.theory.operator import view_frames
from recon.harmonics.complex import project_sources, to_complex
from recon.harmonics.latlong import map_coefficients
from recon.sampling.lightfield import LightField
from synthetic.lights.arealight import AreaLight
from synthetic.lights.illumination import latlong_map
from synthetic.materials.microfacet import MicrofacetMaterial
from synthetic.render.lobes import reflected_radiance

ANGLES = np.linspace(0, 330, 12)
LAMBERTIAN = MicrofacetMaterial(np.full(3, 0.25), np.zeros(3), None, 0.5)
ROUGH = MicrofacetMaterial(np.full(3, 0.15), np.full(3, 0.2), None, 0.5)
TEFLON = MicrofacetMaterial(np.full(3, 0.24), np.full(3, 0.03), 1.78, 0.12)


def random_directions(count: int, rng: np.random.Generator) -> np.ndarray:
    directions = rng.standard_normal((count, 3))
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def random_views(normals: np.ndarray, rng: np.random.Generator, side: int = 1) -> np.ndarray:
    """Views above (side 1) or below (-1) the surface, evenly in solid angle."""
    views = random_directions(len(normals), rng)
    return views * np.sign((views * normals).sum(axis=1) * side)[:, None]


def photographs(
    bench: SimpleNamespace, material: MicrofacetMaterial, lights: list, sources: list, samples: int = 200
) -> list[LightField]:
    fields = []
    for angle in ANGLES:
        field = bench.sphere_field(angle, samples)
        radiance = reflected_radiance(material, lights, sources, field.normals, field.views)
        fields.append(replace(field, radiance=field.mean_over_rays(radiance)))
    return fields


def noisy(fields: list[LightField], rng: np.random.Generator, relative: float = 0.01) -> list[LightField]:
    return [
        replace(field, radiance=field.radiance * (1 + relative * rng.standard_normal(field.radiance.shape)))
        for field in fields
    ]


def true_coefficients(material: MicrofacetMaterial, order: int) -> np.ndarray:
    """Those of `unknowns`, by quadrature over the BRDF."""

    def brdf(incident: np.ndarray, exitant: np.ndarray) -> np.ndarray:
        incident, exitant = np.broadcast_arrays(incident, exitant)
        return material.kd[1] + material.ks[1] * material.lobe(incident, exitant)[..., 0]

    l, p, q = unknowns(order)
    return isotropic_coefficients(brdf, order, order, reciprocal=True, tolerance=1e-6)[l, p, q]


@pytest.fixture(scope="module")
def soft(bench: SimpleNamespace) -> SimpleNamespace:
    """Two area lights, of which 99.98% lies in degrees up to 5, and their coefficients."""
    lights = [
        AreaLight(bench.direction(110, 40), np.array([1.5, 1.6, 1.8]), 0.5),
        AreaLight(bench.direction(-60, -10), np.array([1.0, 0.8, 0.6]), 0.45),
    ]
    return SimpleNamespace(lights=lights, coefficients=map_coefficients(latlong_map(lights, 64), 20))


@pytest.fixture(scope="module")
def full(bench: SimpleNamespace, soft: SimpleNamespace) -> SimpleNamespace:
    """The area lights and a directional source: light of all degrees."""
    added = project_sources(bench.source.direction[None], bench.source.irradiance[None], 20)
    return SimpleNamespace(lights=soft.lights, sources=[bench.source], coefficients=soft.coefficients + added)


@pytest.fixture(scope="module")
def teflon(bench: SimpleNamespace, full: SimpleNamespace) -> dict[int, HarmonicBRDF]:
    """A teflon sphere under light of all degrees, solved to orders 4 and 8."""
    fields = photographs(bench, TEFLON, full.lights, full.sources)
    return {order: estimate_harmonic(fields, [full.coefficients] * len(fields), order) for order in (4, 8)}


def test_rows_are_the_convolution_formula_in_real_harmonics(rng: np.random.Generator) -> None:
    order = 5
    rho = rng.standard_normal(len(unknowns(order).l))
    lighting = rng.standard_normal(((order + 1) ** 2, 1))
    normals = random_directions(40, rng)
    views = random_views(normals, rng)
    found = rows(local_light(lighting, normals, views), (normals * views).sum(axis=1))[..., 0] @ rho
    frames = view_frames(normals, views)
    exitant = np.einsum("nji,nj->ni", frames, views)
    field = isotropic_light_field(to_complex(lighting[:, 0]), full_coefficients(rho, order))
    # Rounding of complex Wigner matrices against real rotations.
    np.testing.assert_allclose(found, isotropic_radiance(field, frames, exitant), atol=1e-11)


def test_darkness_below_the_horizon_is_the_mean_of_rows_over_frames_and_views(
    rng: np.random.Generator,
) -> None:
    order, count = 2, 60_000
    lighting = rng.standard_normal(((order + 1) ** 2, 2))
    normals = random_directions(count, rng)
    views = random_views(normals, rng, side=-1)
    found = rows(local_light(lighting, normals, views), (normals * views).sum(axis=1))
    products = np.einsum("nkc,njc->nckj", found, found)
    standard_error = products.std(axis=0) / np.sqrt(count)
    deviation = (products.mean(axis=0) - below_horizon(mean_power(lighting))) / (standard_error + 1e-12)
    # Of 200 numbers of a seeded sample.
    assert np.abs(deviation).max() < 5


def test_no_white_surface_exceeds_the_bound_of_energy_and_a_diffuse_one_reaches_it() -> None:
    white = replace(LAMBERTIAN, kd=np.full(3, 1 / np.pi))
    found, bounds = true_coefficients(white, 6), energy_bounds(6)
    # Its transfer function is a product, each factor of which the Cauchy-Schwarz inequality bounds.
    assert found[0] == pytest.approx(bounds[0], rel=1e-6)
    assert (np.abs(found) <= bounds * (1 + 1e-6)).all()
    # That of rho_111 by hand: 3 / (4 pi) times the integral of cos theta sin^2 theta cos^2 phi over the hemisphere.
    l, p, q = unknowns(6)
    assert bounds[(l == 1) & (p == 1) & (q == 1)] == pytest.approx(3 / 16)


@pytest.mark.parametrize("material", [LAMBERTIAN, ROUGH], ids=["Lambertian", "rough lobe"])
def test_coefficients_are_those_of_the_brdf_within_their_errors(
    bench: SimpleNamespace, soft: SimpleNamespace, rng: np.random.Generator, material: MicrofacetMaterial
) -> None:
    order = 4
    fields = photographs(bench, material, soft.lights, [])
    truth = true_coefficients(material, order)
    deviations = []
    for _ in range(4):
        draw = noisy(fields, rng)
        found = estimate_harmonic(draw, [soft.coefficients] * len(draw), order)
        assert found.determined.all()
        deviations.append((found.coefficients - truth[:, None]) / found.std)
    # Most of the error is truncation: a horizon has all degrees. It is the same in all draws, at 0.002 of a largest
    # coefficient of 0.2, and told from two degrees more, so z isn't quite 1.
    assert np.abs(found.coefficients - truth[:, None]).max() < 0.008
    assert 0.3 < np.sqrt(np.mean(np.square(deviations))) < 1.2
    assert np.abs(deviations).max() < 4


def test_errors_hold_the_noise_alone_too(
    bench: SimpleNamespace, soft: SimpleNamespace, rng: np.random.Generator
) -> None:
    fields = photographs(bench, LAMBERTIAN, soft.lights, [])
    # So noisy that truncation doesn't show.
    draws = [noisy(fields, rng, relative=0.5) for _ in range(12)]
    found = [estimate_harmonic(draw, [soft.coefficients] * len(draw), 2) for draw in draws]
    scatter = np.std([entry.coefficients for entry in found], axis=0, ddof=1)
    claimed = np.sqrt(np.mean([entry.std**2 for entry in found], axis=0))
    # Standard errors of 30 correlated spreads of 12 draws; what two degrees more move counts as error besides.
    assert 0.5 < np.sqrt(np.mean((scatter / claimed) ** 2)) < 1.2


def test_under_uniform_light_only_what_it_shows_is_determined(
    bench: SimpleNamespace, rng: np.random.Generator
) -> None:
    uniform = np.zeros((64, 3))
    uniform[0] = np.sqrt(4 * np.pi)
    fields = [bench.sphere_field(angle, 200) for angle in ANGLES]
    fields = noisy([replace(field, radiance=np.full((len(field), 3), 0.25 * np.pi)) for field in fields], rng)
    found = estimate_harmonic(fields, [uniform] * len(fields), 3)
    l, p, q = unknowns(3)
    # Light of degree 0 shows rho_0p0, and by reciprocity nothing more.
    np.testing.assert_array_equal(found.determined.all(axis=1), l == 0)
    assert all(reason == "" for reason, seen in zip(found.reasons, l == 0, strict=True) if seen)
    dark = found.reasons[np.flatnonzero((l == 1) & (p == 2) & (q == 1))[0]]
    assert dark == "the light has nothing of degrees 1 and 2 that stands out of the noise"
    # A photograph without a usable pixel has nothing to be predicted.
    assert found.radiance(uniform, np.zeros((0, 3)), np.zeros((0, 3))).shape == (0, 3)
    np.testing.assert_allclose(
        found.rank, 4, atol=0.05
    )  # noise of 1% determines four, and nearly nothing else


def test_ringing_is_deeper_and_the_highlight_sharper_at_higher_order(
    teflon: dict[int, HarmonicBRDF],
) -> None:
    model = Microfacet(TEFLON.kd, TEFLON.ks, TEFLON.mu, TEFLON.sigma)
    degrees, along = plane_of_incidence()
    truth = parametric_transfer(model, along)[:, 1]
    assert degrees[truth.argmax()] == pytest.approx(
        63, abs=3
    )  # opposite the viewer; 1 / cos theta_i draws it on
    profiles = {order: harmonic_transfer(brdf, along)[:, 1] for order, brdf in teflon.items()}
    # Sharper: the highlight, at 63 degrees, comes nearer to its true height (0.7 per sr).
    assert profiles[4].max() < profiles[8].max() < truth.max()
    # What no BRDF does: below zero, at both orders.
    assert all(ringing(brdf).negative_share > 0.002 for brdf in teflon.values())
    # Ripples off the highlight, where the true slice is diffuse.
    grid = slice_grid(30, 60)
    smooth = parametric_transfer(model, grid)[:, 1] < 1.01 * grid.incident[:, 2] * TEFLON.kd[1]
    waves = {
        order: np.abs(
            np.diff(np.sign((harmonic_transfer(brdf, grid) - parametric_transfer(model, grid))[smooth, 1]))
        ).sum()
        for order, brdf in teflon.items()
    }
    assert waves[8] > 1.3 * waves[4]


def test_soft_light_shows_no_ringing_and_a_source_does(
    bench: SimpleNamespace, soft: SimpleNamespace, teflon: dict[int, HarmonicBRDF]
) -> None:
    field = bench.sphere_field(40.0, 300)
    # Not at grazing angles, where missing degrees show in any light.
    inside = (field.normals * field.views).sum(axis=1) > 0.3
    normals, views = field.normals[inside], field.views[inside]
    towards = views.mean(axis=0) / np.linalg.norm(views.mean(axis=0))
    flash = replace(bench.source, direction=towards, irradiance=np.ones(3))
    at_viewpoint = project_sources(flash.direction[None], np.ones((1, 3)), 8)

    def error(lights: list, sources: list, light: np.ndarray) -> float:
        photo = reflected_radiance(TEFLON, lights, sources, normals, views)
        drawn = teflon[8].radiance(light, normals, views)
        return float(np.sqrt(np.mean((drawn - photo) ** 2) / np.mean(photo**2)))

    # Fig. 6 of RH01, below, in numbers.
    assert error(soft.lights, [], soft.coefficients) < 0.015
    assert error([], [flash], at_viewpoint) > 0.08


def test_slices_are_of_the_angles_they_say() -> None:
    pairs = slice_directions(np.radians([63.0, 20.0]), np.radians([180.0, 90.0]))
    # The mirror direction; and one at right angles to the view's azimuth.
    np.testing.assert_allclose(pairs.incident[0], pairs.exitant[0] * [-1, -1, 1], atol=1e-12)
    assert pairs.incident[1] @ [1, 0, 0] == pytest.approx(0, abs=1e-12)
    assert np.degrees(np.arccos(pairs.exitant[1, 2])) == pytest.approx(63)


def test_bad_input_is_refused_with_what_to_do(bench: SimpleNamespace, soft: SimpleNamespace) -> None:
    fields = photographs(bench, LAMBERTIAN, soft.lights, [], samples=30)[:1]
    with pytest.raises(ValueError, match=r"order is -1; it must be an integer >= 0"):
        estimate_harmonic(fields, [soft.coefficients], -1)
    with pytest.raises(ValueError, match=r"there are \d+ samples for the 84 coefficients of order 6, or 165"):
        estimate_harmonic(fields, [soft.coefficients], 6)
    with pytest.raises(ValueError, match=r"lighting: 3 of .* values are not finite"):
        estimate_harmonic(fields, [np.vstack([soft.coefficients[:3], [[np.nan] * 3]])], 1)
    weightless = replace(fields[0], weight=np.zeros(len(fields[0])))
    with pytest.raises(ValueError, match=r"no sample has any weight"):
        estimate_harmonic([weightless], [soft.coefficients], 0)
