"""What is prepared of a lobe and a map against the integral over directions, and pictures with and without it."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from capture.lighting import Lighting
from invrender.brdf.form import Angles
from invrender.brdf.lobes import FORMS
from invrender.brdf.microfacet import Microfacet
from invrender.estimate.textured.seen import transfers_of
from invrender.output.render.light import light_element
from invrender.transport.cached_shader import CachedShader, maps_serve
from invrender.transport.predict import predict
from invrender.transport.reflected import prepared_map, reflected_map
from invrender.transport.transfer import light_elements
from synthetic.lights.arealight import AreaLight
from synthetic.lights.illumination import latlong_map

from .quadrature import sphere_grid

LAMPS = (
    AreaLight(np.array([-0.26, 0.72, 0.64]), np.array([1.5, 1.6, 1.8]), width_rad=0.5),
    AreaLight(np.array([0.7, -0.1, 0.7]), np.array([0.9, 0.5, 0.3]), width_rad=0.8),
)


def surfaces(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Normals all over the sphere, and views at cos theta_o of 0.15 and more."""
    normals, across = rng.normal(size=(2, count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    across -= (across * normals).sum(axis=1, keepdims=True) * normals
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    cos = np.linspace(0.15, 1, count)[:, None]
    return normals, cos * normals + np.sqrt(1 - cos**2) * across


@pytest.mark.parametrize("name", FORMS)
def test_lobes_of_all_forms_are_their_integrals_over_the_light(name: str, rng: np.random.Generator) -> None:
    form, sigma = FORMS[name], 0.25
    mu = 1.5 if form.has_fresnel else None
    light = light_element(Lighting("room", latlong_map(LAMPS, 128), np.zeros((0, 3)), np.zeros((0, 3))))
    normals, views = surfaces(rng, 60)
    # Mirrored at a pole and close to both, views well off the normal.
    for k, pole in enumerate((0.0, 0.008, np.pi - 0.008)):
        normals[k], views[k] = ([np.sin(turn + pole), 0, np.cos(turn + pole)] for turn in (0.8, 1.6))
    directions, weights = sphere_grid(200)
    radiance = sum(lamp.radiance_from(directions) for lamp in LAMPS)
    truth = np.array(
        [
            (weights * form.reflected(Angles.between(normal, directions, view), mu, sigma)) @ radiance
            for normal, view in zip(normals, views, strict=True)
        ]
    )
    error = reflected_map(form, mu, sigma, light).towards(normals, views) - truth
    # Terms hold all but 0.05% (RMS); degrees up to 64, and the map's own pixels, the rest.
    assert np.sqrt(np.mean(error**2)) < 0.005 * np.sqrt(np.mean(truth**2))
    assert np.abs(error).max() < 0.02 * truth.max()
    # At the poles, where cubics reach across, no more than half of what a wrong frame there would do (0.0012 and more).
    assert np.abs(error[:3]).max() < 6e-4 * truth.max()


def test_narrow_lobes_and_light_without_a_map_are_refused() -> None:
    form = FORMS["microfacet"]
    room = light_element(Lighting("room", latlong_map(LAMPS, 16), np.zeros((0, 3)), np.zeros((0, 3))))
    with pytest.raises(ValueError, match=r"sigma is 0\.05; reflected maps carry lobes of 0\.1"):
        reflected_map(form, None, 0.05, room)
    lamp = light_element(Lighting("lamp", None, np.array([[0.0, 0, 1]]), np.ones((1, 3))))
    with pytest.raises(ValueError, match="has no map"):
        reflected_map(form, None, 0.2, lamp)


def test_pictures_look_lobes_up_only_as_far_as_that_is_as_good(bench: SimpleNamespace) -> None:
    lighting = Lighting(
        "room", latlong_map(LAMPS, 128), np.array([[0.0, 0.6, 0.8]]), np.array([[1.0, 0.8, 0.6]])
    )
    brdf = Microfacet(np.full(3, 0.1), np.array([0.2, 0.1, 0.1]), 1.6, 0.2)
    elements, strengths = light_elements(lighting), np.array([[2.0, 1.0, 0.5]])
    field = bench.sphere_field(40.0, samples=300)
    exact = predict(brdf, elements, strengths, field)

    def pictured(tolerance: float, photos: int = 100_000) -> np.ndarray:
        counts = {"room": photos}
        many = CachedShader(
            brdf, {"room": elements}, {"room": field}, {"room": None}, counts, None, tolerance
        )
        return many.radiance("room", strengths, field)

    near = pictured(0.01)
    # As far off as the tests above allow what is prepared, of which the lobe's is a part.
    assert 0 < np.sqrt(np.sum((near - exact) ** 2) / np.sum(exact**2)) < 0.005
    # A tolerance that it misses; and too few pixels for it to pay.
    np.testing.assert_array_equal(pictured(1e-9), exact)
    np.testing.assert_array_equal(pictured(0.01, photos=1), exact)


def test_textures_are_told_by_maps_what_integrals_tell_them(bench: SimpleNamespace) -> None:
    room = Lighting("room", latlong_map(LAMPS, 128), np.zeros((0, 3)), np.zeros((0, 3)))
    brdf, elements = Microfacet(np.full(3, 0.1), np.full(3, 0.04), 1.5, 0.15), light_elements(room)
    field = bench.sphere_field(40.0, samples=2000)
    diffuse, specular = transfers_of(elements, field, brdf, None)
    same, found = transfers_of(elements, field, brdf, None, prepared_map(brdf, elements[0]))
    np.testing.assert_array_equal(same, diffuse)
    rms = np.sqrt(np.mean(specular**2))
    # The integral for each ray is off by 0.05 to 0.3% itself; texels take means, which are nearer still.
    assert 0 < np.sqrt(np.mean((found - specular) ** 2)) < 0.003 * rms
    assert abs(np.mean(found - specular)) < 0.001 * np.mean(specular)
    assert maps_serve(brdf, elements, np.ones((1, 3)), field, None, 0.003)
    assert not maps_serve(brdf, elements, np.ones((1, 3)), field, None, 1e-6)
    # Lobes that are too narrow have no map.
    narrow = Microfacet(brdf.kd, brdf.ks, 1.5, 0.05)
    assert not maps_serve(narrow, elements, np.ones((1, 3)), field, None, 0.1)
