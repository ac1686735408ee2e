"""What light of each kind sends through each form, against sums over the directions that it comes from."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from capture.lighting import latlong_directions, latlong_solid_angles
from invrender.brdf.form import Angles, LobeForm
from invrender.brdf.lobes import BECKMANN, FORMS, GGX_FORM, UNCORRELATED
from invrender.brdf.microfacet import Microfacet
from invrender.brdf.richer import RICHER
from invrender.transport.columns import all_columns, columns_of_forms, photo_columns
from invrender.transport.form_transfer import OneIndex, form_transfer
from invrender.transport.predict import predict, predict_columns
from invrender.transport.transfer import LightElement, light_elements

HEIGHT = 200


def rays(bench) -> tuple[np.ndarray, np.ndarray]:
    """Some sixty rays of a sphere, exitant angles up to 80 degrees."""
    field = bench.sphere_field(40.0, samples=300)
    return field.normals[::22], field.views[::22]


def summed(form: LobeForm, mu: float | None, sigma: float, light, normals, views) -> np.ndarray:
    """Pixel by pixel over eighty thousand directions, (m, 3); where light is brighter than 1e-4 of its peak."""
    directions = latlong_directions(HEIGHT).reshape(-1, 3)
    weights = np.repeat(latlong_solid_angles(HEIGHT), 2 * HEIGHT, axis=1).ravel()
    radiance = light.radiance_from(directions)
    bright = radiance[:, 0] > 1e-4 * radiance[:, 0].max()
    directions, arriving = directions[bright], (radiance * weights[:, None])[bright]
    result = []
    for normal, view in zip(normals, views, strict=True):
        angles = Angles.between(normal, directions, view)
        result.append(form.reflected(angles, mu, sigma) @ arriving)
    return np.array(result)


@pytest.mark.parametrize("sigma", [0.08, 0.25])
@pytest.mark.parametrize("form", [*FORMS.values(), UNCORRELATED[GGX_FORM]], ids=[*FORMS, "uncorrelated"])
def test_a_map_is_summed_over_its_directions(form: LobeForm, sigma: float, bench):
    normals, views = rays(bench)
    mu = 1.5 if form.has_fresnel else None
    (element,) = light_elements(bench.known_lighting(sources=[]))
    found = form_transfer(form, element, normals, views, np.array([sigma]), OneIndex(mu))[:, 0, 0]
    expected = summed(form, mu, sigma, bench.area_light, normals, views)
    # The quadrature over rings and the map's own pixels: 0.1% RMS measured, 0.25% of GGX's tail at 0.25.
    assert np.sqrt(np.mean((found - expected) ** 2)) < 3e-3 * np.sqrt(np.mean(expected**2))
    assert np.abs(found - expected).max() < 4e-3 * expected.max()


@pytest.mark.parametrize("form", [*FORMS.values(), *RICHER.values()], ids=[*FORMS, *RICHER])
def test_no_rays_reflect_nothing(form: LobeForm, bench):
    # A picture without grazing rays has none that are integrated one by one.
    (element,) = light_elements(bench.known_lighting())
    none = np.zeros((0, 3))
    assert form_transfer(form, element, none, none, np.array([0.1, 0.2]), OneIndex(1.5)).shape == (0, 1, 2, 3)


@pytest.mark.parametrize("form", FORMS.values(), ids=FORMS)
def test_uniform_light_is_a_map_of_ones(form: LobeForm, bench):
    normals, views = rays(bench)
    ambient = LightElement("ambient", np.zeros((0, 3)), np.zeros((0, 1)), uniform=1.0)
    ones = LightElement("known", np.zeros((0, 3)), np.zeros((0, 1)), np.ones((64, 128, 1), np.float32))
    mu = 1.5 if form.has_fresnel else None
    found, expected = (
        form_transfer(form, element, normals, views, np.array([0.12]), OneIndex(mu))[:, 0, 0]
        for element in (ambient, ones)
    )
    # Rings that the horizon cuts, differently turned.
    assert_allclose(found, expected, rtol=7e-3, equal_nan=False)


@pytest.mark.parametrize("form", FORMS.values(), ids=FORMS)
def test_columns_are_the_form_at_any_index_and_roughness(form: LobeForm, bench, rng):
    lighting = bench.known_lighting(recover_irradiance=True, recover_ambient=True)
    elements = light_elements(lighting)
    field = bench.sphere_field(120.0, samples=100)
    strengths = rng.uniform(0.5, 1.5, (len(elements), 3))
    photo = photo_columns(lighting.name, elements, field, form)
    for mu, sigma in ((None, 0.06), (1.4, 0.12), (2.2, 0.3)):
        index = mu if form.has_fresnel else None
        brdf = Microfacet(np.full(3, 0.1), np.array([0.02, 0.03, 0.05]), index, sigma, form)
        direct = predict(brdf, elements, strengths, field)
        through = predict_columns(photo, brdf, strengths)
        # Interpolation in sigma (1e-4 of the peak), the Fresnel sum (4e-4), G2 between its roughnesses (2e-4).
        assert np.abs(through - direct).max() < 1e-3 * direct.max()


def test_facets_forms_made_together_are_those_made_alone(bench):
    lighting = bench.known_lighting(recover_ambient=True)
    elements = {lighting.name: light_elements(lighting)}
    fields = [bench.sphere_field(angle, samples=40) for angle in (0.0, 100.0)]
    names = [lighting.name] * len(fields)
    forms = (BECKMANN, GGX_FORM)
    found = columns_of_forms(names, elements, fields, forms)
    assert tuple(found) == forms
    for form in forms:
        for own, alone in zip(found[form], all_columns(names, elements, fields, form), strict=True):
            assert own.form is form
            # Single precision; rings that weigh nothing in one form are summed for the other.
            assert_allclose(own.columns, alone.columns, rtol=0, atol=3e-6 * alone.columns.max())


def test_columns_of_another_form_are_refused(bench):
    lighting = bench.known_lighting()
    photo = photo_columns(lighting.name, light_elements(lighting), bench.sphere_field(0.0, samples=20))
    brdf = Microfacet(np.ones(3), np.ones(3), 1.5, 0.1, FORMS["GGX"])
    with pytest.raises(ValueError, match=r"columns of the form 'microfacet' can't predict 'GGX'"):
        predict_columns(photo, brdf, np.ones((1, 3)))
