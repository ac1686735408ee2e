"""Rays from a camera to a sphere: what is interpolated over them, against brute-force sums and known functions."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from capture.camera import Camera
from capture.lighting import Lighting
from invrender.brdf.form import Angles
from invrender.brdf.lobes import FORMS
from invrender.brdf.microfacet import Microfacet
from invrender.output.render.light import light_element
from invrender.transport import sphere_rays
from invrender.transport.cached_shader import CachedShader
from invrender.transport.interpolated import InterpolatedLobe
from invrender.transport.predict import predict
from invrender.transport.sphere_rays import SphereLobe, SphereRays
from invrender.transport.transfer import light_elements
from recon.mesh.bodies import SphereBody
from recon.sampling.lightfield import LightField
from recon.sphere.sphere import Sphere
from synthetic.lights.illumination import latlong_map

from .quadrature import sphere_grid
from .test_reflected import LAMPS

NEAR = SphereRays((0.6, 0.0, 0.8), 0.25)


def seen(rays: SphereRays, count: int, rng: np.random.Generator, least_cos: float = 0.0) -> np.ndarray:
    """Unit normals (count, 3) of a sphere that a camera sees, at some exitant cosine at least."""
    normals = rng.normal(size=(20 * count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return normals[(normals * rays.views(normals)).sum(axis=1) > least_cos][:count]


@pytest.mark.parametrize("name", ["microfacet", "half-angle microfacet", "GGX"])
@pytest.mark.parametrize("rays", [NEAR, SphereRays((0.0, -1.0, 0.0), 0.0)], ids=["near", "orthographic"])
def test_the_grid_has_the_integral_of_all_rays(name: str, rays: SphereRays, rng: np.random.Generator) -> None:
    brdf = Microfacet(np.full(3, 0.1), np.ones(3), 1.5, 0.15, FORMS[name])
    light = light_element(Lighting("room", latlong_map(LAMPS, 128), np.zeros((0, 3)), np.zeros((0, 3))))
    lobe = InterpolatedLobe(brdf, light, 0.005, rays)
    # Steeper rays than this make up less than a thousandth of the picture, and sums over directions miss their lobes.
    normals = seen(rays, 60, rng, 0.03)
    views = rays.views(normals)
    directions, weights = sphere_grid(180)
    radiance = sum(lamp.radiance_from(directions) for lamp in LAMPS)
    truth = [
        (weights * brdf.form.reflected(Angles.between(normal, directions, view), 1.5, 0.15)) @ radiance
        for normal, view in zip(normals, views, strict=True)
    ]
    off = lobe.towards(normals, views) - truth
    # The tolerance; the map's pixels and the integral itself take as much again.
    assert np.linalg.norm(off) < 0.01 * np.linalg.norm(truth)
    assert lobe.over_sphere is not None
    assert lobe.over_sphere.count < 3000


def test_a_tolerance_sixteen_times_as_wide_takes_every_other_node(rng: np.random.Generator) -> None:
    normals = seen(NEAR, 4000, rng, 0.01)
    views = NEAR.views(normals)

    def integral(normals: np.ndarray, views: np.ndarray) -> np.ndarray:
        # As smooth as a lobe of 0.3 radians, and as steep as one near the outline.
        cos = (normals * views).sum(axis=1)
        middle = np.array([0.2, 0.5, 0.8])
        return (np.exp(-(((normals - middle) / 0.3) ** 2).sum(axis=1)) / cos)[:, None]

    truth = integral(normals, views)
    fine, coarse = (SphereLobe(NEAR, integral, 0.3, None, tolerance) for tolerance in (0.001, 0.016))
    found = [np.linalg.norm(own.towards(normals, views) - truth) for own in (fine, coarse)]
    # Cubics: a sixteenth, were it not for the rings near the outline, which lie close either way.
    assert found[0] < found[1] / 8
    assert found[1] < 0.016 * np.linalg.norm(truth)
    assert fine.count > 2 * coarse.count


def test_what_is_the_same_all_over_stays_so(rng: np.random.Generator) -> None:
    normals = seen(NEAR, 500, rng)
    views = NEAR.views(normals)

    def integral(normals: np.ndarray, views: np.ndarray) -> np.ndarray:
        return 1 / (normals * views).sum(axis=1, keepdims=True)

    # To rounding, at the outline too.
    lobe = SphereLobe(NEAR, integral, 0.2, None, 0.005)
    np.testing.assert_allclose(lobe.towards(normals, views), integral(normals, views), rtol=1e-9)


def test_rays_are_those_of_the_camera() -> None:
    centre, pose = np.array([0.1, 0.2, 0.3]), np.eye(4)
    pose[:3, 3] = [0.0, 0.0, 1.0]
    body = SphereBody(Sphere(centre, 0.05, np.zeros((4, 4))))
    camera = Camera("PINHOLE", np.array([500.0, 500, 60, 50]), 120, 100, pose)
    rays = SphereRays.of(body, camera)
    assert rays is not None
    hits = body.hits(camera, camera.project(centre[None]))
    np.testing.assert_allclose(rays.views(hits.normals), hits.views, atol=1e-12)
    pose[:3, 3] = -centre
    assert SphereRays.of(body, Camera("PINHOLE", camera.params, 120, 100, pose)) is None


def test_pictures_take_a_grid_as_coarse_as_serves(
    bench: SimpleNamespace, counted: Callable[[Any, str], list[None]]
) -> None:
    lighting = Lighting(
        "room", latlong_map(LAMPS, 128), np.array([[0.0, 0.6, 0.8]]), np.array([[1.0, 0.8, 0.6]])
    )
    brdf = Microfacet(np.full(3, 0.1), np.array([0.2, 0.1, 0.1]), 1.6, 0.2)
    elements, strengths = light_elements(lighting), np.array([[2.0, 1.0, 0.5]])
    field = bench.sphere_field(40.0, samples=4000)
    camera = np.array([np.cos(np.radians(40.0)), np.sin(np.radians(40.0)), 0.0])
    rays = SphereRays(
        (camera[0], camera[1], 0.0), float(np.linalg.norm(field.positions, axis=1).mean()) / 0.6
    )
    np.testing.assert_allclose(rays.views(field.normals), field.views, atol=1e-9)
    exact = predict(brdf, elements, strengths, field)

    def off(tolerance: float, samples: LightField, truth: np.ndarray) -> float:
        counts = {"room": 1}
        many = CachedShader(
            brdf, {"room": elements}, {"room": field}, {"room": rays}, counts, None, tolerance
        )
        found = many.radiance("room", strengths, samples, rays)
        return float(np.linalg.norm(found - truth) / np.linalg.norm(truth))

    grids = counted(sphere_rays, "map_coordinates")
    assert 0 < off(0.01, field, exact) < 0.01
    assert grids
    # A tolerance that the finest grid misses.
    assert off(1e-9, field, exact) == 0
    grids.clear()
    # Fewer rays than the coarsest grid has. Integrals turn half-vectors at random in each part of a picture.
    few = np.arange(len(field)) % 400 == 0
    assert off(0.01, field.where(few), exact[few]) < 1e-3
    # Channel by channel, grids were tried on the photograph that is there for it, and no more.
    assert len(grids) == 3
