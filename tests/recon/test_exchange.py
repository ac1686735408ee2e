"""What parts of a mesh send each other, against form factors that are known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose

from recon.mesh.bodies import MeshBody
from recon.mesh.exchange import face_exchange
from recon.mesh.trianglemesh import TriangleMesh, area_vectors

from .bodymeshes import ball_mesh, joined, plate


def all_of(body: MeshBody) -> np.ndarray:
    return np.ones(len(body.mesh.vertices), bool)


def test_a_wall_lights_a_floor_as_the_cosine_law_says() -> None:
    wall = plate((0, -60, 0), (0, 120, 0), (0, 0, 1))  # 1 high, faces +x
    # Bits of floor at distances from the wall's foot, too small to stand in each other's way.
    distances = np.array([0.3, 1.0, 2.5])
    bits = [plate((d, 0, 0), (1e-3, 0, 0), (0, 1e-3, 0)) for d in distances]
    body = MeshBody(joined(wall, *bits))
    exchange = face_exchange(body, all_of(body), 4000)
    found = exchange[4::4, :2].sum(axis=1)
    # A strip without end, perpendicular to an element: half of 1 less the cosine to its upper edge. Rays begin 0.012
    # above the floor; the strip's ends beyond 60 would add 1e-4.
    assert_allclose(found, np.pi / 2 * (1 - distances / np.hypot(distances, 1)), atol=0.012 * np.pi / 2)
    # The wall's lower corners see the bits' front, but nothing is seen from below the floor's bits.
    assert exchange[4:, 2:].nnz == 0


def test_every_point_of_a_bowl_sees_as_much_of_it() -> None:
    bowl = hemisphere()
    body = MeshBody(bowl)
    exchange = face_exchange(body, all_of(body), 256)
    assert exchange.dtype == np.float32
    # Within a sphere each part counts by its area from everywhere; the rim is jagged, so this is less than half of it.
    inside = bowl.vertices[:, 2] < -0.1
    share = np.linalg.norm(area_vectors(bowl.vertices, bowl.faces), axis=1).sum() / (4 * np.pi)
    found = exchange.sum(axis=1)[inside] / np.pi
    # 0.006 RMS is what 256 rays leave (0.03 if they were drawn at random), and 1e-3 the facets' not being round.
    assert_allclose(found, share, atol=0.03)
    assert found.mean() == pytest.approx(share, abs=0.002)
    # Turned inside out it is a dome seen from outside, and sees nothing of itself.
    dome = MeshBody(TriangleMesh(bowl.vertices, bowl.faces[:, ::-1], -bowl.normals))
    assert face_exchange(dome, all_of(dome), 64).nnz == 0


def test_a_convex_body_sends_itself_nothing() -> None:
    for mesh in (ball_mesh((0, 0, 0), 1, 3), ball_mesh((0.4, 0, 5), 0.1, 2)):
        body = MeshBody(mesh)
        assert face_exchange(body, all_of(body), 128).nnz == 0


def test_only_what_is_asked_for_is_traced() -> None:
    body = MeshBody(hemisphere())
    asked = all_of(body)
    asked[::2] = False
    exchange = face_exchange(body, asked, 32)
    assert_allclose(np.diff(exchange.indptr)[::2], 0)
    assert exchange[1::2].nnz > 0
    with pytest.raises(ValueError, match="rays is 0"):
        face_exchange(body, asked, 0)


def hemisphere() -> TriangleMesh:
    """The lower half of a unit sphere, whose outside is its hollow."""
    ball = trimesh.creation.icosphere(subdivisions=4)
    faces = ball.faces[(ball.vertices[ball.faces, 2] <= 1e-9).all(axis=1)][:, ::-1]
    used, new = np.unique(faces, return_inverse=True)
    vertices = ball.vertices[used]
    return TriangleMesh(vertices, new.reshape(-1, 3), -vertices)
