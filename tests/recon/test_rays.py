"""Rays against every triangle in turn, and against bodies whose shadows are known."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from recon.mesh.rays import Hits, RayTracer

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(11)


def lumps() -> tuple[Floats, Ints]:
    """A star-shaped body with hollows, 320 faces, about 0.1 m."""
    ball = trimesh.creation.icosphere(subdivisions=2)
    x, y, z = ball.vertices.T
    swelling = 1 + 0.35 * np.sin(4 * x) * np.sin(5 * y + 1) * np.sin(3 * z + 2)
    return 0.05 * swelling[:, None] * ball.vertices, ball.faces


def unit(vectors: Floats) -> Floats:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def facets_of(vertices: Floats, faces: Ints) -> Floats:
    a, b, c = (vertices[corner] for corner in faces.T)
    return unit(np.cross(b - a, c - a))


def crossings(vertices: Floats, faces: Ints, origins: Floats, directions: Floats) -> tuple[Floats, Floats]:
    """Every ray against every triangle, by Cramer's rule: distance (n, f), inf where missed, and the least weight."""
    a, b, c = (vertices[corner] for corner in faces.T)
    columns = (a - b, a - c, directions[:, None], a - origins[:, None])

    def determinant(x: Floats, y: Floats, z: Floats) -> Floats:
        return (x * np.cross(y, z)).sum(axis=-1)

    p, q, d, s = columns
    whole = determinant(p, q, d)
    u, v = determinant(s, q, d) / whole, determinant(p, s, d) / whole
    t = determinant(p, q, s) / whole
    least = np.minimum(np.minimum(u, v), 1 - u - v)
    return np.where((least >= 0) & (t > 0), t, np.inf), least


def places(tracer: RayTracer, found: Hits) -> Floats:
    hit = found.faces >= 0
    return np.einsum("nk,nkc->nc", found.weights[hit], tracer.vertices[tracer.faces[found.faces[hit]]])


def assert_on_the_rays(tracer: RayTracer, found: Hits, origins: Floats, directions: Floats) -> None:
    """What was met lies on its rays: across them, as they go on for ever along a face that they graze."""
    hit = found.faces >= 0
    assert hit.sum() > 1000
    offset = places(tracer, found) - origins[hit]
    along = (offset * directions[hit]).sum(axis=1)
    assert (along > 0).all()
    across = np.linalg.norm(offset - along[:, None] * directions[hit], axis=1) / tracer.size
    facets = facets_of(tracer.vertices, tracer.faces)[found.faces[hit]]
    grazing = np.abs((facets * directions[hit]).sum(axis=1)) < 0.1
    # Single precision of a mesh of unit size, 6e-8, some of them adding up; Embree divides by the grazing cosine.
    assert across[~grazing].max() < 1e-6
    assert np.sqrt((across**2).mean()) < 3e-7


def test_first_hits_are_those_of_brute_force(rng: np.random.Generator) -> None:
    vertices, faces = lumps()
    tracer = RayTracer(vertices, faces)
    origins = np.concatenate([0.12 * unit(rng.normal(size=(4000, 3))), rng.uniform(-0.02, 0.02, (1000, 3))])
    directions = unit(rng.uniform(-0.06, 0.06, (5000, 3)) - origins)
    found = tracer.first_hits(origins, directions)
    distance, _ = crossings(vertices, faces, origins, directions)
    first = distance.argmin(axis=1)
    hit = np.isfinite(distance.min(axis=1))
    assert 3000 < hit.sum() < 4900
    # Not one in 300,000 passed a border so near that single precision took it for its neighbour.
    np.testing.assert_array_equal(found.faces, np.where(hit, first, -1))
    np.testing.assert_array_equal(tracer.met(origins, directions), hit)
    assert (found.weights[~hit] == 0).all()
    assert_on_the_rays(tracer, found, origins, directions)


