"""Interreflection: furnaces in which all is known, a corner's closed forms, and a sum over all pairs of points."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from recon.mesh.trianglemesh import TriangleMesh
from synthetic.lights.arealight import AreaLight
from synthetic.lights.illumination import Illumination
from synthetic.lights.latlong import LatLongLight
from synthetic.lights.sources import DirectionalSource
from synthetic.materials.facets import BeckmannSlopes, GGXSlopes
from synthetic.materials.lambertian import Lambertian
from synthetic.materials.material import Material
from synthetic.materials.mirror import Mirror
from synthetic.materials.phong import PhongMaterial
from synthetic.materials.smith import SmithMaterial
from synthetic.render.gather import direct_light
from synthetic.render.lattice import lattice
from synthetic.render.paths import indirect_light
from synthetic.shapes.ball import Ball
from synthetic.shapes.meshsurface import MeshSurface
from synthetic.shapes.surface import Points, Surface
from synthetic.shapes.tangents import tangents

from .bodies import corner, facet_points, flat

Floats = NDArray[np.float64]

UNIFORM = Illumination("uniform", (AreaLight(np.array([0.3, 0.5, 0.8]), np.ones(3), 1e6),))
WHITE = Lambertian(np.full(3, 1 / np.pi))


def unit(vectors: Floats) -> Floats:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


@pytest.fixture(scope="module")
def cat(cat_mesh: TriangleMesh) -> MeshSurface:
    return MeshSurface(cat_mesh)


@pytest.fixture(scope="module")
def flat_cat(cat: MeshSurface) -> MeshSurface:
    return flat(np.array(cat.mesh.vertices), np.array(cat.mesh.faces))


def looked_at(surface: Surface, rng: np.random.Generator, count: int) -> tuple[Points, Floats]:
    """Points of a surface that rays from all around meet first, and where they come from."""
    targets = surface.centre + 0.5 * surface.reach * rng.normal(size=(count, 3))
    ways = unit(rng.normal(size=(count, 3)))
    hit, points = surface.first_hits(targets - 5 * surface.reach * ways, ways)
    return points, -ways[hit]


def direct(
    surface: Surface, material: Material, light: Illumination, points: Points, views: Floats
) -> Floats:
    lattices = np.broadcast_to(lattice(1024), (len(points), 1024, 2))
    rng = np.random.default_rng(3)
    irradiance, lobe = direct_light(surface, material, light, points, views, lattices, rng)
    return np.asarray(material.kd * irradiance + material.ks * lobe)


@pytest.mark.parametrize(("deep", "rounds"), [(True, 1500), (False, 30)], ids=["hollows", "open"])
def test_a_white_cat_in_a_furnace_is_invisible(
    flat_cat: MeshSurface, rng: np.random.Generator, deep: bool, rounds: int
) -> None:
    # What loses no light shows, under light from all around, the same from everywhere, hollows included.
    points, views = looked_at(flat_cat, rng, 6000)
    sky = direct(flat_cat, WHITE, UNIFORM, points, views)[:, 0]
    chosen = np.flatnonzero((sky < 0.6) == deep)
    again = np.tile(chosen, rounds)
    indirect = indirect_light(flat_cat, WHITE, UNIFORM, points[again], views[again], 16, rng)[:, 0]
    error = indirect.std() / np.sqrt(len(again))
    assert error < 5e-3
    # Four standard errors; after 16 reflections a thousandth of the light is still under way in the hollows.
    assert abs(sky[chosen].mean() + indirect.mean() - 1) < 4 * error + 1e-3
    # Without what the other parts reflect, hollows are dark.
    assert (sky[chosen].mean() < 0.5) == deep


def test_a_mirror_cat_in_a_furnace_is_invisible_without_any_noise(
    flat_cat: MeshSurface, rng: np.random.Generator
) -> None:
    points, views = looked_at(flat_cat, rng, 3000)
    mirror = Mirror(np.zeros(3), np.ones(3))
    seen = direct(flat_cat, mirror, UNIFORM, points, views)
    total = seen + indirect_light(flat_cat, mirror, UNIFORM, points, views, 16, rng)
    assert (seen[:, 0] == 0).mean() > 0.05
    # Every path leaves at last, with all it had: none of these needs more than 16 reflections.
    assert_allclose(total, 1, atol=1e-5)  # single precision


def test_a_lossy_cat_in_a_furnace_is_darker_by_every_reflection(
    cat: MeshSurface, rng: np.random.Generator
) -> None:
    points, views = looked_at(cat, rng, 20_000)
    grey = Lambertian(np.array([0.2, 0.5, 0.8]) / np.pi)
    sky = direct(cat, WHITE, UNIFORM, points, views)
    indirect = indirect_light(cat, grey, UNIFORM, points, views, 16, rng)
    total = (sky * (grey.kd * np.pi) + indirect).mean(axis=0)
    once = (indirect_light(cat, grey, UNIFORM, points, views, 1, rng) / (grey.kd * np.pi) ** 2).mean(axis=0)
    # The first reflection between parts is proportional to the square of the albedo, whatever the channel.
    assert_allclose(once, once.mean(), rtol=1e-12)  # the same paths for all channels
    assert (total < 1).all()
    assert (np.diff(total / (grey.kd * np.pi)) > 0).all()


@pytest.fixture(scope="module")
def wedge() -> MeshSurface:
    return corner(1.0, 40.0)


# Light comes down at 45 degrees to floor and wall alike: the irradiance of each is 2.
SLANTED = Illumination(
    "slanted", (), (DirectionalSource(np.array([1.0, 0, 1.0]), np.full(3, 2 * np.sqrt(2))),)
)


def floor_points(distances: Floats, count: int) -> tuple[Points, Floats]:
    """Points of the wedge's floor, each so many times, and a viewer."""
    places = np.repeat(distances, count)
    points = facet_points(np.column_stack([places, np.zeros_like(places), np.zeros_like(places)]), (0, 0, 1))
    return points, np.tile(unit(np.array([0.5, 0.3, 0.9])), (len(places), 1))


