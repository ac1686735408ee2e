"""Image-based BRDF measurement, judged by the BRDF that the photographs were made with."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from invrender.brdf.microfacet import Microfacet
from invrender.inverse_brdf.fit import fit_table, table_misfit
from invrender.inverse_brdf.halfangles import HalfAngles, cosines, half_angles
from invrender.inverse_brdf.near import measure_under
from invrender.inverse_brdf.samples import Source, lit_fields, lit_samples
from invrender.inverse_brdf.table import SMALL, BRDFTable, bin_centres, bin_of, fitting_bins, measure_table
from recon.sampling.lightfield import LightField
from synthetic.lights.sources import DirectionalSource
from synthetic.materials import tabulated
from synthetic.materials.facets import GGXSlopes
from synthetic.materials.material import Material
from synthetic.materials.microfacet import MicrofacetMaterial
from synthetic.materials.smith import SmithMaterial
from synthetic.render.lobes import reflected_radiance

TEFLON = MicrofacetMaterial(np.array([0.25, 0.2, 0.15]), np.array([0.03, 0.04, 0.05]), 1.78, 0.12)
# Without a Fresnel factor light and viewer can be exchanged.
ROUGH = MicrofacetMaterial(np.full(3, 0.15), np.full(3, 0.2), None, 0.5)
LAMBERTIAN = MicrofacetMaterial(np.full(3, 0.25), np.zeros(3), None, 0.5)
ANGLES = np.linspace(0, 177, 40)


@pytest.fixture(scope="module")
def lamp(bench: SimpleNamespace) -> DirectionalSource:
    return DirectionalSource(bench.direction(-20, 0), np.array([2.0, 1.8, 1.6]))


@pytest.fixture(scope="module")
def black(bench: SimpleNamespace, lamp: DirectionalSource) -> list[LightField]:
    """Forty photographs from an arc through the lamp's plane."""
    return [bench.sphere_field(angle, 300, radius_px=90, sources=lamp.direction[None]) for angle in ANGLES]


def photographs(
    black: list[LightField], material: MicrofacetMaterial, lamp: DirectionalSource
) -> list[LightField]:
    return [
        replace(
            field,
            radiance=np.asarray(
                field.mean_over_rays(reflected_radiance(material, [], [lamp], field.normals, field.views))
            ),
        )
        for field in black
    ]


def noisy(fields: list[LightField], rng: np.random.Generator) -> list[LightField]:
    return [
        replace(
            field,
            radiance=field.radiance * (1 + 0.01 * rng.standard_normal(field.radiance.shape))
            + 1e-4 * rng.standard_normal(field.radiance.shape),
        )
        for field in fields
    ]


def table_of(
    fields: list[LightField], lamp: DirectionalSource, shape: tuple[int, int, int] = SMALL
) -> BRDFTable:
    sources = [Source(lamp.direction, lamp.irradiance)] * len(fields)
    return measure_table(lit_samples(lit_fields(fields, sources, np.zeros(3)), sources, np.zeros(3)), shape)


def value_at_centres(material: MicrofacetMaterial, shape: tuple[int, ...]) -> np.ndarray:
    """The BRDF (n_h, n_d, n_p, 3) at the centres of bins, through the synthetic package's own half angles."""
    wi, wo = tabulated.directions(tabulated.RusinkiewiczAngles(*bin_centres(shape)))
    return material.kd + material.ks * material.lobe(wi, wo)


def test_half_angles_are_those_of_the_synthetic_materials(rng: np.random.Generator) -> None:
    wi, wo = rng.standard_normal((2, 200, 3))
    wi, wo = (w / np.linalg.norm(w, axis=1, keepdims=True) for w in (wi, wo))
    wi[:, 2], wo[:, 2] = np.abs(wi[:, 2]), np.abs(wo[:, 2])
    normals = np.broadcast_to([0.0, 0.0, 1.0], wi.shape)
    found, witness = half_angles(normals, wi, wo), tabulated.half_angles(wi, wo)
    np.testing.assert_allclose(found.theta_h, witness.theta_h, atol=1e-7)
    np.testing.assert_allclose(found.theta_d, witness.theta_d, atol=1e-7)
    # Theirs is folded by exchanging light and viewer, ours by mirroring.
    np.testing.assert_allclose(np.sin(found.phi_d), np.sin(witness.phi_d), atol=1e-6)
    np.testing.assert_allclose(np.abs(np.cos(found.phi_d)), np.abs(np.cos(witness.phi_d)), atol=1e-6)
    # Which of the two is the light's is kept.
    cos_incident, cos_exitant = cosines(found)
    np.testing.assert_allclose(cos_incident, wi[:, 2], atol=1e-9)
    np.testing.assert_allclose(cos_exitant, wo[:, 2], atol=1e-9)


def test_every_centre_lies_in_its_own_bin() -> None:
    shape = (7, 5, 4)
    centres = bin_centres(shape)
    np.testing.assert_array_equal(
        bin_of(type(centres)(*(angle.ravel() for angle in centres)), shape), np.arange(140)
    )