def test_occlusion_is_that_of_brute_force_at_any_distance(rng: np.random.Generator) -> None:
    vertices, faces = lumps()
    tracer = RayTracer(vertices, faces)
    face = rng.integers(0, len(faces), 5000)
    weights = rng.dirichlet([1, 1, 1], 5000)
    positions = np.einsum("nk,nkc->nc", weights, vertices[faces[face]])
    facets = facets_of(vertices, faces)[face]
    directions = unit(rng.normal(size=(5000, 3)))
    reach = rng.uniform(0.001, 0.03, 5000)
    distance, _ = crossings(vertices, faces, positions + 1e-4 * tracer.size * facets, directions)
    first = distance.min(axis=1)
    below = (directions * facets).sum(axis=1) <= 0
    met = tracer.occluded(positions, facets, directions)
    np.testing.assert_array_equal(met, below | np.isfinite(first))
    assert (met & ~below).sum() > 200
    within = tracer.occluded(positions, facets, directions, reach)
    np.testing.assert_array_equal(within, below | (first < reach))
    assert (met & ~within).sum() > 50
    endless = tracer.occluded(positions, facets, directions, np.full(5000, np.inf))
    np.testing.assert_array_equal(endless, met)


def test_single_precision_directions_are_taken_as_they_are(rng: np.random.Generator) -> None:
    vertices, faces = lumps()
    tracer = RayTracer(vertices, faces)
    face = rng.integers(0, len(faces), 3000)
    positions, facets = vertices[faces[face]].mean(axis=1), facets_of(vertices, faces)[face]
    directions = unit(rng.normal(size=(3000, 3))).astype(np.float32)
    np.testing.assert_array_equal(
        tracer.occluded(positions, facets.astype(np.float32), directions),
        tracer.occluded(positions, facets, directions.astype(float)),
    )


def test_a_convex_body_never_shadows_itself_above_its_facets(rng: np.random.Generator) -> None:
    ball = trimesh.creation.icosphere(subdivisions=5)
    tracer = RayTracer(ball.vertices, ball.faces)
    facets = facets_of(ball.vertices, ball.faces)
    face = rng.integers(0, len(facets), 200_000)
    # As often on edges and corners as within; half of the directions graze the facet.
    weights = rng.dirichlet([0.05, 0.05, 0.05], len(face))
    positions = np.einsum("nk,nkc->nc", weights, ball.vertices[ball.faces[face]])
    along = unit(np.cross(facets[face], rng.normal(size=(len(face), 3))))
    up = np.where(
        rng.random(len(face)) < 0.5, 10.0 ** rng.uniform(-6, 0, len(face)), rng.uniform(0, 9, len(face))
    )
    assert not tracer.occluded(positions, facets[face], unit(along + up[:, None] * facets[face])).any()


def test_an_overhead_sphere_takes_its_share_of_the_sky() -> None:
    # (r / d)^2 of the cosine-weighted sky, from a floor that is far wider than the sphere is high.
    radius, distance = 0.3, 0.8
    ball = trimesh.creation.icosphere(subdivisions=5, radius=radius)
    floor = np.array([[-5, -5, 0], [5, -5, 0], [0, 7, 0]], float)
    vertices = np.concatenate([floor, ball.vertices + np.array([0, 0, distance])])
    tracer = RayTracer(vertices, np.concatenate([[[0, 1, 2]], ball.faces + 3]))
    # Midpoints of squares of equal cosine-weighted solid angle: sin^2(theta) and phi.
    sin2, phi = (
        a.ravel() for a in np.meshgrid((np.arange(400) + 0.5) / 400, 2 * np.pi * (np.arange(400) + 0.5) / 400)
    )
    across = np.sqrt(sin2)
    directions = np.column_stack([across * np.cos(phi), across * np.sin(phi), np.sqrt(1 - sin2)])
    up = np.broadcast_to([0.0, 0.0, 1.0], directions.shape)
    share = tracer.occluded(np.zeros_like(directions), up, directions).mean()
    # The rays begin 1e-3 (1e-4 of 10 m) above the floor: 2.5e-3 of the distance squared; the grid adds 1/800.
    assert share == pytest.approx((radius / (distance - 1e-3)) ** 2, abs=1.3e-3)


