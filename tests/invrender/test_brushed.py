"""Brushed lobes: facets against quadrature over slopes, and the fit against photographs that `synthetic` takes."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from capture.files.imagefile import read_pixels
from capture.lighting import Lighting, latlong_directions, latlong_solid_angles
from invrender.brdf.brushed import FACETS, Brushed, brushed, window_about
from invrender.brdf.form import Angles, brushed_tangents
from invrender.brdf.lobes import BECKMANN, GGX_FORM
from invrender.brdf.microfacet import Microfacet
from invrender.estimate.brushed import first_stretch, nearness_gain, stretch_gain
from invrender.estimate.search import fit, models_of
from invrender.estimate.statistics import total_statistics
from invrender.estimate.weighing import weigh
from invrender.inverse_brdf.brushed_harmonics import BrushedBasis
from invrender.inverse_brdf.harmonic import estimate_harmonic
from invrender.theory.brdfcoefficients import anisotropic_coefficients
from invrender.theory.convolution import anisotropic_light_field, anisotropic_radiance
from invrender.transport.columns import all_columns, photo_columns
from invrender.transport.form_transfer import OneIndex, form_transfer
from invrender.transport.predict import predict, predict_columns
from invrender.transport.transfer import LightElement, light_elements
from recon.harmonics.complex import to_complex
from recon.harmonics.latlong import map_coefficients
from recon.sampling.lightfield import LightField
from synthetic.lights.arealight import AreaLight
from synthetic.lights.illumination import latlong_map

from .faultysets import BRUSHED, write_set
from .fewforms import few_forms_tried, no_causes_sought, no_figures_drawn

Floats = np.ndarray
Command = Callable[..., tuple[int, str, str]]

UPRIGHT = (0.0, 0.0, 1.0)
TILTED = (0.6, 0.0, 0.8)


def stretched(of, alpha_x: float, alpha_y: float, axis=UPRIGHT) -> tuple[Brushed, float]:
    """A brushed form, and its sigma."""
    return brushed(of, axis).with_numbers({"stretch": alpha_x / alpha_y}), (alpha_x * alpha_y) ** 0.5


def unit(vectors: Floats) -> Floats:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def slope_density(of, x: Floats, y: Floats, alpha_x: float, alpha_y: float) -> Floats:
    """Density of facets' slopes, 1, of two widths [Heitz 2014, section 5: P22 of Beckmann and of GGX]."""
    square = (x / alpha_x) ** 2 + (y / alpha_y) ** 2
    bell = np.exp(-square) if of is BECKMANN else 1 / (1 + square) ** 2
    return bell / (np.pi * alpha_x * alpha_y)


def shadowed(of, w: Floats, alpha_x: float, alpha_y: float) -> float:
    """Lambda of a local direction by Smith's definition: the area that facets show towards it, by quadrature."""
    # Slopes r = tan t of stretched polar coordinates: all of them are reached.
    node, weight = np.polynomial.legendre.leggauss(200)
    t, psi = (node + 1) * np.pi / 4, np.arange(300) * np.pi / 150
    r, psi = np.meshgrid(np.tan(t), psi, indexing="ij")
    x, y = alpha_x * r * np.cos(psi), alpha_y * r * np.sin(psi)
    area = alpha_x * alpha_y * r * (1 + r**2) * (weight * np.pi / 4)[:, None] * (np.pi / 150)
    shown = np.maximum(w[2] - w[0] * x - w[1] * y, 0)
    return float((slope_density(of, x, y, alpha_x, alpha_y) * shown * area).sum() / w[2]) - 1


@pytest.mark.parametrize("of", [GGX_FORM, BECKMANN], ids=["GGX", "Beckmann"])
def test_facets_lean_and_hide_each_other_as_their_slopes_say(of) -> None:
    alpha_x, alpha_y = 0.35, 0.15
    form, sigma = stretched(of, alpha_x, alpha_y)
    normal = unit(np.array([1.0, 2.0, 1.5]))
    x = unit(np.cross(UPRIGHT, normal))
    frame = np.stack([x, np.cross(normal, x), normal])
    lights = unit(np.array([[0.3, 0.1, 1], [-1.2, 0.4, 1], [0.1, -1.5, 0.8]]))
    views = unit(np.array([[-0.1, 0.2, 1], [1.4, 0.3, 0.9], [0.2, 1.3, 1]]))
    found = form.shape(Angles.between(normal, lights @ frame, views @ frame, UPRIGHT), sigma)
    half = unit(lights + views)
    density = slope_density(of, -half[:, 0] / half[:, 2], -half[:, 1] / half[:, 2], alpha_x, alpha_y)
    hidden = [[shadowed(of, w, alpha_x, alpha_y) for w in ways] for ways in (lights, views)]
    expected = density / half[:, 2] ** 4 / (4 * views[:, 2] * (1 + np.sum(hidden, axis=0)))
    assert_allclose(found, expected, rtol=1e-4)


