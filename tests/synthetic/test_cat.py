"""The cat sculpture: closed, smooth, concave, and where it should be."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from recon.mesh.trianglemesh import TriangleMesh, is_watertight, volume
from synthetic.shapes.cat import REACH, cat_field, contains

Floats = NDArray[np.float64]


@pytest.fixture(scope="module")
def cat(cat_mesh: TriangleMesh) -> TriangleMesh:
    return cat_mesh


def test_the_mesh_is_one_closed_surface_on_the_cat(cat: TriangleMesh) -> None:
    assert is_watertight(cat)
    # Of a sphere's topology: neither legs nor tail close a ring with the body.
    assert len(cat.vertices) - len(cat.faces) // 2 == 2
    value, gradient = cat_field(cat.vertices)
    assert np.abs(value).max() < 1e-15  # rounding of 0.07 m
    np.testing.assert_allclose(
        cat.normals, gradient / np.linalg.norm(gradient, axis=1, keepdims=True), atol=1e-12
    )  # rounding
    assert np.linalg.norm(cat.vertices, axis=1).max() < REACH
    middles = np.abs(cat_field(cat.vertices[cat.faces].mean(axis=1))[0])
    # Edge squared over 24 radii, 1 cm being the median one and 1 mm the fillets'.
    assert np.median(middles) < 5e-5
    assert np.percentile(middles, 99) < 5e-4


def test_contains_agrees_with_the_winding_of_the_mesh(cat: TriangleMesh, rng: np.random.Generator) -> None:
    points = rng.uniform(-0.05, 0.06, (400, 3))
    # Farther from the surface than the mesh is.
    points = points[np.abs(cat_field(points)[0]) > 1e-3]
    inside = contains(points)
    assert 20 < inside.sum() < len(points) - 20
    np.testing.assert_allclose(_winding(cat, points), inside, atol=1e-9)  # rounding of 15,000 angles


def test_the_cat_has_legs_ears_and_tail_with_air_between() -> None:
    centimetres = {
        "left foreleg": (1.75, 0.87, -3.8),
        "right foreleg": (1.75, -0.87, -3.8),
        "left ear": (0.75, 1.4, 5.2),
        "right ear": (0.75, -1.4, 5.2),
        "tail beside the left haunch": (0.0, 3.92, -5.0),
        "nose": (3.1, 0.0, 3.05),
    }
    air = {
        "between the forelegs": (1.75, 0, -3.8),
        "between the ears": (0.8, 0, 5.2),
        "before an ear, in its hollow": (1.3, 1.3, 4.9),
        "between tail and left haunch": (0.0, 3.2, -5.0),
        "where a tail at the right would be": (0.0, -3.92, -5.0),
        "behind the head": (-2.0, 0, 3.0),
    }
    for name, place in centimetres.items():
        assert contains(np.array([place]) * 0.01)[0], name
    for name, place in air.items():
        assert not contains(np.array([place]) * 0.01)[0], name


def test_the_cat_is_far_from_convex(cat: TriangleMesh) -> None:
    assert volume(cat) < 0.6 * ConvexHull(cat.vertices).volume


def test_only_the_tail_tells_left_from_right(rng: np.random.Generator) -> None:
    points = rng.uniform(-0.05, 0.06, (2000, 3))
    points = points[(points[:, 2] > -0.035)]
    here, there = cat_field(points)[0], cat_field(points * [1, -1, 1])[0]
    close = np.minimum(here, there) < 0.005
    np.testing.assert_allclose(here[close], there[close], atol=1e-3)


def _winding(mesh: TriangleMesh, points: Floats) -> Floats:
    """How often the mesh winds around each point: the solid angles of its faces [Van Oosterom & Strackee 1983]."""
    total = np.zeros(len(points))
    for index, point in enumerate(points):
        a, b, c = (mesh.vertices[mesh.faces[:, corner]] - point for corner in range(3))
        la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
        above = (a * np.cross(b, c)).sum(axis=1)
        below = la * lb * lc + (a * b).sum(axis=1) * lc + (b * c).sum(axis=1) * la + (c * a).sum(axis=1) * lb
        total[index] = 2 * np.arctan2(above, below).sum()
    return total / (4 * np.pi)