@pytest.mark.parametrize(("scale", "shift"), [(1, 0), (1, 50), (1e-5, 0), (1e5, 0), (1e-5, 5e-4), (1e5, 5e6)])
def test_neither_place_nor_size_of_the_mesh_matters(
    rng: np.random.Generator, scale: float, shift: float
) -> None:
    vertices, faces = lumps()
    move = shift * unit(np.array([3.0, -1.0, 2.0]))
    tracer, moved = RayTracer(vertices, faces), RayTracer(scale * vertices + move, faces)
    face = rng.integers(0, len(faces), 20_000)
    facets = facets_of(vertices, faces)[face]
    positions = np.einsum("nk,nkc->nc", rng.dirichlet([1, 1, 1], len(face)), vertices[faces[face]])
    directions = unit(rng.normal(size=(len(face), 3)))
    np.testing.assert_array_equal(
        tracer.occluded(positions, facets, directions),
        moved.occluded(scale * positions + move, facets, directions),
    )
    origins = positions + 0.2 * directions
    here, there = (
        t.first_hits(o, -directions) for t, o in ((tracer, origins), (moved, scale * origins + move))
    )
    # Where single precision names the neighbour, both are within it of the border.
    assert (here.faces != there.faces).mean() < 1e-4
    assert_on_the_rays(moved, there, scale * origins + move, -directions)


def test_origins_a_million_sizes_away_lose_no_digits(rng: np.random.Generator) -> None:
    vertices, faces = lumps()
    tracer = RayTracer(vertices, faces)
    targets = rng.uniform(-0.02, 0.02, (2000, 3))
    directions = np.broadcast_to(unit(np.array([1.0, 2.0, -3.0])), targets.shape)
    near, far = (tracer.first_hits(targets - distance * directions, directions) for distance in (0.2, 1e5))
    assert (near.faces >= 0).all()
    assert (near.faces != far.faces).sum() <= 1  # single precision, at the border of two faces
    # Of 1e5 m, double precision keeps 1e-11 m.
    assert_on_the_rays(tracer, far, targets - 1e5 * directions, directions)


def test_a_common_sky_is_the_same_rays_one_by_one(rng: np.random.Generator) -> None:
    vertices, faces = lumps()
    tracer = RayTracer(vertices, faces)
    face = rng.integers(0, len(faces), 300)
    positions, facets = vertices[faces[face]].mean(axis=1), facets_of(vertices, faces)[face]
    directions = unit(rng.normal(size=(70, 3)))
    sky = tracer.occluded_sky(positions, facets, directions)
    one_by_one = tracer.occluded(
        np.repeat(positions, 70, axis=0), np.repeat(facets, 70, axis=0), np.tile(directions, (300, 1))
    )
    np.testing.assert_array_equal(sky.ravel(), one_by_one)
    assert tracer.occluded_sky(positions, facets, directions[:0]).shape == (300, 0)
    assert tracer.occluded_sky(positions[:0], facets[:0], directions).shape == (0, 70)


def test_threads_change_nothing_and_their_errors_name_the_row(rng: np.random.Generator) -> None:
    vertices, faces = lumps()
    tracer, spread = RayTracer(vertices, faces), RayTracer(vertices, faces, on_all_cores=True)
    face = rng.integers(0, len(faces), 200_000)
    positions, facets = vertices[faces[face]].mean(axis=1), facets_of(vertices, faces)[face]
    directions = unit(rng.normal(size=positions.shape))
    origins, reach = positions + 0.2 * directions, rng.uniform(0.001, 0.03, len(face))
    for field in ("faces", "weights"):
        one, other = (getattr(t.first_hits(origins, -directions), field) for t in (tracer, spread))
        np.testing.assert_array_equal(one, other)
    one, other = (t.occluded(positions, facets, directions, reach) for t in (tracer, spread))
    np.testing.assert_array_equal(one, other)
    one, other = (t.occluded_sky(positions[:3000], facets[:3000], directions[:70]) for t in (tracer, spread))
    np.testing.assert_array_equal(one, other)
    directions[150_001, 2] = np.inf
    for query in (
        lambda: spread.first_hits(origins, directions),
        lambda: spread.occluded(positions, facets, directions),
        lambda: spread.occluded_sky(positions[:3000], facets[:3000], directions[:150_002]),
    ):
        with pytest.raises(ValueError, match=r"directions\[150001\] is \[.* inf\]; all must be finite"):
            query()


