"""What is interpolated of a lobe under a map, against the integral over directions, ray by ray."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from capture.camera import Camera
from capture.lighting import Lighting
from invrender.brdf.form import Angles
from invrender.brdf.lobes import FORMS
from invrender.brdf.microfacet import Microfacet
from invrender.output.render.light import light_element
from invrender.output.render.options import RenderOptions, check_options
from invrender.output.render.picture import Picture, take_picture
from invrender.output.render.subject import Subject, sphere_subject
from invrender.result.reflectance import Reflectance
from invrender.transport.interpolated import InterpolatedLobe, interpolated
from invrender.transport.scattered_cubics import RayPlaces, ScatteredCubics
from recon.mesh.bodies import MeshBody
from recon.mesh.trianglemesh import TriangleMesh
from synthetic.lights.arealight import AreaLight
from synthetic.lights.illumination import latlong_map

from .quadrature import sphere_grid

LAMPS = (
    AreaLight(np.array([-0.26, 0.72, 0.64]), np.array([1.5, 1.6, 1.8]), width_rad=0.5),
    AreaLight(np.array([0.7, -0.1, 0.7]), np.array([0.9, 0.5, 0.3]), width_rad=0.8),
)


def ball(rng: np.random.Generator, count: int, bumps: float) -> tuple[np.ndarray, np.ndarray]:
    """Normals and views of a ball seen from four radii; bumps turn its normals by about so many radians."""
    places = rng.normal(size=(4 * count, 3))
    places /= np.linalg.norm(places, axis=1, keepdims=True)
    views = np.array([4.0, 0, 0]) - places
    views /= np.linalg.norm(views, axis=1, keepdims=True)
    normals = places + bumps * np.sin(9 * places[:, [1, 2, 0]])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    seen = np.flatnonzero((normals * views).sum(axis=1) > 0.03)[:count]
    return normals[seen], views[seen]


@pytest.mark.parametrize(("name", "bumps"), [("microfacet", 0.0), ("microfacet", 0.1), ("GGX", 0.1)])
def test_few_integrals_make_all_of_them(name: str, bumps: float, rng: np.random.Generator) -> None:
    brdf = Microfacet(np.full(3, 0.1), np.ones(3), 1.5, 0.15, FORMS[name])
    light = light_element(Lighting("room", latlong_map(LAMPS, 128), np.zeros((0, 3)), np.zeros((0, 3))))
    normals, views = ball(rng, 15_000, bumps)
    found = InterpolatedLobe(brdf, light, 0.005).towards(normals, views)
    directions, weights = sphere_grid(120)
    radiance = sum(lamp.radiance_from(directions) for lamp in LAMPS)
    some = np.arange(0, 15_000, 150)
    truth = np.array(
        [
            (weights * brdf.form.reflected(Angles.between(normals[k], directions, views[k]), 1.5, 0.15))
            @ radiance
            for k in some
        ]
    )
    # The tolerance; the map's pixels and the integral itself take as much again.
    assert np.sqrt(np.mean((found[some] - truth) ** 2)) < 0.01 * np.sqrt(np.mean(truth**2))


def test_integrals_are_taken_where_the_light_varies(rng: np.random.Generator) -> None:
    """One sharp feature takes more than uniform light, and far fewer than all rays."""
    normals, views = ball(rng, 40_000, 0.05)
    middle = np.array([0.8, 0.6, 0.0])

    def taken(height: float) -> tuple[np.ndarray, int, np.ndarray]:
        asked: list[np.ndarray] = []

        def integral(n: np.ndarray, v: np.ndarray) -> np.ndarray:
            asked.append(n)
            mirrored = 2 * (n * v).sum(axis=1)[:, None] * n - v
            apart = np.linalg.norm(mirrored - middle, axis=1)
            return 1 + height * np.exp(-((apart / 0.2) ** 2))[:, None]

        found = interpolated(integral, np.ones(len(normals)), normals, views, 0.1, 0.005)
        every = integral(normals, views)
        count = sum(map(len, asked[:-1]))
        return found, count, every

    flat, few, _ = taken(0.0)
    np.testing.assert_allclose(flat, 1, atol=1e-4)  # terms that are held small
    found, count, every = taken(20.0)
    # Twice the tolerance: what is expected of a cell is measured in others.
    assert np.sqrt(np.mean((found - every) ** 2)) < 0.01 * np.sqrt(np.mean(every**2))
    assert few < count < len(normals) / 4


def test_few_rays_are_integrated_each(rng: np.random.Generator) -> None:
    normals, views = ball(rng, 50, 0.0)
    found = interpolated(lambda n, v: n + 2, np.ones(50), normals, views, 0.1, 0.005)
    np.testing.assert_array_equal(found, normals + 2)


def test_cubics_are_of_fourth_order_and_new_nodes_change_only_what_they_reach(
    rng: np.random.Generator,
) -> None:
    normals, views = ball(rng, 20_000, 0.0)
    places = RayPlaces.of(normals, views, 1.0)
    # Away from grazing all rays lie in one band.
    middle = np.flatnonzero((normals * views).sum(axis=1) > 0.5)
    order = rng.permutation(middle)
    values = np.column_stack([np.sin(12 * places.normals[:, 1]), np.cos(9 * places.normals[:, 2])])

    def cubics(count: int) -> ScatteredCubics:
        return ScatteredCubics.around(places, order[:count], values[order[:count]])

    inner = np.flatnonzero((normals * views).sum(axis=1) > 0.7)
    coarse, fine = (np.abs(cubics(count).at(inner) - values[inner]).mean() for count in (400, 1600))
    # Half the spacing: 16 times less, if scattered nodes were as even as a grid.
    assert fine < coarse / 10
    grown = cubics(1560).joined_by(order[1560:1600], values[order[1560:1600]])
    np.testing.assert_allclose(grown.at(middle), cubics(1600).at(middle), atol=1e-12)


def mesh_of_a_ball() -> Subject:
    """A ball of triangles, whose rays no grid knows; it casts no shadow on itself."""
    ball = trimesh.creation.icosphere(subdivisions=5)
    body = MeshBody(TriangleMesh(ball.vertices, ball.faces, ball.vertices))
    return Subject(body, np.zeros(3), 1.0)


BALLS = {"sphere": sphere_subject(np.zeros(3), 1.0), "mesh": mesh_of_a_ball()}


def ball_in_a_room(name: str, tolerance: float) -> Picture:
    """A ball under a map, and a lamp beside the map."""
    lighting = Lighting(
        "room", latlong_map(LAMPS, 128), np.array([[0.0, 0.6, 0.8]]), np.array([[1.0, 0.8, 0.6]])
    )
    brdf = Microfacet(np.full(3, 0.1), np.array([0.2, 0.1, 0.1]), 1.6, 0.2)
    pose = np.array([[0, 1, 0, 0], [0, 0, -1, 0], [-1, 0, 0, 5], [0, 0, 0, 1.0]])
    camera = Camera("ORTHOGRAPHIC", np.array([16.0, 20, 20]), 40, 40, pose)
    known = Reflectance(brdf, np.zeros((3, 4, 4)), {}, ())
    return take_picture(BALLS[name], camera, known, light_element(lighting), tolerance=tolerance)


@pytest.mark.parametrize("name", BALLS)
def test_pictures_are_those_of_an_integral_for_each_ray(name: str) -> None:
    one, other = ball_in_a_room(name, 0.005), ball_in_a_room(name, 0.0)
    off = one.radiance - other.radiance
    # Of the brightest: the integral ray by ray is good to 0.3% itself.
    assert 0 < np.abs(off).max() < 0.015 * one.radiance.max()
    left = np.linalg.norm(off) / np.linalg.norm(other.radiance)
    assert left < 0.005
    # A third of the pixels is tried.
    assert one.interpolated == pytest.approx(left, rel=0.25)
    assert other.interpolated is None


def test_a_wider_tolerance_is_used_and_said() -> None:
    narrow, wide = (ball_in_a_room("mesh", tolerance) for tolerance in (0.005, 0.1))
    assert narrow.interpolated is not None
    assert wide.interpolated is not None
    assert 2 * narrow.interpolated < wide.interpolated < 0.1


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"tolerance": -1.0}, "--tolerance is -1%; it must be 0"),
        ({"tolerance": 50.0}, "to 10"),
        ({"tolerance": 1.0, "preview": True}, "with --preview nothing is"),
        ({"tolerance": 1.0, "std": True}, "with --std nothing is"),
    ],
)
def test_tolerances_that_mean_nothing_are_refused(options: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        check_options(RenderOptions(result=Path("result"), out=Path("out.exr"), **options))
