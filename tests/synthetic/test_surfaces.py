"""Surfaces: the analytic sphere, meshes against it, and what both promise."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from recon.mesh.trianglemesh import TriangleMesh, smooth_normals
from synthetic.shapes.ball import Ball
from synthetic.shapes.meshsurface import MeshSurface
from synthetic.shapes.surface import Points, Surface
from synthetic.shapes.tangents import tangents

Floats = NDArray[np.float64]

CENTRE, RADIUS = np.array([0.3, -0.2, 0.1]), 0.05


def unit(vectors: Floats) -> Floats:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def directions(rng: np.random.Generator, count: int) -> Floats:
    return unit(rng.normal(size=(count, 3)))


def sphere_mesh(columns: int = 128) -> TriangleMesh:
    """A sphere of a grid in longitude and latitude, with the ball's texture coordinates and a seam."""
    u, v = np.meshgrid(np.arange(columns + 1) / columns, np.arange(columns // 2 + 1) / (columns // 2))
    uv = np.column_stack([u.ravel(), v.ravel()])
    phi, theta = 2 * np.pi * (uv[:, 0] % 1), np.pi * (1 - uv[:, 1])
    # Exactly one place at the poles and at the seam.
    across = np.where((uv[:, 1] == 0) | (uv[:, 1] == 1), 0, np.sin(theta))
    normals = np.column_stack([across * np.cos(phi), across * np.sin(phi), np.cos(theta)])
    row, column = (a.ravel() for a in np.indices((columns // 2, columns)))
    first = row * (columns + 1) + column
    above = first + columns + 1
    faces = np.concatenate(
        [
            np.column_stack([first, first + 1, above + 1])[row > 0],
            np.column_stack([first, above + 1, above])[row < columns // 2 - 1],
        ]
    )
    return TriangleMesh(CENTRE + RADIUS * normals, faces, normals, uv)


def plain_mesh(body: trimesh.Trimesh) -> MeshSurface:
    vertices, faces = np.array(body.vertices), np.array(body.faces)
    return MeshSurface(TriangleMesh(vertices, faces, smooth_normals(vertices, faces)))


def check_frames(points: Points) -> None:
    for vectors in (points.normals, points.facets, points.tangents):
        np.testing.assert_allclose(np.linalg.norm(vectors, axis=1), 1, rtol=1e-12)  # rounding
    np.testing.assert_allclose((points.normals * points.tangents).sum(axis=1), 0, atol=1e-12)  # rounding


def seen(rng: np.random.Generator, surface: Surface, count: int = 20_000) -> tuple[Floats, Floats, Points]:
    """Rays from all around that meet the surface, and where."""
    targets = surface.centre + rng.uniform(-1.2, 1.2, (count, 3)) * surface.reach
    ways = directions(rng, count)
    origins = targets - 5 * surface.reach * ways
    hit, points = surface.first_hits(origins, ways)
    assert 0.2 < hit.mean() < 0.95
    return origins[hit], ways[hit], points


def test_a_ball_is_met_where_the_quadratic_says(rng: np.random.Generator) -> None:
    ball = Ball(CENTRE, RADIUS)
    origins, ways, points = seen(rng, ball)
    offset = origins - CENTRE
    b = (offset * ways).sum(axis=1)
    root = np.sqrt(b**2 - (offset**2).sum(axis=1) + RADIUS**2)
    # The discriminant loses digits to cancellation where the ray grazes: 1e-16 (5 radii)^2 under a root.
    np.testing.assert_allclose(
        points.positions, origins + (-b - root)[:, None] * ways, rtol=0, atol=1e-8 * RADIUS
    )
    np.testing.assert_allclose(np.linalg.norm(points.positions - CENTRE, axis=1), RADIUS, rtol=1e-13)
    np.testing.assert_array_equal(points.normals, points.facets)
    check_frames(points)


def test_a_ball_is_met_ahead_only_and_from_inside_where_it_is_left(rng: np.random.Generator) -> None:
    ball = Ball(CENTRE, RADIUS)
    origins, ways, points = seen(rng, ball)
    assert not ball.first_hits(origins, -ways)[0].any()
    inside = CENTRE + RADIUS * rng.uniform(0, 0.99, (1000, 1)) * directions(rng, 1000)
    ways = directions(rng, 1000)
    hit, points = ball.first_hits(inside, ways)
    assert hit.all()
    travelled = points.positions - inside
    np.testing.assert_allclose(
        unit(travelled), ways, atol=1e-11
    )  # rounding, over as little as a hundredth radius
    assert ((points.normals * ways).sum(axis=1) > 0).all()


def test_texture_coordinates_of_a_ball_are_its_angles() -> None:
    ways = unit(np.array([[1, 0, 0], [0, 1, 0], [-1, -1, 0], [1, 0, 1], [0, 0, 1], [0, 0, -1.0]]))
    ball = Ball(CENTRE, RADIUS)
    hit, points = ball.first_hits(CENTRE + ways, -ways)
    assert hit.all()
    uv = [[0, 0.5], [0.25, 0.5], [0.625, 0.5], [0, 0.75], [0, 1], [0, 0]]
    np.testing.assert_allclose(points.uv[:4], uv[:4], atol=1e-12)  # rounding
    np.testing.assert_allclose(
        points.uv[:, 1], np.array(uv)[:, 1], atol=1e-12
    )  # u has no meaning at the poles
    along_phi = unit(np.array([[0, 1, 0], [-1, 0, 0], [1, -1, 0], [0, 1, 0]], float))
    np.testing.assert_allclose(points.tangents[:4], along_phi, atol=1e-12)  # rounding


def test_a_fine_mesh_of_a_sphere_is_the_ball(rng: np.random.Generator) -> None:
    ball, surface = Ball(CENTRE, RADIUS), MeshSurface(sphere_mesh())
    origins, ways, points = seen(rng, surface)
    check_frames(points)
    hit, exact = ball.first_hits(origins, ways)
    assert hit.all()
    facing = -(exact.normals * ways).sum(axis=1) > 0.3
    error = np.linalg.norm(points.positions - exact.positions, axis=1)[facing]
    # A chord of 2 pi / 128 is 3.0e-4 radii below the circle, twice that on the diagonals, seen at up to 1 / 0.3.
    assert error.max() < 7e-4 * RADIUS / 0.3
    # Smooth normals turn with the points; facets by as much as half a diagonal, 0.035 rad.
    assert np.linalg.norm(points.normals - exact.normals, axis=1)[facing].max() < 4e-3
    assert 0.02 < np.linalg.norm(points.facets - exact.normals, axis=1)[facing].max() < 0.05
    # Near the poles a triangle's u and v are not linear in position; the seam makes no exception.
    middle = facing & (np.abs(exact.normals[:, 2]) < 0.9)
    apart = (points.uv - exact.uv + 0.5) % 1 - 0.5
    assert np.abs(apart[middle]).max() < 0.006
    # Half a column of the grid, 0.0245 rad.
    assert np.linalg.norm(points.tangents - exact.tangents, axis=1)[middle].max() < 0.0245


def test_facets_and_positions_are_the_triangles_own(rng: np.random.Generator) -> None:
    box = plain_mesh(trimesh.creation.box((0.2, 0.3, 0.4)))
    origins, ways, points = seen(rng, box)
    side = np.abs(points.positions / np.array([0.1, 0.15, 0.2])).argmax(axis=1)
    normals = np.sign(points.positions[np.arange(len(side)), side])[:, None] * np.eye(3)[side]
    np.testing.assert_allclose(points.facets, normals, atol=1e-14)  # rounding
    travelled = np.linalg.norm(points.positions - origins, axis=1)
    along = origins + travelled[:, None] * ways
    np.testing.assert_allclose(points.positions, along, atol=4e-7)  # single precision: 1e-6 of 0.4 m


@pytest.mark.parametrize(
    ("along", "u", "v"),
    [([0, 1, 0], [0, 1], [1, 0]), ([-1, 0, 0], [-1, 0], [0, 1]), ([0.6, -0.8, 0], [0.3, -0.4], [0.8, 0.6])],
    ids=["mirrored", "backwards", "turned"],
)
def test_tangents_follow_u(along: list[float], u: list[float], v: list[float]) -> None:
    slab = trimesh.creation.box(bounds=[[-1, -1, -1], [1, 1, 0]]).subdivide().subdivide()
    vertices, faces = np.array(slab.vertices), np.array(slab.faces)
    # On the slab's sides, which are edge-on to the map, u has no direction.
    uv = vertices[:, :2] @ np.array([u, v]).T
    surface = MeshSurface(TriangleMesh(vertices, faces, smooth_normals(vertices, faces), uv))
    hit, points = surface.first_hits(
        np.array([[0.13, 0.21, 1.0], [1.9, 0.3, -0.5]]), np.array([[0.0, 0, -1], [-1, 0, 0]])
    )
    assert hit.all()
    np.testing.assert_allclose(
        points.uv[0], [np.dot(u, [0.13, 0.21]), np.dot(v, [0.13, 0.21])], atol=1e-6
    )  # Embree's coordinates are in single precision.
    np.testing.assert_allclose(points.tangents[0], along, atol=1e-12)  # rounding
    check_frames(points)


def test_tangents_without_a_direction_are_horizontal(rng: np.random.Generator) -> None:
    normals = np.concatenate([directions(rng, 1000), [[0, 0, 1.0], [0, 0, -1]]])
    level = tangents(normals)
    np.testing.assert_allclose(level[:, 2], 0, atol=1e-15)  # rounding
    assert (np.cross([0, 0, 1.0], normals) * level).sum(axis=1)[:-2].min() > 0
    np.testing.assert_array_equal(level[-2:], [[0, 1, 0], [0, 1, 0]])
    # A direction along the normal says nothing, nor does none; one that is nearly along it still does.
    given = np.array([[0, 0, 2.0], [0, 0, 0], [1e-4, 0, 1]])
    up = np.broadcast_to([0.0, 0.0, 1.0], (3, 3))
    np.testing.assert_allclose(tangents(up, given), [[0, 1, 0], [0, 1, 0], [1, 0, 0]], atol=1e-15)  # rounding


@pytest.mark.parametrize("kind", ["ball", "mesh"])
def test_directions_below_the_facet_are_occluded_and_no_others_of_a_sphere(
    rng: np.random.Generator, kind: str
) -> None:
    surface: Surface = Ball(CENTRE, RADIUS) if kind == "ball" else MeshSurface(sphere_mesh(48))
    _, _, points = seen(rng, surface)
    ways = directions(rng, len(points))
    above = (points.facets * ways).sum(axis=1) > 0
    near = np.full(len(points), 0.1 * RADIUS)
    for distances in (None, near):
        occluded = surface.occluded(points.positions, points.facets, ways, distances)
        np.testing.assert_array_equal(occluded, ~above)
    met, _ = surface.first_hits(points.positions[above], ways[above], points.facets[above])
    assert not met.any()


def torus() -> MeshSurface:
    return plain_mesh(trimesh.creation.torus(major_radius=0.1, minor_radius=0.04, major_sections=64))


def test_a_torus_shadows_its_hole_and_its_other_side_is_met(rng: np.random.Generator) -> None:
    surface = torus()
    angle = rng.uniform(0, 2 * np.pi, 200)
    inward = -np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    hit, points = surface.first_hits(np.zeros((200, 3)), -inward)
    assert hit.all()
    # From the inner equator towards the axis: the other side is twice the hole's radius, 0.12 m, away.
    for distance, expected in ((0.115, False), (0.125, True), (np.inf, True)):
        ends = np.full(200, distance)
        occluded = surface.occluded(points.positions, points.facets, inward, ends)
        np.testing.assert_array_equal(occluded, expected)
    hit, across = surface.first_hits(points.positions, inward, points.facets)
    assert hit.all()
    np.testing.assert_allclose(np.linalg.norm(across.positions, axis=1), 0.06, atol=3e-4)  # its polygons


def test_inside_is_where_the_formula_says(rng: np.random.Generator) -> None:
    places = rng.uniform(-0.15, 0.15, (20_000, 3))
    from_ring = np.hypot(np.hypot(places[:, 0], places[:, 1]) - 0.1, places[:, 2])
    # The polygons of 64 and 32 corners lie up to 5e-4 m within the torus.
    clear = np.abs(from_ring - 0.04) > 6e-4
    np.testing.assert_array_equal(torus().contains(places)[clear], (from_ring < 0.04)[clear])
    ball = Ball(CENTRE, RADIUS)
    np.testing.assert_array_equal(ball.contains(CENTRE + places), np.linalg.norm(places, axis=1) < RADIUS)


def test_the_bounding_sphere_holds_all_of_the_mesh() -> None:
    surface = torus()
    np.testing.assert_allclose(surface.centre, 0, atol=1e-12)  # rounding
    assert surface.reach == pytest.approx(0.14, rel=1e-12)


def test_surfaces_go_to_other_processes(rng: np.random.Generator) -> None:
    for surface in (Ball(CENTRE, RADIUS), MeshSurface(sphere_mesh(24))):
        copy = pickle.loads(pickle.dumps(surface))
        origins, ways, points = seen(rng, surface, 500)
        hit, again = copy.first_hits(origins, ways)
        assert hit.all()
        np.testing.assert_array_equal(again.positions, points.positions)
        np.testing.assert_array_equal(again.tangents, points.tangents)


def test_what_encloses_nothing_is_an_error() -> None:
    mesh = sphere_mesh(24)
    with pytest.raises(ValueError, match="isn't closed"):
        MeshSurface(TriangleMesh(mesh.vertices, mesh.faces[1:], mesh.normals))
    with pytest.raises(ValueError, match=r"inside out \(volume -0.0005"):
        MeshSurface(TriangleMesh(mesh.vertices, mesh.faces[:, ::-1], mesh.normals))
    with pytest.raises(ValueError, match=r"radius is 0\.0 m"):
        Ball(CENTRE, 0.0)
    with pytest.raises(ValueError, match=r"centre is \[0.0, nan, 0.0\]"):
        Ball(np.array([0, np.nan, 0]), 1.0)