def test_rays_from_the_mesh_itself_miss_where_they_begin(rng: np.random.Generator) -> None:
    vertices, faces = lumps()
    tracer = RayTracer(vertices, faces)
    face = rng.integers(0, len(faces), 5000)
    facets = facets_of(vertices, faces)[face]
    positions = vertices[faces[face]].mean(axis=1)
    directions = unit(rng.normal(size=(5000, 3)))
    directions *= np.sign((directions * facets).sum(axis=1))[:, None]
    found = tracer.first_hits(positions, directions, facets)
    np.testing.assert_array_equal(found.faces >= 0, tracer.occluded(positions, facets, directions))
    assert (found.faces != face).all()


def test_a_face_seen_edge_on_is_met_on_itself() -> None:
    # A tilted plane of many triangles, and rays within it: their crossings are quotients of rounding errors.
    steps = np.arange(30) / 29
    grid = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    turn = trimesh.transformations.rotation_matrix(0.7, [1, 2, 3])[:3, :3]
    vertices = np.column_stack([grid, np.zeros(len(grid))]) @ turn.T
    corner = (np.arange(29)[:, None] * 30 + np.arange(29)).ravel()
    faces = np.concatenate([corner[:, None] + np.array(t) for t in ([0, 1, 30], [1, 31, 30])])
    angle = np.linspace(0, 2 * np.pi, 5000)
    directions = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle]) @ turn.T
    origins = turn @ [0.5, 0.5, 0] - 2 * directions
    found = RayTracer(vertices, faces).first_hits(origins, directions)
    met = found.faces >= 0
    assert met.sum() > 100
    assert np.abs(found.weights).max() <= 1.02
    np.testing.assert_allclose(found.weights[met].sum(axis=1), 1, rtol=1e-12)  # rounding


def test_no_rays_and_a_pickled_tracer() -> None:
    vertices, faces = lumps()
    tracer = pickle.loads(pickle.dumps(RayTracer(vertices, faces)))
    none = np.zeros((0, 3))
    assert len(tracer.first_hits(none, none).faces) == len(tracer.occluded(none, none, none)) == 0
    ray = tracer.first_hits(np.array([[0.0, 0, 1]]), np.array([[0.0, 0, -1]]))
    assert places(tracer, ray)[0, 2] == pytest.approx(0.05, abs=0.02)


def test_what_embree_would_not_notice_is_an_error() -> None:
    vertices, faces = lumps()
    with pytest.raises(ValueError, match=r"faces name vertices 0 to 162; there are 0 to 161"):
        RayTracer(vertices, np.concatenate([faces, [[0, 1, 162]]]))
    with pytest.raises(ValueError, match="at least one face"):
        RayTracer(vertices, faces[:0])
    with pytest.raises(ValueError, match=r"all vertices of the mesh are at \[1.0, 1.0, 1.0\]"):
        RayTracer(np.ones((3, 3)), np.array([[0, 1, 2]]))
    with pytest.raises(ValueError, match="must be \\(v, 3\\) and finite"):
        RayTracer(np.where(vertices == vertices.max(), np.nan, vertices), faces)
    tracer = RayTracer(vertices, faces)
    up = np.broadcast_to([0.0, 0.0, 1.0], (4, 3))
    with pytest.raises(ValueError, match=r"directions are \(3, 3\); they must be \(4, 3\)"):
        tracer.first_hits(up, up[:3])
    with pytest.raises(ValueError, match=r"facets are \(4, 2\)"):
        tracer.occluded(up, up[:, :2], up)
    with pytest.raises(ValueError, match=r"normals are \(3, 3\); they must be \(4, 3\)"):
        tracer.occluded_sky(up, up[:3], up)
    broken = up.copy()
    broken[2, 1] = np.nan
    with pytest.raises(ValueError, match=r"origins\[2\] is \[ 0. nan  1.\]; all must be finite"):
        tracer.first_hits(broken, up)
    for distances in (np.array([1, 1, 0, 1.0]), np.array([1, np.nan, 1, 1]), np.ones(3)):
        with pytest.raises(ValueError, match=r"they must be \(4,\) and > 0"):
            tracer.occluded(up, up, up, distances)
