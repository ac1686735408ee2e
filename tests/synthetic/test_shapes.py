"""Implicit shapes, their meshes, and texture coordinates for meshes."""

from __future__ import annotations

import hashlib
import subprocess
import sys

import numpy as np
import pytest
from numpy.typing import NDArray

from recon.mesh.atlas import with_atlas
from recon.mesh.trianglemesh import TriangleMesh, is_watertight, volume
from synthetic.shapes.implicit import (
    Implicit,
    curled_tube,
    difference,
    ellipsoid,
    mirrored,
    round_cone,
    scaled,
    squeezed,
    union,
)
from synthetic.shapes.meshing import mesh_implicit

Floats = NDArray[np.float64]

_BALL = ellipsoid((0.1, -0.2, 0.3), (0.6, 0.6, 0.6))
_CONE = round_cone((-0.5, 0.1, 0.0), (0.6, -0.2, 0.3), 0.4, 0.15)
_TUBE = curled_tube(
    [-np.pi, -1, 0, 1, 2, np.pi],
    [0.9, 0.9, 0.8, 0.9, 1, 0.9],
    [0, 0.1, 0, 0.2, 0, 0],
    [-1, -0.2, 0.04, 0.06, 0.04, -0.5],
)
_SHAPES = {
    "ball": _BALL,
    "ellipsoid": ellipsoid((0, 0.1, 0), (0.3, 0.5, 0.9)),
    "cone": _CONE,
    "tube": _TUBE,
    "union": union(0.3, _BALL, _CONE, _TUBE),
    "difference": difference(0.2, _BALL, _CONE),
    "moved": scaled(mirrored(squeezed(_CONE, (0.1, 0, 0), 0.6)), 1.3),
}


def _differences(shape: Implicit, points: Floats, step: float) -> Floats:
    """Gradient by central differences of the values."""
    sides = [(shape(points + step * axis)[0], shape(points - step * axis)[0]) for axis in np.eye(3)]
    return np.column_stack([(high - low) / (2 * step) for high, low in sides])


@pytest.mark.parametrize("shape", _SHAPES.values(), ids=_SHAPES)
def test_gradients_are_those_of_the_values(shape: Implicit, rng: np.random.Generator) -> None:
    points = rng.uniform(-1.2, 1.2, (4000, 3))
    # Off the z axis and the half plane at which the tube's azimuth jumps, and off the medial axes.
    points = points[
        (np.hypot(points[:, 0], points[:, 1]) > 0.2) & ((points[:, 0] > 0) | (np.abs(points[:, 1]) > 0.01))
    ]
    value, gradient = shape(points)
    near = value > -0.1
    # Third derivatives below 1e4 times the step squared, and rounding over the step.
    np.testing.assert_allclose(gradient[near], _differences(shape, points[near], 1e-5), atol=1e-6)


def test_values_of_a_ball_and_a_rod_are_distances() -> None:
    away = np.array([[1.1, 0, 0], [0, 0, 0.9], [0.05, 0, 0]])
    np.testing.assert_allclose(ellipsoid((0, 0, 0), (0.6, 0.6, 0.6))(away)[0], [0.5, 0.3, -0.55], atol=1e-15)
    rod = round_cone((0, 0, 0), (1, 0, 0), 0.2, 0.2)
    # Beside its middle, and beyond its ends, where the closest point has come to rest.
    places = np.array([[0.5, 0.7, 0.0], [-0.5, 0.0, 0.0], [1.5, 0.0, 0.0]])
    np.testing.assert_allclose(rod(places)[0], [0.5, 0.3, 0.3], atol=1e-15)


def test_a_union_is_round_where_its_shapes_meet_and_untouched_elsewhere() -> None:
    left, right = ellipsoid((-0.5, 0, 0), (0.6, 0.6, 0.6)), ellipsoid((0.5, 0, 0), (0.6, 0.6, 0.6))
    step = 1e-3
    line = np.column_stack([np.arange(-0.4, 0.4, step), np.full(800, 0.4), np.zeros(800)])
    value, gradient = union(0.3, left, right)(line)
    # A kink in the normals shows as a second difference of the gradient as large as the step, not its square.
    assert (
        np.abs(np.diff(gradient, 2, axis=0)).max() < 200 * step**2
    )  # third derivatives are up to 1 / 0.3^2 * 4
    far = np.abs(left(line)[0] - right(line)[0]) > 0.3
    np.testing.assert_array_equal(value[far], np.minimum(left(line)[0], right(line)[0])[far])
    assert far.any()
    assert (value[~far] < np.minimum(left(line)[0], right(line)[0])[~far]).all()