def test_values_are_the_brdf_within_their_errors(
    black: list[LightField], lamp: DirectionalSource, rng: np.random.Generator
) -> None:
    fields = photographs(black, LAMBERTIAN, lamp)
    deviations = []
    for _ in range(3):
        table = table_of(noisy(fields, rng), lamp)
        deviations.append((table.values[table.measured] - 0.25) / table.std[table.measured])
    # Of a constant BRDF the width of bins doesn't matter: what is left is noise.
    assert 0.9 < np.sqrt(np.mean(np.concatenate(deviations) ** 2)) < 1.1
    assert table.counts.sum() > 3000


def test_the_width_of_bins_costs_two_percent_of_a_rough_lobe_at_their_centres(
    black: list[LightField], lamp: DirectionalSource
) -> None:
    table = table_of(photographs(black, ROUGH, lamp), lamp)
    truth = value_at_centres(ROUGH, table.counts.shape)
    # Bins of several samples in which 1 / cos hardly varies.
    steady = (table.counts > 3) & (np.minimum(table.cos_incident, table.cos_exitant) > 0.4)
    relative = table.values[steady] / truth[steady] - 1
    assert np.sqrt(np.mean(relative**2)) < 0.05
    assert np.abs(np.mean(relative)) < 0.01


def test_empty_bins_are_filled_by_exchanging_light_and_viewer(
    black: list[LightField], lamp: DirectionalSource
) -> None:
    table = table_of(photographs(black, ROUGH, lamp), lamp)
    taken = table.filled & ~table.measured
    assert taken.any()
    truth = value_at_centres(ROUGH, table.counts.shape)
    steady = taken & (np.minimum(table.cos_incident, table.cos_exitant) > 0.4)
    # As good as what is measured: a bin's width.
    assert np.median(np.abs(table.values[steady] / truth[steady] - 1)) < 0.05
    assert table.coverage(table.measured) < table.coverage(table.filled) < 1
    # Nothing is invented elsewhere.
    assert not table.values[~table.filled].any()


def test_the_fit_to_the_table_finds_the_parameters_within_its_errors(
    black: list[LightField], lamp: DirectionalSource, rng: np.random.Generator
) -> None:
    fields = photographs(black, TEFLON, lamp)
    truth = np.array([*TEFLON.kd, *TEFLON.ks, TEFLON.mu, TEFLON.sigma])
    deviations = []
    for _ in range(3):
        table = table_of(noisy(fields, rng), lamp)
        fit = fit_table(table)
        deviations.append((fit.parameters - truth) / fit.std)
    assert np.abs(deviations).max() < 3.5  # of 24, the three channels' alike
    # Errors that say something: mu to 3%, sigma to 2%.
    assert fit.std[6] < 0.05
    assert fit.std[7] < 0.0024
    # 1% noise; samples of the brightest bins, which hold few, weigh most.
    assert 0.005 < fit.misfit < 0.03
    # Another material's parameters describe the table worse.
    other = Microfacet(TEFLON.kd, TEFLON.ks, TEFLON.mu, 0.15)
    assert table_misfit(table, other) > 2 * fit.misfit


@pytest.mark.parametrize("shape", [(12, 9, 6), (24, 18, 12), (40, 30, 20)])
def test_no_width_of_bins_is_taken_for_another_lobe(
    black: list[LightField], lamp: DirectionalSource, rng: np.random.Generator, shape: tuple[int, int, int]
) -> None:
    # A lobe three times narrower than teflon's: within a bin of 12 rows it falls to nothing.
    narrow = MicrofacetMaterial(TEFLON.kd, TEFLON.ks, TEFLON.mu, 0.04)
    fields = noisy(photographs(black, narrow, lamp), rng)
    fit = fit_table(table_of(fields, lamp, shape))
    # Noise alone: 1, of some hundred to some thousand bins; the noise itself is known to a tenth.
    assert 0.8 < fit.chi2 < 1.3
    assert fit.brdf.sigma == pytest.approx(0.04, abs=4 * fit.std[7])
    assert fit.std[7] < 0.001


def test_bins_are_as_fine_as_lobe_and_samples_ask_for() -> None:
    def at(theta_d: np.ndarray) -> HalfAngles:
        return HalfAngles(np.full_like(theta_d, 0.01), theta_d, np.zeros_like(theta_d))

    def even(count: int) -> HalfAngles:
        return at(np.linspace(0, 1.4, count))

    assert fitting_bins(even(10_000), 0.5) == (24, 18, 12)
    for sigma in (0.03, 0.12):
        rows, across, around = fitting_bins(even(10**6), sigma)
        assert (across, around) == (36, 24)
        edges = np.pi / 2 * (np.arange(rows + 1) / rows) ** 2
        assert np.diff(edges)[np.searchsorted(edges, sigma) - 1] == pytest.approx(sigma / 4, rel=0.15)
    # Two samples a bin: nearly half of all bins hold none, light or viewer being below the surface.
    assert 15_000 / np.prod(fitting_bins(even(15_000), 0.1)) == pytest.approx(2, rel=0.1)
    # Photographs 3 degrees apart, one of them held out: no bin of theta_d fits between its neighbours.
    shots = np.delete(np.arange(0.1, 1.3, np.radians(1.5)), 20)
    _, across, _ = fitting_bins(at(np.repeat(shots, 5000)), 0.12)
    assert np.pi / 2 / across > 2 * np.radians(1.5)