@pytest.mark.parametrize("of", FACETS, ids=[form.name for form in FACETS])
def test_equal_widths_are_the_isotropic_form_and_all_are_reciprocal(of, rng: np.random.Generator) -> None:
    normals = unit(rng.normal(size=(50, 3)))
    wi, wo = (unit(normals + 0.7 * unit(rng.normal(size=(50, 3)))) for _ in range(2))
    equal = brushed(of, TILTED).reflected(Angles.between(normals, wi, wo, TILTED), 1.5, 0.2)
    assert_allclose(equal, of.reflected(Angles.between(normals, wi, wo), 1.5, 0.2), rtol=1e-12)
    form, sigma = stretched(of, 0.1, 0.4, TILTED)
    there, back = Angles.between(normals, wi, wo, TILTED), Angles.between(normals, wo, wi, TILTED)
    assert_allclose(
        form.reflected(there, 1.5, sigma) / there.cos_i,
        form.reflected(back, 1.5, sigma) / back.cos_i,
        rtol=1e-10,
    )


def test_a_brushed_lobe_reflects_no_more_than_arrives() -> None:
    form, sigma = stretched(GGX_FORM, 0.3, 0.1)
    directions = latlong_directions(200).reshape(-1, 3)
    solid = np.repeat(latlong_solid_angles(200), 400, axis=1).ravel()
    normal = np.array([0.0, 1.0, 0.0])
    for view in unit(np.array([[0.0, 1, 0], [1, 1, 0], [0, 1, 1], [3, 1, 0], [0, 1, 3.0]])):
        albedo = float(form.shape(Angles.between(normal, directions, view, UPRIGHT), sigma) @ solid)
        # Facets that hide each other lose what bounces between them: some percent head-on, more at grazing.
        assert 0.8 < albedo < 1
    assert_allclose(brushed_tangents(normal, UPRIGHT), [-1, 0, 0], atol=1e-15)


def test_a_map_and_uniform_light_are_summed_over_their_directions(bench) -> None:
    form, sigma = stretched(GGX_FORM, 0.1, 0.3)
    field = bench.sphere_field(40.0, samples=300)
    normals, views = field.normals[::60], field.views[::60]
    lighting: Lighting = bench.known_lighting(sources=[])
    directions = latlong_directions(120).reshape(-1, 3)
    solid = np.repeat(latlong_solid_angles(120), 240, axis=1).ravel()[:, None]
    ambient = LightElement("ambient", np.zeros((0, 3)), np.zeros((0, 1)), uniform=1.0)
    for element, radiance in (
        (light_elements(lighting)[0], bench.area_light.radiance_from(directions)),
        (ambient, np.ones((len(directions), 1))),
    ):
        found = form_transfer(form, element, normals, views, np.array([sigma]), OneIndex(1.5))[:, 0, 0]
        expected = np.array(
            [
                form.reflected(Angles.between(normal, directions, view, UPRIGHT), 1.5, sigma)
                @ (radiance * solid)
                for normal, view in zip(normals, views, strict=True)
            ]
        )
        assert np.sqrt(np.mean((found - expected) ** 2)) < 4e-3 * np.sqrt(np.mean(expected**2))


def test_columns_are_the_form_anywhere_in_their_window(bench) -> None:
    lighting = bench.known_lighting(recover_irradiance=True)
    elements = light_elements(lighting)
    field = bench.sphere_field(120.0, samples=40)
    strengths = np.full((len(elements), 3), 1.3)
    family = brushed(GGX_FORM, TILTED, window_about(0.15, 0.4, (0.35, 0.6)))
    photo = photo_columns(lighting.name, elements, field, family)
    for mu, sigma, stretch in ((None, 0.15, 0.4), (1.5, 0.11, 0.25), (2.0, 0.2, 0.7)):
        form = family.with_numbers({"stretch": stretch})
        brdf = Microfacet(np.full(3, 0.1), np.array([0.02, 0.03, 0.05]), mu, sigma, form)
        direct = predict(brdf, elements, strengths, field)
        assert np.abs(predict_columns(photo, brdf, strengths) - direct).max() < 1e-3 * direct.max()


def lamp_photographs(bench, form, sigma: float, closeness: float = 0.0) -> list:
    """closeness : of the lamp to the sphere's centre, 1/m."""
    lamp = bench.known_lighting(lights=())
    lamp = replace(lamp, closeness=np.array([closeness]), centre=np.zeros(3)) if closeness else lamp
    brdf = Microfacet(np.full(3, 0.1), np.full(3, 0.05), 1.5, sigma, form)
    photos = bench.predicted_photographs(brdf, np.linspace(0, 150, 6), lamp, 200)
    return bench.with_noise(photos, np.random.default_rng(3))