def test_floor_and_wall_light_each_other_as_their_view_factors_say(
    wedge: MeshSurface, rng: np.random.Generator
) -> None:
    # From distance d the wall fills F(d) = (1 - d / sqrt(1 + d^2)) / 2 of the view, its strip from y to y + dy
    # d y / (2 (d^2 + y^2)^(3/2)) dy [Howell, B-5]. So E1 = pi kd E0 F, E2(d) = pi kd integral of E1(y) dF.
    distances, count, albedo = np.array([0.05, 0.3, 0.8]), 60_000, 0.9
    points, views = floor_points(distances, count)
    node, weight = np.polynomial.legendre.leggauss(400)
    y, weight = (node + 1) / 2, weight / 2
    first = albedo * 2 * (1 - y / np.hypot(1, y)) / 2
    strips = distances[:, None] * y / (2 * (distances[:, None] ** 2 + y**2) ** 1.5)
    once = albedo * 2 * (1 - distances / np.hypot(1, distances)) / 2
    twice = albedo * strips @ (weight * first)
    material = Lambertian(np.full(3, albedo / np.pi))
    for bounces, irradiance in ((1, once), (2, once + twice)):
        found = indirect_light(wedge, material, SLANTED, points, views, bounces, rng)[:, 0]
        found = found.reshape(3, count)
        error = found.std(axis=1) / np.sqrt(count)
        # Rays begin 4e-3 above the floor: 1e-2 of the nearest distance's wall, less of the others'.
        slack = 0.004 / distances * 0.15 * irradiance / np.pi * albedo
        assert (np.abs(found.mean(axis=1) - albedo / np.pi * irradiance) < 4 * error + slack).all()
        assert (error < 0.01 * found.mean(axis=1)).all()