def test_the_mesh_of_a_ball_is_exact_at_vertices_and_second_order_between() -> None:
    centre, errors = np.array([0.003, -0.002, 0.001]), []
    for edge in (0.004, 0.002):
        mesh = mesh_implicit(ellipsoid(centre, (0.05, 0.05, 0.05)), 0.06, edge)
        offset = mesh.vertices - centre
        np.testing.assert_allclose(np.linalg.norm(offset, axis=1), 0.05, atol=1e-15)  # rounding
        np.testing.assert_allclose(mesh.normals, offset / 0.05, atol=1e-13)  # rounding over 0.05
        assert is_watertight(mesh)
        errors.append(4 / 3 * np.pi * 0.05**3 - volume(mesh))
    assert errors[1] > 0
    # A polyhedron inscribed in a ball lacks volume as the square of its edges; faces vary from grid to grid.
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.05)


def test_a_drilled_ball_has_the_topology_of_a_ring() -> None:
    drill = round_cone((0, 0, -1), (0, 0, 1), 0.015, 0.015)
    mesh = mesh_implicit(difference(0.01, ellipsoid((0, 0, 0), (0.05, 0.05, 0.05)), drill), 0.06, 0.003)
    assert is_watertight(mesh)
    assert len(mesh.vertices) - len(mesh.faces) // 2 == 0


def test_what_cannot_be_meshed_is_refused() -> None:
    ball = ellipsoid((0, 0, 0), (0.02, 0.02, 0.02))
    with pytest.raises(ValueError, match=r"edge is 0.03 m; it must be > 0 and < 0.0175 m"):
        mesh_implicit(ball, 0.07, 0.03)
    with pytest.raises(ValueError, match=r"goes 0.08 m from the origin, beyond its reach of 0.07 m"):
        mesh_implicit(ellipsoid((0, 0, 0), (0.08, 0.02, 0.02)), 0.07, 0.004)
    with pytest.raises(ValueError, match=r"the surface has 2 pieces at a resolution of 0.002 m"):
        mesh_implicit(union(0.001, ball, ellipsoid((0.05, 0, 0), (0.01, 0.01, 0.01))), 0.07, 0.002)
    with pytest.raises(ValueError, match=r"no surface lies within 0.07 m"):
        mesh_implicit(ellipsoid((0.5, 0, 0), (0.02, 0.02, 0.02)), 0.07, 0.004)
    blade = ellipsoid((0, 0, 0), (0.05, 0.05, 0.0012))
    with pytest.raises(
        ValueError, match=r"turns too sharply for a resolution of 0.004 m at \d+ of \d+ faces"
    ):
        mesh_implicit(blade, 0.07, 0.004)


def _bean() -> TriangleMesh:
    return mesh_implicit(scaled(union(0.3, _BALL, _CONE), 0.05), 0.06, 0.004)


def test_an_atlas_overlaps_nowhere_and_leaves_the_surface_as_it_is(rng: np.random.Generator) -> None:
    mesh = _bean()
    unwrapped = with_atlas(mesh)
    assert is_watertight(unwrapped)
    for before, after in ((mesh.vertices, unwrapped.vertices), (mesh.normals, unwrapped.normals)):
        np.testing.assert_array_equal(after[unwrapped.faces], before[mesh.faces])
    assert unwrapped.uv is not None
    assert (unwrapped.uv.min() >= 0) & (unwrapped.uv.max() <= 1)
    a, b, c = (unwrapped.uv[unwrapped.faces[:, corner]] for corner in range(3))
    points = rng.uniform(size=(4000, 2))
    # On which side of its edges points lie; the cross product of an edge and the way to a point is affine in the point.
    sides = np.stack(
        [
            points @ np.stack([p - q, q - p])[[0, 1], :, [1, 0]] + _cross(p, q - p)
            for p, q in ((a, b), (b, c), (c, a))
        ]
    )
    covered = ((sides > 0).all(axis=0) | (sides < 0).all(axis=0)).sum(axis=1)
    assert covered.max() == 1
    share = np.abs(_cross(b - a, c - a)).sum() / 2
    assert share > 0.4
    assert covered.mean() == pytest.approx(share, abs=0.025)  # 3 standard errors of 4000 points


def _cross(a: Floats, b: Floats) -> Floats:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def _fingerprint() -> str:
    mesh = with_atlas(_bean())
    assert mesh.uv is not None
    return hashlib.sha256(mesh.vertices.tobytes() + mesh.faces.tobytes() + mesh.uv.tobytes()).hexdigest()


def test_mesh_and_atlas_are_the_same_in_another_process() -> None:
    code = f"import runpy; print(runpy.run_path({__file__!r})['_fingerprint']())"
    other = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert other.stdout.strip() == _fingerprint()


def test_without_xatlas_it_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = _bean()
    monkeypatch.setitem(sys.modules, "xatlas", None)
    with pytest.raises(ValueError, match="pip install xatlas"):
        with_atlas(mesh)