def isotropic_fit(bench, photos):
    """What `first_stretch` starts from: columns, weights, elements and the fit, with the lamp far away."""
    told = bench.known_lighting(lights=())
    elements = {told.name: light_elements(told)}
    names, fields = [photo.lighting for photo in photos], [photo.field for photo in photos]
    columns = all_columns(names, elements, fields, GGX_FORM)
    model = models_of(GGX_FORM)[-1]
    weights = weigh(columns, model)[1]
    return columns, weights, elements, fit(model, total_statistics(columns, [own.weight for own in weights]))


@pytest.mark.parametrize(("alpha_x", "alpha_y"), [(0.12, 0.12), (0.12, 0.2), (0.2, 0.12)])
def test_residuals_of_an_isotropic_fit_say_which_way_a_surface_is_brushed(bench, alpha_x, alpha_y) -> None:
    seen = isotropic_fit(bench, lamp_photographs(bench, *stretched(GGX_FORM, alpha_x, alpha_y)))
    gain, asked = stretch_gain(*seen, UPRIGHT), first_stretch(*seen, UPRIGHT)
    if alpha_x == alpha_y:
        assert asked is None
        assert gain.share < 0.01
        assert abs(gain.step) < 0.02
    else:
        assert asked is not None
        assert gain.share > 0.3
        assert gain.step == pytest.approx(np.log(alpha_x / alpha_y), rel=0.3)
        assert nearness_gain(*seen).share < 0.8 * gain.share


def test_a_near_lamp_is_not_taken_for_a_brushed_surface(bench) -> None:
    # At ten radii.
    closeness = 5.0
    seen = isotropic_fit(bench, lamp_photographs(bench, GGX_FORM, 0.15, closeness))
    stretch, near = stretch_gain(*seen, UPRIGHT), nearness_gain(*seen)
    # A stretch explains so much that it would be tried on its own.
    assert stretch.share > 0.1
    assert near.share > 2 * stretch.share
    # To the first order, of a lamp that moves highlights by their width.
    assert near.step == pytest.approx(closeness, rel=0.5)
    assert first_stretch(*seen, UPRIGHT) is None


