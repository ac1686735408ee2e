"""Interreflection gathered: against closed forms, and against random paths, which interpolate nothing."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from recon.mesh.trianglemesh import TriangleMesh
from synthetic.lights.arealight import AreaLight
from synthetic.lights.illumination import Illumination
from synthetic.lights.sources import DirectionalSource
from synthetic.materials.facets import GGXSlopes
from synthetic.materials.lambertian import Lambertian
from synthetic.materials.material import Material
from synthetic.materials.smith import SmithMaterial
from synthetic.render.lattice import lattice
from synthetic.render.paths import indirect_light
from synthetic.render.radiosity import bounced_light, parts_light
from synthetic.shapes.meshsurface import MeshSurface
from synthetic.shapes.surface import Points

from .bodies import corner

Floats = NDArray[np.float64]

LAB = Illumination(
    "lab",
    (AreaLight(np.array([0.5, 0.5, 0.7]), np.array([1.0, 1.2, 1.4]), 0.4),),
    (DirectionalSource(np.array([0.8, -0.5, 0.4]), np.array([1.0, 0.9, 0.8])),),
)
MATTE = Lambertian(np.array([0.27, 0.2, 0.1]))
GLOSSY = SmithMaterial(np.array([0.12, 0.1, 0.08]), np.array([0.4, 0.35, 0.3]), None, GGXSlopes(0.3, 0.3))


@pytest.fixture(scope="module")
def cat(cat_mesh: TriangleMesh) -> MeshSurface:
    return MeshSurface(cat_mesh)


def hollows(cat: MeshSurface, rng: np.random.Generator) -> tuple[Points, Floats]:
    """Points that much of the cat surrounds, each many times, and the directions they are seen from."""
    targets = 0.5 * cat.reach * rng.normal(size=(4000, 3))
    ways = rng.normal(size=(4000, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    hit, points = cat.first_hits(targets - 5 * cat.reach * ways, ways)
    views = -ways[hit]
    once = indirect_light(cat, MATTE, LAB, points, views, 1, rng)[:, 0]
    chosen = np.flatnonzero((once > 0) & ((points.normals * views).sum(axis=1) > 0.2))[:150]
    return points[chosen], views[chosen]


@pytest.mark.parametrize(
    ("material", "bounces"),
    [pytest.param(MATTE, 1, marks=pytest.mark.sweep), (GLOSSY, 3)],
    ids=lambda value: str(value)[:6],
)
@pytest.mark.parametrize("everywhere", [False, True], ids=["interpolated", "everywhere"])
def test_gathered_light_is_that_of_random_paths(
    cat: MeshSurface,
    rng: np.random.Generator,
    monkeypatch: pytest.MonkeyPatch,
    material: Material,
    bounces: int,
    everywhere: bool,
) -> None:
    # An eighth of the directions at vertices: their scatter of 1.4% is half of what the paths leave in one point.
    monkeypatch.setattr("synthetic.render.radiosity._PARTS", 256)
    monkeypatch.setattr("synthetic.render.radiosity._SOFT", 256)
    points, views = hollows(cat, rng)
    count, rounds = len(points), 250
    again = np.tile(np.arange(count), rounds)
    paths = indirect_light(cat, material, LAB, points[again], views[again], bounces, rng)
    means = paths.reshape(rounds, count, 3).mean(axis=1)
    error = means.std(axis=0) / np.sqrt(rounds)
    light = parts_light(cat, material, LAB, bounces)
    lattices = np.broadcast_to(lattice(512), (count, 512, 2))
    gathered = bounced_light(light, points, views, lattices, rng, np.arange(count), everywhere)
    assert (error < 0.03 * means.mean(axis=0)).all()
    # Four standard errors of the paths; 1% for the mesh's 2 mm between vertices and lobes taken for matte.
    assert_allclose(gathered.mean(axis=0), means.mean(axis=0), atol=4 * error.max() + 0.01 * means.mean())
    # Point by point too: most lies within the paths' own scatter.
    scatter = paths.reshape(rounds, count, 3).std(axis=0) / np.sqrt(rounds)
    off = np.abs(gathered - paths.reshape(rounds, count, 3).mean(axis=0))
    assert np.median(off / scatter) < 1.0


def test_a_floor_is_lit_by_its_wall_as_the_view_factor_says(rng: np.random.Generator) -> None:
    # From distance d the wall fills F(d) = (1 - d / sqrt(1 + d^2)) / 2 of the view [Howell, B-5]; it is lit evenly,
    # irradiance 2, as light comes down on it at 45 degrees; so the floor receives pi kd 2 F from it.
    wedge = corner(1.0, 40.0)
    slanted = Illumination(
        "slanted", (), (DirectionalSource(np.array([1.0, 0, 1.0]), np.full(3, 2 * np.sqrt(2))),)
    )
    grey = Lambertian(np.full(3, 0.25))
    distances = np.array([0.05, 0.3, 0.8])
    hit, points = wedge.first_hits(
        np.column_stack([distances, np.zeros(3), np.full(3, 0.5)]), np.tile([0, 0, -1.0], (3, 1))
    )
    assert hit.all()
    views = np.tile([0.0, 0, 1], (3, 1))
    lattices = np.broadcast_to(lattice(4096), (3, 4096, 2))
    light = parts_light(wedge, grey, slanted, 1)
    radiance = bounced_light(light, points, views, lattices, rng, np.arange(3))
    factor = (1 - distances / np.hypot(1, distances)) / 2
    # 16384 directions, of which an edge parts those that meet the wall: 1e-3.
    assert_allclose(radiance[:, 0], 0.25 * np.pi * 0.25 * 2 * factor, rtol=5e-3)