def lit_from(fields: list[LightField], material: Material, place: np.ndarray) -> list[LightField]:
    """Photographs under a lamp at a place (3,), whose irradiance at the origin is 2, with noise of a percent."""
    rng, distance = np.random.default_rng(4), np.linalg.norm(place)
    lit = []
    for field in fields:
        towards = place - field.positions
        far = np.linalg.norm(towards, axis=1, keepdims=True)
        towards = towards / far
        cos = np.maximum((towards * field.normals).sum(axis=1, keepdims=True), 0)
        rays = material.evaluate(field.normals, towards, field.views) * cos * 2 * (distance / far) ** 2
        seen = np.asarray(field.mean_over_rays(rays))
        lit.append(replace(field, radiance=seen * (1 + 0.01 * rng.standard_normal(seen.shape))))
    return lit


# 45 radii away, as RH01's, and 5, from where it leaves a fifth of what a far one lights in the dark.
@pytest.mark.parametrize("distance", [0.9, 0.1])
def test_a_lamp_that_is_near_is_found_to_be_so(
    black: list[LightField], lamp: DirectionalSource, distance: float
) -> None:
    fields = lit_from(black, TEFLON, distance * lamp.direction)
    sources = [Source(lamp.direction, np.full(3, 2.0))] * len(fields)
    found = measure_under(fields, sources, np.zeros(3))
    assert found.distance is not None
    assert abs(found.distance[0] - distance) < 4 * found.distance[1] < 0.1 * distance
    assert found.fit.chi2 < 1.3
    truth = np.array([*TEFLON.kd, *TEFLON.ks, TEFLON.mu, TEFLON.sigma])
    assert np.abs((found.fit.parameters - truth) / found.fit.std).max() < 4
    # As of a source that is far, Kd is 2 in a thousand too high.
    far = fit_table(table_of(fields, DirectionalSource(lamp.direction, np.full(3, 2.0))))
    assert far.chi2 > 2 * found.fit.chi2


@pytest.mark.parametrize(
    ("material", "explained"),
    [
        (TEFLON, True),
        pytest.param(
            SmithMaterial(TEFLON.kd, 4 * TEFLON.ks, 1.5, GGXSlopes(0.12, 0.12)), False, marks=pytest.mark.slow
        ),
    ],
    ids=["RH01's", "GGX"],
)
def test_no_far_lamp_counts_as_near_whatever_the_lobe(
    black: list[LightField], lamp: DirectionalSource, material: Material, explained: bool
) -> None:
    fields = lit_from(black, material, 1e4 * lamp.direction)
    found = measure_under(fields, [Source(lamp.direction, np.full(3, 2.0))] * len(fields), np.zeros(3))
    assert found.distance is None
    assert (found.fit.chi2 < 1.3) == explained


def test_lookup_finds_the_values_and_says_where_there_are_none(
    black: list[LightField], lamp: DirectionalSource
) -> None:
    table = table_of(photographs(black, LAMBERTIAN, lamp), lamp)
    pairs = tabulated.directions(tabulated.RusinkiewiczAngles(*bin_centres(table.counts.shape)))
    wi, wo = (np.asarray(directions, float).reshape(-1, 3) for directions in pairs)
    values, known = table.lookup(np.broadcast_to([0.0, 0.0, 1.0], wi.shape), wi, wo)
    np.testing.assert_array_equal(known.reshape(table.filled.shape), table.filled)
    np.testing.assert_allclose(values[known], 0.25, rtol=1e-6)  # the photographs are single precision at best


def test_bad_input_is_refused_with_what_to_do(black: list[LightField], lamp: DirectionalSource) -> None:
    fields = photographs(black, LAMBERTIAN, lamp)[:1]
    with pytest.raises(ValueError, match=r"irradiance is \[1.0, 0.0, 1.0\]; every channel must be > 0"):
        table_of(fields, DirectionalSource(lamp.direction, np.array([1.0, 0.0, 1.0])))
    behind = -fields[0].views.mean(axis=0)
    with pytest.raises(ValueError, match=r"no sample is lit by its source"):
        table_of(fields, DirectionalSource(behind / np.linalg.norm(behind), lamp.irradiance))
    measured = table_of(fields, lamp)
    empty = replace(measured, counts=np.zeros_like(measured.counts))
    with pytest.raises(ValueError, match=r"parameters can't be fitted to so few"):
        fit_table(empty)