@pytest.mark.parametrize(
    "material",
    [
        SmithMaterial(np.array([0.05, 0.1, 0.0]), np.array([0.1, 0.4, 0.7]), 1.5, BeckmannSlopes(0.3, 0.3)),
        SmithMaterial(np.full(3, 0.05), np.full(3, 0.5), None, GGXSlopes(0.2, 0.5)),
        PhongMaterial(np.full(3, 0.1), np.full(3, 0.3), 20),
    ],
    ids=["Beckmann", "anisotropic GGX", "Phong"],
)
def test_one_reflection_is_the_sum_over_all_pairs_of_points(
    material: Material, rng: np.random.Generator
) -> None:
    # L(x) = integral over the wall of rho(wi, wo) rho(light, -wi) E0 cos cos / r^2 dA.
    surface = corner(1.0, 4.0)
    place, count = np.array([0.4, 0.0, 0.0]), 100_000
    points = facet_points(np.tile(place, (count, 1)), (0, 0, 1))
    view = unit(np.array([0.8, 0.3, 0.5]))
    found = indirect_light(surface, material, SLANTED, points, np.tile(view, (count, 1)), 1, rng)
    node, weight = np.polynomial.legendre.leggauss(120)
    z, y = (node + 1) / 2, 2 * node
    area = np.outer(weight, weight)
    wall = np.stack(np.broadcast_arrays(0.0, y[:, None], z), axis=-1)
    offset = wall - place
    distance = np.linalg.norm(offset, axis=-1)
    wi = offset / distance[..., None]
    floor_normal, wall_normal = np.array([0, 0, 1.0]), np.array([1.0, 0, 0])
    along_floor, along_wall = tangents(np.array([floor_normal, wall_normal]))
    light = unit(np.array([1.0, 0, 1.0]))
    leaving = material.evaluate(wall_normal, light, -wi, along_wall) * 2
    kernel = wi @ floor_normal * -(wi @ wall_normal) / distance**2 * area
    arriving = leaving * kernel[..., None]
    expected = (material.evaluate(floor_normal, wi, view, along_floor) * arriving).sum(axis=(0, 1))
    error = found.std(axis=0) / np.sqrt(count)
    assert (error < 0.02 * expected).all()
    # Four standard errors, and rays that begin 4e-4 above the floor.
    assert (np.abs(found.mean(axis=0) - expected) < 4 * error + 1e-3 * expected).all()


def test_two_mirrors_show_the_map_after_two_reflections(wedge: MeshSurface, rng: np.random.Generator) -> None:
    # Floor and wall send light back: a corner's second reflection is the view itself but for its y.
    light = LatLongLight(rng.uniform(0, 1, (8, 16, 3)))
    points, _ = floor_points(np.full(200, 0.2), 1)
    views = unit(np.column_stack([rng.uniform(1, 3, 200), rng.uniform(-1, 1, 200), np.ones(200)]))
    mirror = Mirror(np.zeros(3), np.array([0.9, 0.6, 0.3]))
    found = indirect_light(wedge, mirror, Illumination("lab", (light,)), points, views, 1, rng)
    # Floor turns z, wall turns x.
    out = views * [1, -1, 1]
    expected = light.radiance_from(out) * mirror.ks**2
    assert_allclose(found, expected, rtol=2e-5)  # single precision in directions


def test_a_ball_meets_none_of_its_own_light(rng: np.random.Generator) -> None:
    ball = Ball(np.zeros(3), 1.0)
    points, views = looked_at(ball, rng, 500)
    assert not indirect_light(ball, WHITE, UNIFORM, points, views, 4, rng).any()


def test_black_stays_black_and_no_reflection_is_none(wedge: MeshSurface, rng: np.random.Generator) -> None:
    points, views = floor_points(np.array([0.2]), 100)
    assert not indirect_light(wedge, Lambertian(np.zeros(3)), UNIFORM, points, views, 3, rng).any()
    assert not indirect_light(wedge, WHITE, UNIFORM, points, views, 0, rng).any()
    assert indirect_light(wedge, WHITE, UNIFORM, points, views, 1, rng).any()
