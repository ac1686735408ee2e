"""Explicit forms of reflection maps: what they are at their nodes, and what they lose between."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from capture.lighting import latlong_directions
from invrender.output.prefilter.brdfs import chosen_brdf
from invrender.prefilter.explicit_maps import (
    icosahedral_maps,
    icosahedron,
    view_angle_texture,
)
from invrender.prefilter.globalmap import global_map
from invrender.prefilter.prefiltered import prefilter
from invrender.prefilter.reflectionmap import ReflectionMap


@pytest.fixture
def local(rng: np.random.Generator) -> ReflectionMap:
    return ReflectionMap(rng.normal(size=(16, 3, 10, 20)).astype(np.float32))


def some_directions(rng: np.random.Generator, count: int) -> np.ndarray:
    found = rng.normal(size=(count, 3))
    return found / np.linalg.norm(found, axis=1, keepdims=True)


def test_an_icosahedron_has_twelve_vertices_of_five_neighbours_each():
    cosines = icosahedron() @ icosahedron().T
    assert_allclose(np.sort(cosines, axis=1), [[-1, *[-1 / np.sqrt(5)] * 5, *[1 / np.sqrt(5)] * 5, 1]] * 12)


def test_cabrals_maps_are_exact_at_their_viewers(local: ReflectionMap, rng: np.random.Generator):
    world = global_map(local)
    maps, centres = icosahedral_maps(world), some_directions(rng, 12)
    assert_allclose(maps.radiance(centres, icosahedron()), world.radiance(centres, icosahedron()), atol=1e-5)
    # Half way between two, each counts one half.
    a, b = icosahedron()[0], icosahedron()[np.argsort(icosahedron() @ icosahedron()[0])[-2]]
    middle = np.repeat([(a + b) / np.linalg.norm(a + b)], 12, axis=0)
    both = [maps.radiance(centres, np.repeat([one], 12, axis=0)) for one in (a, b)]
    assert_allclose(maps.radiance(centres, middle), (both[0] + both[1]) / 2, atol=1e-5)


def test_cabrals_maps_hold_what_does_not_depend_on_the_view(rng: np.random.Generator):
    terms = np.zeros((9, 3, 10, 20), np.float32)
    terms[0] = rng.normal(size=(3, 10, 20))
    world = global_map(ReflectionMap(terms))
    centres, views = some_directions(rng, 30), some_directions(rng, 30)
    assert_allclose(
        icosahedral_maps(world).radiance(centres, views), world.radiance(centres, views), atol=1e-5
    )


def test_kautz_and_mccools_texture_is_the_mean_over_azimuths(local: ReflectionMap):
    """[R02, eq. 5.25], against views at equal steps around the centre."""
    texture = view_angle_texture(local, 7)
    phi = np.arange(8) * np.pi / 4
    for theta, found in zip(np.linspace(0, np.pi, 7), texture.maps, strict=True):
        around = np.stack(
            [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.full(8, np.cos(theta))], axis=-1
        )
        assert_allclose(found, local.seen_from(around).mean(axis=0), atol=1e-5)
    # Between angles it is linear.
    centres = latlong_directions(10)[3:7, ::5].reshape(-1, 3)
    side = np.cross(centres, [0.0, 0, 1])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    views = np.cos(1.25 * np.pi / 6) * centres + np.sin(1.25 * np.pi / 6) * side
    truth = 0.75 * texture.maps[1] + 0.25 * texture.maps[2]
    assert_allclose(texture.radiance(centres, views), truth[:, 3:7, ::5].reshape(3, -1).T, atol=1e-5)
    with pytest.raises(ValueError, match="count - 2 is -1"):
        view_angle_texture(local, 1)


@pytest.mark.slow
def test_explicit_maps_lose_more_than_the_terms_they_are_made_of(rng: np.random.Generator):
    """[R02, fig. 5.8 and 5.9]: fibres, whose maps change fast with the view, against the finest reflection maps."""
    light = rng.lognormal(size=(5, 10, 3))
    fibres = chosen_brdf("kajiya-kay:16", {}).brdf
    fine = prefilter(light, fibres, epsilon=1e-4)
    few = prefilter(light, fibres).lobes[0]
    axes, views = some_directions(rng, 400), some_directions(rng, 400)
    truth = fine.radiance(axes, views)
    errors = [
        np.sqrt(np.mean((found.radiance(axes, views) - truth) ** 2) / np.mean(truth**2))
        for found in (few, icosahedral_maps(few.world), view_angle_texture(few.local, 60))
    ]
    assert errors[0] < 0.06
    assert errors[1] > 3 * errors[0]
    # They have no azimuth: Kautz and McCool's texture loses nothing but the steps of its angle.
    assert errors[2] < 1.1 * errors[0]
    # Microfacets have one, at grazing views above all.
    gloss = prefilter(light, chosen_brdf("microfacet:0.4", {}).brdf).lobes[0]
    exact = prefilter(light, chosen_brdf("microfacet:0.4", {}).brdf, orders=(10, 12))
    normals = views + some_directions(rng, 400)
    normals *= np.sign((normals * views).sum(axis=1, keepdims=True))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    centres, truth = gloss.lobe.centres(normals, views), exact.radiance(normals, views)
    ours, theirs = (
        np.sqrt(np.mean((found - truth) ** 2))
        for found in (
            gloss.radiance(normals, views),
            view_angle_texture(gloss.local, 40).radiance(centres, views),
        )
    )
    assert theirs > 1.2 * ours
