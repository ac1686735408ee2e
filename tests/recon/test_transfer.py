"""Transfer vectors against bodies whose shadows are known, and against every triangle in turn."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from numpy.polynomial import Legendre
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from recon.harmonics.basis import evaluate_harmonics, sphere_directions
from recon.harmonics.rotations import rotated_harmonics
from recon.mesh.transfer import TransferVectors, transfer_vectors
from recon.mesh.trianglemesh import TriangleMesh, area_vectors, smooth_normals

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

L_MAX = 8
# Coefficients are held in single precision; they and the harmonics are of the order of 1.
SINGLE = 1e-6


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(12)


def smooth(vertices: Floats, faces: Ints) -> TriangleMesh:
    return TriangleMesh(vertices, faces, smooth_normals(vertices, faces))


def lumps() -> TriangleMesh:
    """A star-shaped body with hollows, 1280 faces, about 0.1 m."""
    ball = trimesh.creation.icosphere(subdivisions=3)
    x, y, z = ball.vertices.T
    swelling = 1 + 0.35 * np.sin(4 * x) * np.sin(5 * y + 1) * np.sin(3 * z + 2)
    return smooth(0.05 * swelling[:, None] * np.asarray(ball.vertices), ball.faces)


def clear(normals: Floats) -> Floats:
    """Transfer A_l Y_lm(n) without shadows."""
    return cap(normals, -0.0)


def cap(normals: Floats, cos: float) -> Floats:
    """Transfer from the cap about the normals down to this cosine: by Funk and Hecke 2 pi int x P_l(x) dx Y_lm(n)."""
    factors = []
    for degree in range(L_MAX + 1):
        integral = (Legendre([0, 1]) * Legendre.basis(degree)).integ()
        factors += (2 * degree + 1) * [2 * np.pi * (integral(1) - integral(cos))]
    return np.array(factors) * evaluate_harmonics(normals, L_MAX)


def rms(values: Floats) -> float:
    return float(np.sqrt((values**2).mean()))


def convex_bodies() -> dict[str, TriangleMesh]:
    ball = trimesh.creation.icosphere(subdivisions=4)
    stretched = np.asarray(ball.vertices) * [1.0, 0.3, 0.05]
    box = trimesh.creation.box((0.2, 0.3, 0.4)).subdivide().subdivide()
    vertices, faces = np.asarray(box.vertices), np.asarray(box.faces)
    facets = area_vectors(vertices, faces)
    sharp = np.repeat(facets / np.linalg.norm(facets, axis=1, keepdims=True), 3, axis=0)
    return {
        "sphere": TriangleMesh(ball.vertices, ball.faces, np.asarray(ball.vertices)),
        "ellipsoid": smooth(stretched, ball.faces),
        "box with smooth normals": smooth(vertices, faces),
        "box with sharp normals": TriangleMesh(
            vertices[faces.ravel()], np.arange(faces.size).reshape(-1, 3), sharp
        ),
    }


@pytest.mark.parametrize("name", list(convex_bodies()))
def test_a_convex_body_has_the_clamped_cosines_coefficients(name: str) -> None:
    # Rays leave below the facets of its coarse faces, and pass by.
    mesh = convex_bodies()[name]
    vectors = transfer_vectors(mesh, L_MAX)
    np.testing.assert_allclose(
        vectors.coefficients, clear(mesh.normals), rtol=0, atol=SINGLE, equal_nan=False
    )
    assert not vectors.std.any()


def test_the_published_transfer_of_the_clamped_cosine() -> None:
    mesh = convex_bodies()["box with sharp normals"]
    up = int(np.flatnonzero(mesh.normals[:, 2] > 0.5)[0])
    zonal = [degree * (degree + 1) for degree in range(5)]
    at_pole = evaluate_harmonics([[0, 0, 1]], 4)[0, zonal]
    # RH01, eq. 15 and 16.
    published = np.array([np.pi, 2 * np.pi / 3, np.pi / 4, 0, -np.pi / 24])
    found = transfer_vectors(mesh, 4).coefficients[up, zonal]
    np.testing.assert_allclose(found, published * at_pole, rtol=0, atol=SINGLE)


def test_an_overhead_sphere_takes_its_share_of_the_sky() -> None:
    radius, distance = 0.3, 0.8
    ball = trimesh.creation.icosphere(subdivisions=3, radius=radius)
    floor = np.array([[0, 0, 0], [0.3, 0, 0], [0, 0.3, 0]])
    vertices = np.concatenate([floor, ball.vertices + np.array([0, 0, distance])])
    faces = np.concatenate([[[0, 1, 2]], ball.faces + 3])
    turn = Rotation.from_euler("zyx", [0.3, 1.1, -2]).as_matrix()
    mesh = smooth(vertices @ turn.T, faces)
    vectors = transfer_vectors(mesh, L_MAX, 8192)
    # Rays begin 1e-4 of 1.1 m above the floor.
    sine = radius / (distance - 1.1e-4)
    up = mesh.normals[:1]
    expected = clear(up) - cap(up, np.sqrt(1 - sine**2))
    assert 0 < vectors.std[0] < 1e-3
    assert rms(vectors.coefficients[0] - expected[0]) < 4 * vectors.std[0]
    # Under a white sky only the first counts: (r / d)^2 of the cosine-weighted sky is gone.
    white = vectors.coefficients[0, 0] * np.sqrt(4 * np.pi) / np.pi
    # Sixty draws of directions scatter by 7e-4; the sphere's facets take 8e-4 less.
    assert white == pytest.approx(1 - sine**2 + 8e-4, abs=2.5e-3)


def test_a_valley_sees_what_its_walls_leave() -> None:
    # Two walls at right angles, and a vertex on the line where they meet, its normal between theirs.
    wall = np.array([[-5, 0, 0], [0, 0, 0], [5, 0, 0], [-5, 5, 0], [0, 5, 0], [5, 5, 0]], float)
    other = wall[3:, [0, 2, 1]]
    vertices = np.concatenate([wall, other])
    floor = np.array([[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4]])
    upright = np.array([[0, 7, 1], [0, 6, 7], [1, 8, 2], [1, 7, 8]])
    mesh = smooth(vertices, np.concatenate([floor, upright]))
    np.testing.assert_allclose(mesh.normals[1], [0, np.sqrt(0.5), np.sqrt(0.5)], atol=1e-12)  # rounding
    vectors = transfer_vectors(mesh, L_MAX, 4096)
    # Between planes at +-a to the normal, cos(theta) integrates to pi sin(a); 4096 rays are good to 1e-3 of pi.
    white = vectors.coefficients[1, 0] * np.sqrt(4 * np.pi)
    assert white == pytest.approx(np.pi * np.sin(np.pi / 4), abs=3e-3)
    # Turned inside out it is a ridge, which sees everything.
    ridge = TriangleMesh(vertices, mesh.faces[:, ::-1], -mesh.normals)
    np.testing.assert_allclose(
        transfer_vectors(ridge, L_MAX).coefficients, clear(ridge.normals), rtol=0, atol=SINGLE
    )


def test_the_back_of_an_open_mesh_occludes() -> None:
    # A disc above a floor, both facing up: it takes R^2 / (R^2 + h^2) of the cosine-weighted sky below its middle.
    radius, height = 0.5, 0.4
    angle = 2 * np.pi * np.arange(200) / 200
    rim = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.full(200, height)])
    floor = np.array([[0, 0, 0], [0.3, 0, 0], [0, 0.3, 0]])
    vertices = np.concatenate([floor, [[0, 0, height]], rim])
    fan = np.column_stack([np.full(200, 3), 4 + np.arange(200), 4 + (np.arange(200) + 1) % 200])
    mesh = smooth(vertices, np.concatenate([[[0, 1, 2]], fan]))
    vectors = transfer_vectors(mesh, 0, 8192)
    white = vectors.coefficients[:, 0] * np.sqrt(4 * np.pi) / np.pi
    # The border of the disc crosses some 250 of 16384 cells; rays begin 1e-4 m above the floor.
    assert white[0] == pytest.approx(height**2 / (radius**2 + height**2), abs=1.5e-3)
    assert white[3] == pytest.approx(1, abs=SINGLE)


def test_transfer_is_that_of_brute_force(rng: np.random.Generator) -> None:
    mesh = lumps()
    some = rng.choice(len(mesh.vertices), 15, replace=False)
    a, b, c = (mesh.vertices[corner] for corner in mesh.faces.T)
    normals = mesh.normals[some]
    origins = mesh.vertices[some] + 1e-4 * np.ptp(mesh.vertices, axis=0).max() * normals
    directions = sphere_directions(4096)
    # Every ray against every triangle: which side of the planes through the origin and each edge it passes.
    expected = clear(normals)
    for row, (origin, normal) in enumerate(zip(origins, normals, strict=True)):
        above = directions[directions @ normal > 0]
        corners = [corner - origin for corner in (a, b, c)]
        sides = np.stack(
            [
                above @ np.cross(one, other).T
                for one, other in zip(corners, np.roll(corners, -1, 0), strict=True)
            ]
        )
        facing = above @ np.cross(b - a, c - a).T
        ahead = facing * np.einsum("fc,fc->f", corners[0], np.cross(b - a, c - a)) > 0
        met = ((sides > 0).all(axis=0) | (sides < 0).all(axis=0)) & ahead
        hidden = above[met.any(axis=1)]
        weights = 4 * np.pi / len(directions) * (hidden @ normal)
        expected[row] -= weights @ evaluate_harmonics(hidden, L_MAX)
    vectors = transfer_vectors(mesh, L_MAX, 4096)
    found, std = vectors.coefficients[some], vectors.std[some]
    assert (rms(clear(normals) - expected)) > 0.01
    # The brute force has half as many directions, hence 2^0.75 times the error.
    assert rms(found - expected) < 1.3 * np.hypot(1, 2**0.75) * rms(std)


def test_the_stated_error_is_the_error() -> None:
    mesh = lumps()
    truth = transfer_vectors(mesh, L_MAX, 4096)
    for rays in (64, 256):
        vectors = transfer_vectors(mesh, L_MAX, rays)
        error = np.sqrt(((vectors.coefficients - truth.coefficients) ** 2).mean(axis=1))
        # 642 vertices share 32 turns of the directions and are alike: the sample's own scatter is some 10%.
        assert rms(error) == pytest.approx(rms(vectors.std), rel=0.2)
        assert (error < 4 * vectors.std + 0.3 * rms(vectors.std)).mean() > 0.95


@pytest.mark.parametrize(("scale", "shift"), [(1e-5, 0.0), (1, 50.0), (1e5, 5e6)])
def test_neither_place_nor_size_of_the_mesh_matters(scale: float, shift: float) -> None:
    mesh = lumps()
    moved = TriangleMesh(scale * mesh.vertices + shift, mesh.faces, mesh.normals)
    here, there = transfer_vectors(mesh, L_MAX), transfer_vectors(moved, L_MAX)
    # Some of 164,000 rays pass a border within rounding, each worth 4 pi / 512.
    assert (np.abs(here.coefficients - there.coefficients).max(axis=1) > SINGLE).mean() < 0.01
    assert np.abs(here.coefficients - there.coefficients).max() < 4 * np.pi / 256


def test_a_turned_mesh_has_the_turned_transfer(rng: np.random.Generator) -> None:
    turn = Rotation.from_euler("zyx", [0.7, -1.9, 2.5]).as_matrix()
    normals = sphere_directions(50)
    np.testing.assert_allclose(rotated_harmonics(clear(normals), turn), clear(normals @ turn.T), atol=1e-13)
    random = rng.normal(size=(4, 81))
    np.testing.assert_allclose(
        np.linalg.norm(rotated_harmonics(random, turn), axis=1), np.linalg.norm(random, axis=1), rtol=1e-13
    )
    mesh = lumps()
    turned = TriangleMesh(mesh.vertices @ turn.T, mesh.faces, mesh.normals @ turn.T)
    one, other = transfer_vectors(mesh, L_MAX).rotated(turn), transfer_vectors(turned, L_MAX)
    # Other rays on the same mesh: independent errors.
    apart = rms(one.coefficients - other.coefficients)
    assert apart == pytest.approx(np.hypot(rms(one.std), rms(other.std)), rel=0.2)
    np.testing.assert_array_equal(one.std, transfer_vectors(mesh, L_MAX).std)


def test_what_has_no_area_or_no_face_disturbs_nothing() -> None:
    mesh = lumps()
    plain = transfer_vectors(mesh, L_MAX)
    extra = np.array([[0, 0, 0.02], [7e3, 0, 0]])
    count = len(mesh.vertices)
    with_more = TriangleMesh(
        np.concatenate([mesh.vertices, extra]),
        np.concatenate([mesh.faces, [[0, 0, 1], [5, 5, 5]]]),
        np.concatenate([mesh.normals, [[0, 0, 1.0], [1, 0, 0]]]),
    )
    found = transfer_vectors(with_more, L_MAX)
    np.testing.assert_array_equal(found.coefficients[:count], plain.coefficients)
    # One lies within, in the dark (its sky is known as well as rays meet it); the other out of everything's way.
    assert np.abs(found.coefficients[count]).max() < 1e-2
    np.testing.assert_allclose(found.coefficients[count + 1], clear(extra[1:] / 7e3)[0], atol=SINGLE)


def test_settings_that_make_no_sense_are_errors() -> None:
    mesh = convex_bodies()["sphere"]
    with pytest.raises(ValueError, match="l_max is -1"):
        transfer_vectors(mesh, -1)
    with pytest.raises(ValueError, match="rays is 1; there must be at least 2"):
        transfer_vectors(mesh, 2, 1)
    with pytest.raises(ValueError, match=r"coefficients are \(5, 8\) and std \(5,\)"):
        TransferVectors(np.zeros((5, 8), np.float32), np.zeros(5, np.float32))