@pytest.fixture(scope="module")
def brushed_set(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_set(tmp_path_factory.mktemp("brushed") / "set", BRUSHED)


def test_a_brushed_ball_is_processed_compared_rendered(
    lightfactor: Command, brushed_set: Path, tmp_path: Path
) -> None:
    out = tmp_path / "result"
    with few_forms_tried(GGX_FORM), no_causes_sought(), no_figures_drawn():
        code, text, err = lightfactor("process", brushed_set, "-o", out, "--samples", 1000)
    assert (code, err) == (0, "")
    assert "neutral brushed GGX" in text
    assert "alpha_x (rad)" in text
    found = json.loads((out / "result.json").read_text())
    assert found["brdf"]["model"] == "brushed GGX"
    assert found["brdf"]["brushed_about"] == [0, 0, 1]
    # By half a percent of noise; isotropic lobes leave a third of the radiance.
    for name, truth in (("alpha_x", 0.1), ("alpha_y", 0.3), ("stretch", 1 / 3)):
        number = found["brdf"]["form_numbers"][name]
        assert abs(number["value"] - truth) < min(4 * number["std"], 0.01 * truth), name
    assert f"{found['fit']['rms_relative']:.3f}" == "0.010"
    code, text, err = lightfactor("compare", out, brushed_set / "truth.json")
    assert (code, err) == (0, "")
    assert "alpha_x (rad)" in text
    assert "of the form" not in text
    render = ("render", out, "-o", tmp_path / "picture.exr", "--photo", "000.exr", "--set", brushed_set)
    assert lightfactor(*render)[0] == 0
    picture, photograph = read_pixels(tmp_path / "picture.exr"), read_pixels(brushed_set / "000.exr")
    bright = photograph.max(axis=2) > 0.3 * photograph.max()
    assert_allclose(picture[..., :3][bright], photograph[bright], rtol=0.06)


def test_what_knows_isotropic_lobes_alone_refuses_a_brushed_one(
    lightfactor: Command, brushed_set: Path, tmp_path: Path
) -> None:
    code, _, err = lightfactor(
        "light", brushed_set, "--brdf", brushed_set / "truth.json", "-o", tmp_path / "l"
    )
    assert code == 1
    assert "light is recovered by isotropic lobes only" in err


def smooth(incident: Floats, exitant: Floats) -> Floats:
    """Reciprocal and anisotropic, with little beyond degree 2."""
    across = (incident[..., 0] + exitant[..., 0]) ** 2 + 0.2 * (incident[..., 1] + exitant[..., 1]) ** 2
    return 0.05 + np.exp(-0.5 * across)


def local_frames(normals: Floats, axis) -> Floats:
    """Rotations (n, 3, 3) to the world, x along the tangents."""
    x = unit(np.cross(axis, normals))
    return np.stack([x, np.cross(normals, x), normals], axis=-1)


def test_rows_of_a_brushed_sphere_are_the_convolution_formula(rng: np.random.Generator) -> None:
    basis = BrushedBasis(3, TILTED)
    values, lighting = rng.normal(size=len(basis.bounds)), rng.normal(size=(16, 1))
    normals = unit(rng.normal(size=(30, 3)))
    views = unit(normals + 0.8 * unit(rng.normal(size=(30, 3))))
    frames = local_frames(normals, TILTED)
    field = anisotropic_light_field(to_complex(lighting[:, 0]), basis.complex_coefficients(values))
    expected = anisotropic_radiance(field, frames, np.einsum("nji,nj->ni", frames, views))
    assert_allclose(basis.rows(lighting, normals, views)[..., 0] @ values, expected, atol=1e-10)


def test_darkness_below_a_brushed_spheres_horizon_is_the_mean_of_its_rows(rng: np.random.Generator) -> None:
    basis, lighting = BrushedBasis(1, TILTED), rng.normal(size=(4, 1))
    normals = unit(rng.normal(size=(10_000, 3)))
    views = unit(rng.normal(size=normals.shape))
    views *= -np.sign((views * normals).sum(axis=1))[:, None]
    rows = basis.rows(lighting, normals, views)[..., 0]
    products = rows[:, :, None] * rows[:, None]
    error = products.std(axis=0) / 100
    assert (
        np.abs(products.mean(axis=0) - basis.below_horizon([lighting], [1.0])[0]) < 5 * error + 1e-3
    ).all()


@pytest.fixture(scope="module")
def smooth_fields(bench) -> tuple[list[LightField], Floats]:
    """Photographs of a brushed sphere under two lights, by sums over their directions, and the lights' coefficients."""
    lights = [
        AreaLight(bench.direction(110, 40), np.array([1.5, 1.6, 1.8]), 0.5),
        AreaLight(bench.direction(-60, -10), np.array([1.0, 0.8, 0.6]), 0.45),
    ]
    directions = latlong_directions(32).reshape(-1, 3)
    solid = np.repeat(latlong_solid_angles(32), 64, axis=1).ravel()
    arriving = sum(light.radiance_from(directions) for light in lights) * solid[:, None]
    bright = arriving[:, 0] > 1e-4 * arriving[:, 0].max()
    fields = []
    for angle in np.linspace(0, 315, 8):
        field = bench.sphere_field(angle, 60)
        to_local = np.swapaxes(local_frames(field.normals, UPRIGHT), 1, 2)
        incident = np.einsum("nij,kj->nki", to_local, directions[bright])
        exitant = np.einsum("nij,nj->ni", to_local, field.views)
        reflected = smooth(incident, exitant[:, None]) * np.maximum(incident[..., 2], 0)
        fields.append(replace(field, radiance=field.mean_over_rays(reflected @ arriving[bright])))
    return fields, map_coefficients(latlong_map(lights, 64), 8)


def test_a_brushed_spheres_coefficients_are_those_of_its_brdf(smooth_fields) -> None:
    fields, light = smooth_fields
    truth = anisotropic_coefficients(smooth, 2, 2, reciprocal=True, tolerance=1e-5)
    found = estimate_harmonic(fields, [light] * len(fields), 2, UPRIGHT)
    assert isinstance(found.basis, BrushedBasis)
    for channel in found.coefficients.T:
        # A horizon has all degrees: what is left out moves coefficients by as much as error bars say.
        off = np.abs(found.basis.complex_coefficients(channel) - truth)
        assert off.max() < 0.06 * np.abs(truth).max()
    assert np.sqrt(np.mean(off**2)) < 2 * np.sqrt(np.mean(found.std**2))
    isotropic = estimate_harmonic(fields, [light] * len(fields), 2)
    assert found.residual < 0.7 * isotropic.residual


def test_the_command_measures_a_brushed_sphere(
    lightfactor: Command, brushed_set: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    options = ("--anisotropic", "--order", 1, "--samples", 1000)
    code, text, err = lightfactor("brdf", brushed_set, "-o", out, *options)
    assert (code, err) == (0, "")
    assert "coefficients up to degree 1 determined" in text
    found = json.loads((out / "brdf.json").read_text())
    assert found["brushed_about"] == [0, 0, 1]
    names = [tuple(entry[key] for key in "lnpq") for entry in found["coefficients"]]
    assert len(set(names)) == 10
    assert names[1] == (0, 0, 1, -1)
    code, _, err = lightfactor("brdf", brushed_set, "-o", out, "--anisotropic", "--order", 5)
    assert code == 1
    assert "degree 4 at most" in err
