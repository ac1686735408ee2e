"""The turned doll: its surface against integrals of its profile, its mesh, and its paint."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad

from recon.mesh.trianglemesh import area_vectors, is_watertight, volume
from synthetic.shapes.doll import CROWN, FOOT, REACH, SQUARED_RADIUS, contains, doll_mesh, doll_points, radii
from synthetic.shapes.dollpaint import doll_textures


def test_the_mesh_tends_to_the_volume_and_area_of_the_turned_profile() -> None:
    # Discs of radius r, and hoops of r sqrt(1 + r'^2) = sqrt(s + s'^2 / 4) with s = r^2.
    true_volume = np.pi * SQUARED_RADIUS.integrate(FOOT, CROWN)
    knots = SQUARED_RADIUS.x
    true_area = sum(
        quad(lambda z: 2 * np.pi * np.sqrt(SQUARED_RADIUS(z) + SQUARED_RADIUS(z, 1) ** 2 / 4), low, high)[0]
        for low, high in pairwise(knots)
    )
    errors = []
    for edge in (0.002, 0.001):
        mesh = doll_mesh(edge)
        area = np.linalg.norm(area_vectors(mesh.vertices, mesh.faces), axis=1).sum()
        errors.append([true_volume - volume(mesh), true_area - area])
    relative = np.array(errors) / [true_volume, true_area]
    assert (relative[1] < 1e-3).all()  # (edge / radius)^2 / 6 to 24
    np.testing.assert_allclose(relative[0] / relative[1], 4, rtol=0.1)  # second order; rows are rounded up


def test_the_mesh_is_closed_unfolded_and_without_slivers_of_no_area() -> None:
    mesh = doll_mesh(0.002)
    assert is_watertight(mesh)
    facets = area_vectors(mesh.vertices, mesh.faces)
    assert (np.einsum("fi,fci->fc", facets, mesh.normals[mesh.faces]) > 0).all()
    # The thinnest lie around foot and crown: as long as the edge, wide as a part of a ring of that radius.
    columns = np.ceil(2 * np.pi * radii(np.linspace(FOOT, CROWN, 10_000)).max() / 0.002)
    assert np.linalg.norm(facets, axis=1).min() > 0.5 * 0.002**2 * np.pi / columns
    assert np.linalg.norm(mesh.vertices, axis=1).max() < REACH
    with pytest.raises(ValueError, match=r"edge is 0 m; it must be > 0 and at most 0.0175 m"):
        doll_mesh(0)


def test_texture_coordinates_cover_the_square_once() -> None:
    mesh = doll_mesh(0.003)
    assert mesh.uv is not None
    a, b, c = (mesh.uv[mesh.faces[:, corner]] for corner in range(3))
    areas = ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) / 2
    # None is turned over: u runs to the right seen from outside. Only half of the first and last row is covered.
    assert areas.min() > 0
    rows = len(np.unique(mesh.uv[:, 1])) - 1
    assert areas.sum() == pytest.approx(1 - 1 / rows, rel=1e-12)


def test_normals_and_tangents_are_those_of_the_surface(rng: np.random.Generator) -> None:
    uv = rng.uniform(0.02, 0.98, (500, 2))
    points = doll_points(uv)
    # A table of 16,000 heights is linear in v between them; steps much longer than those.
    step = 2e-3
    u, v = step * np.eye(2)
    along_u = doll_points(uv + u).positions - doll_points(uv - u).positions
    along_v = doll_points(uv + v).positions - doll_points(uv - v).positions
    normals = np.cross(along_u, along_v)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    assert (normals * points.normals).sum(axis=1).min() > 0.999  # 0.7 mm of profile at bends of 2 mm radius
    np.testing.assert_allclose(
        points.tangents, along_u / np.linalg.norm(along_u, axis=1, keepdims=True), atol=1e-12
    )  # a chord is parallel to the tangent at its middle
    assert np.abs((points.tangents * points.normals).sum(axis=1)).max() < 1e-15
    # The profile's length is even in v: about 16.4 cm in all.
    lengths = np.linalg.norm(along_v, axis=1) / (2 * step)
    assert np.median(lengths) == pytest.approx(lengths.max(), rel=1e-3)


def test_contains_changes_at_the_surface(rng: np.random.Generator) -> None:
    points = doll_points(rng.uniform(0, 1, (2000, 2)))
    assert contains(points.positions - 1e-7 * points.normals).all()
    assert not contains(points.positions + 1e-7 * points.normals).any()
    assert not contains(np.array([[0, 0, CROWN + 1e-6], [0, 0, FOOT - 1e-6], [0, 0, 1.0]])).any()


def test_textures_are_reflectances_and_the_picture_is_the_right_way_up() -> None:
    kd, ks = doll_textures(256)
    assert kd.shape == ks.shape == (256, 256, 3)
    assert kd.dtype == ks.dtype == np.float32
    albedo = np.pi * kd
    assert 0 < albedo.min() < albedo.max() <= 0.8 + 1e-6
    assert 0.005 <= ks.min() < ks.max() <= 0.06 + 1e-6
    # Black hair above, bare wood below; red lips in the middle of a pale face, under dark eyes.
    assert albedo[2].max() < 0.05
    assert (albedo[-2] > 0.08).all()
    middle = albedo[:, 127]
    lips = np.flatnonzero((middle[:, 0] > 4 * middle[:, 1]) & (np.arange(256) < 100))
    eyes = np.flatnonzero(albedo[: lips[0], 115].max(axis=1) < 0.1)
    assert len(lips) > 2
    assert 3 < lips[0] - eyes[-1] < 30
    assert albedo[lips[0] - 4, 127].min() > 0.3


def test_textures_have_no_seam_and_do_not_depend_on_the_resolution() -> None:
    (kd, ks), (fine, _) = doll_textures(256), doll_textures(512)
    again = doll_textures(256)
    np.testing.assert_array_equal(kd, again[0])
    np.testing.assert_array_equal(ks, again[1])
    # A blossom lies across the seam: cut off there, it would show as a jump in a dozen rows.
    jumps = np.abs(kd[:, 0] - kd[:, -1]).max(axis=1) > 0.05
    assert jumps.sum() < 6
    means = fine.reshape(256, 2, 256, 2, 3).mean(axis=(1, 3))
    assert np.abs(means - kd).mean() < 0.02 * kd.mean()  # what differs lies on painted edges and grain
    with pytest.raises(ValueError, match="height is 0"):
        doll_textures(0)
