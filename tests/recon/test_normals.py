"""Normal maps and the surfaces that have them, against spheres and planes whose depth is known exactly."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from capture.camera import Camera
from capture.files.imagefile import write_exr
from recon.mesh.trianglemesh import read_mesh
from recon.normals.integration import integrate, slope_errors, surface_mesh
from recon.normals.normalmap import NormalMap, picture_axes, read_normal_map, write_normal_map

Floats = NDArray[np.float64]
SIDE, RADIUS, DISTANCE = 120, 0.02, 0.3


def poses() -> Floats:
    """A camera that looks along the world's -x, its picture upright along z."""
    rotation = np.array([[0.0, 1, 0], [0, 0, -1], [-1, 0, 0]])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, [0, 0, DISTANCE]
    return pose


def cameras() -> tuple[Camera, Camera]:
    """An orthographic and a perspective camera before a sphere of 2 cm at the world's origin."""
    scale = 0.42 * SIDE / RADIUS
    orthographic = Camera("ORTHOGRAPHIC", np.array([scale, SIDE / 2, SIDE / 2]), SIDE, SIDE, poses())
    # 12 cm in front of the sphere, where perspective turns the views by ten degrees.
    near = poses()
    near[2, 3] = 0.12
    pinhole = Camera("SIMPLE_PINHOLE", np.array([scale * 0.12, SIDE / 2, SIDE / 2]), SIDE, SIDE, near)
    return orthographic, pinhole


def sphere_seen(camera: Camera, least: float) -> tuple[NormalMap, Floats]:
    """The normals of the sphere as a camera sees it, and its depths (h, w), by where rays meet it.

    least : cosine to the view above which it counts.
    """
    rows, columns = np.indices((SIDE, SIDE)).reshape(2, -1)
    origins, directions = camera.rays(np.column_stack([columns, rows]) + 0.5)
    along = np.einsum("pk,pk->p", origins, directions)
    inside = along**2 - (origins**2).sum(axis=1) + RADIUS**2
    points = origins + (-along - np.sqrt(np.maximum(inside, 0)))[:, None] * directions
    normals = points / RADIUS
    seen = (inside > 0) & (np.einsum("pk,pk->p", normals, -directions) > least)
    found = np.where(seen[:, None], normals @ picture_axes(camera).T, np.nan)
    depths = np.where(seen, camera.depth(points), np.nan)
    return NormalMap(found.reshape(SIDE, SIDE, 3)), depths.reshape(SIDE, SIDE)


@pytest.mark.parametrize("which", [0, 1], ids=["orthographic", "perspective"])
def test_a_spheres_normals_integrate_to_the_sphere(which: int) -> None:
    camera = cameras()[which]
    found, truth = sphere_seen(camera, 0.2)
    depths = integrate(found, camera, float(np.nanmean(truth)))
    # A pixel is a hundredth of the radius; slopes of the outermost change by a third from one to the next.
    assert np.nanstd(depths - truth) < 0.003 * RADIUS
    mesh = surface_mesh(found, camera, depths)
    # In the world, about its origin, where the sphere is.
    assert np.abs(np.linalg.norm(mesh.vertices, axis=1) - RADIUS).max() < 0.02 * RADIUS
    assert slope_errors(found, camera, depths) < 0.5


def test_pieces_of_a_map_have_the_mean_depth_each() -> None:
    camera = cameras()[0]
    normals = np.full((SIDE, SIDE, 3), np.nan)
    normals[10:30, 10:30] = normals[60:90, 60:90] = [0, 0, 1]
    depths = integrate(NormalMap(normals), camera, 0.3)
    assert np.nanmax(np.abs(depths - 0.3)) < 1e-9


@pytest.mark.parametrize(
    ("name", "exact"), [("normals.npz", 1e-7), ("normals.exr", 1e-7), ("normals.png", 3e-5)]
)
def test_a_normal_map_is_read_as_it_was_written(tmp_path: Path, name: str, exact: float) -> None:
    found, _ = sphere_seen(cameras()[0], 0.0)
    write_normal_map(tmp_path, found)
    again = read_normal_map(tmp_path / name)
    assert np.array_equal(again.inside, found.inside)
    # 16 bits of -1 to 1 in the PNG.
    assert np.nanmax(np.abs(again.normals - found.normals)) < exact


def test_what_is_no_normal_map_is_named(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "photo.png"), np.full((8, 8, 3), 40, np.uint8))
    with pytest.raises(ValueError, match=r"photo.png: 100% of its vectors aren't unit"):
        read_normal_map(tmp_path / "photo.png")
    write_exr(tmp_path / "black.exr", np.zeros((8, 8, 3)))
    with pytest.raises(ValueError, match=r"black.exr: holds no normals"):
        read_normal_map(tmp_path / "black.exr")
    np.savez(tmp_path / "other.npz", depth=np.zeros(3))
    with pytest.raises(ValueError, match=r"other.npz: holds depth; the normals must be named 'normals'"):
        read_normal_map(tmp_path / "other.npz")
    write_exr(tmp_path / "away.exr", np.broadcast_to(np.array([0.0, 0.6, -0.8]), (8, 8, 3)))
    with pytest.raises(ValueError, match=r"away.exr: most normals face away from the camera"):
        read_normal_map(tmp_path / "away.exr")


def test_integrate_writes_a_mesh_and_names_what_it_cannot_write(
    tmp_path: Path, lightfactor: Callable[..., tuple[int, str, str]]
) -> None:
    found, _ = sphere_seen(cameras()[0], 0.3)
    write_normal_map(tmp_path, found)
    pixel = RADIUS / (0.42 * SIDE)
    assert (
        lightfactor("integrate", tmp_path / "normals.png", "-o", tmp_path / "s.obj", "--pixel", pixel)[0] == 0
    )
    mesh = read_mesh(tmp_path / "s.obj")
    # Its own sphere, wherever it lies in depth.
    design = np.column_stack([2 * mesh.vertices, np.ones(len(mesh.vertices))])
    centre = np.linalg.lstsq(design, (mesh.vertices**2).sum(axis=1), rcond=None)[0][:3]
    assert np.abs(np.linalg.norm(mesh.vertices - centre, axis=1) - RADIUS).max() < 0.02 * RADIUS
    for source, out, fault in (
        ("normals.png", "s.ply", "is written as .obj"),
        ("nothing.png", "t.obj", "does not exist"),
    ):
        status, _, error = lightfactor("integrate", tmp_path / source, "-o", tmp_path / out)
        assert status
        assert fault in error
        assert not (tmp_path / out).exists()


def test_a_broken_npz_is_named(tmp_path: Path) -> None:
    found, _ = sphere_seen(cameras()[0], 0.0)
    write_normal_map(tmp_path, found)
    whole = (tmp_path / "normals.npz").read_bytes()
    (tmp_path / "half.npz").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "text.npz").write_text("not an archive")
    for name in ("half.npz", "text.npz"):
        with pytest.raises(ValueError, match=rf"{name}: can't be read as NPZ"):
            read_normal_map(tmp_path / name)
