"""Photo sets of a textured body with exact poses, rendered by rays and noise here, by none of our renderers."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates, spline_filter

from capture.arc.gantry import look_at
from capture.boards.board import parse_board
from capture.camera import Camera
from recon.mesh.rays import RayTracer
from synthetic.sensing.boardphotos import board_radiance

Floats = NDArray[np.float64]

RADIUS = 0.05
_GRAINS = (0.02, 0.008, 0.003, 0.0012, 0.0006)
BOARD = parse_board("charuco:9x7:0.024:0.018:DICT_4X4_50")
# The board lies below the body, its first corner at the back on the left.
BOARD_TO_WORLD = np.array([[1.0, 0, 0, -0.084], [0, 1, 0, 0.06], [0, 0, 1, -0.055], [0, 0, 0, 1]])
LENS = Camera(
    "OPENCV", np.array([900.0, 905.0, 322.0, 238.0, -0.05, 0.02, 0.0005, -0.0003]), 640, 480, np.eye(4)
)
# The middle of its pictures, which holds the body but not the board: in the noise around it features take their time.
CLOSE = Camera(LENS.model, LENS.params - [0, 0, 148, 68, 0, 0, 0, 0], 344, 344, np.eye(4))


def body() -> trimesh.Trimesh:
    """A sphere with hills, about 5 cm in radius, about the origin."""
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=1.0)
    x, y, z = mesh.vertices.T
    hills = (
        1
        + 0.12 * np.sin(4 * x + 1) * np.cos(3 * y)
        + 0.1 * np.sin(5 * z + 2 * x)
        + 0.05 * np.cos(9 * y - 4 * z)
    )
    mesh.vertices *= (RADIUS * hills)[:, None]
    return mesh


def ring(count: int, step_deg: float, distance: float = 0.4) -> list[Floats]:
    """Poses that go round the origin and up and down a little, cameras upright."""
    poses = []
    for number in range(count):
        azimuth = np.radians(step_deg * number)
        elevation = np.radians(25 + 12 * np.sin(1.7 * number))
        away = [np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)]
        eye = distance * (1 + 0.05 * np.cos(2.1 * number)) * np.array(away)
        poses.append(look_at(eye, [0.002, -0.001, 0.001], [0, 0, 1]))
    return poses


def photograph(
    lens: Camera, pose: Floats, rng: np.random.Generator, surface: str, board: bool, samples: int = 2
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """A photograph (h, w, 3) uint8, sRGB-like gamma 2.2 and 1% noise, and its mask (h, w).

    surface : "textured", "plain", or "mirror", a chrome sphere in a room full of texture. board : with BOARD
    below it.
    """
    mesh, tracer = _traced(surface)
    camera = lens.posed(pose)
    directions = _seen_through(lens, samples) @ pose[:3, :3]
    origins = np.broadcast_to(camera.centre, directions.shape)
    hits = tracer.first_hits(origins, directions)
    seen = hits.faces >= 0
    corners = mesh.faces[hits.faces[seen]]
    points = np.einsum("nk,nkc->nc", hits.weights[seen], mesh.vertices[corners])
    normals = np.einsum("nk,nkc->nc", hits.weights[seen], mesh.vertex_normals[corners])
    radiance = np.zeros(len(seen))
    if surface == "mirror":
        outward = points / np.linalg.norm(points, axis=1, keepdims=True)
        along = (directions[seen] * outward).sum(axis=1, keepdims=True)
        radiance[seen] = 0.1 + 0.8 * _noise(0.02 * (directions[seen] - 2 * along * outward))
    else:
        shade = 0.35 + 0.65 * np.clip(normals @ np.array([0.48, 0.6, 0.64]), 0, None)
        albedo = 0.15 + 0.7 * _noise(points) if surface == "textured" else 0.5
        radiance[seen] = shade * albedo
    picture = radiance.reshape(camera.height, samples, camera.width, samples).mean(axis=(1, 3))
    if board:
        below = board_radiance(camera.posed(pose @ BOARD_TO_WORLD), BOARD, rng)
        empty = 1 - seen.reshape(camera.height, samples, camera.width, samples).mean(axis=(1, 3))
        picture = picture + 0.6 * below * empty
    cover = seen.reshape(camera.height, samples, camera.width, samples).mean(axis=(1, 3))
    noisy = picture + rng.normal(0, 0.01 * picture.max(), picture.shape)
    codes = np.round(255 * np.clip(noisy, 0, 1) ** (1 / 2.2)).astype(np.uint8)
    return np.repeat(codes[:, :, None], 3, axis=2), np.round(255 * cover).astype(np.uint8)


def write_set(
    folder: Path,
    poses: Sequence[Floats],
    surface: str = "textured",
    given: Sequence[int] = (),
    masks: bool = True,
    boards: Sequence[int] = (),
) -> None:
    """A photo set of the body; photos numbered in `given` state their pose, those in `boards` show BOARD."""
    rng = np.random.default_rng(7)
    lens = LENS if boards else CLOSE
    folder.mkdir(parents=True, exist_ok=True)
    lines = [
        "format = 1",
        'name = "body"',
        "[camera]",
        f'model = "{lens.model}"\nparams = {lens.params.tolist()}\nwidth = {lens.width}\nheight = {lens.height}',
        '[radiometry]\nencoding = "srgb"',
        '[object]\nshape = "mesh"',
    ]
    for number, pose in enumerate(poses):
        picture, mask = photograph(lens, pose, rng, surface, number in boards)
        name = f"{number:03d}.png"
        cv2.imwrite(str(folder / name), picture)
        lines.append(f'[[photo]]\nfile = "{name}"')
        if masks:
            cv2.imwrite(str(folder / f"mask{number:03d}.png"), mask)
            lines.append(f'mask = "mask{number:03d}.png"')
        if number in given:
            lines.append(f"world_to_camera = {pose.tolist()}")
    (folder / "photoset.toml").write_text("\n".join(lines), encoding="utf-8")


def _noise(points: Floats) -> Floats:
    """Grain (n,) in 0 to 1 of points (n, 3), from 20 mm down to 0.6 mm: random numbers in space, interpolated."""
    total = np.zeros(len(points))
    for size, grid in zip(_GRAINS, _grids(), strict=True):
        total += map_coordinates(grid, (points / size).T, order=3, mode="grid-wrap", prefilter=False)
    return np.clip(0.5 + 1.2 * (total / len(_GRAINS) - 0.5), 0, 1)


@cache
def _grids() -> tuple[Floats, ...]:
    rng = np.random.default_rng(3)
    return tuple(spline_filter(rng.random((32, 32, 32)), order=3, mode="grid-wrap") for _ in _GRAINS)


@cache
def _seen_through(lens: Camera, samples: int) -> Floats:
    """Unit directions in the camera's own frame, of so many samples a pixel each way: the same for all poses."""
    steps = (np.arange(samples) + 0.5) / samples
    x, y = ((np.arange(size)[:, None] + steps).ravel() for size in (lens.width, lens.height))
    return lens.rays(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2))[1]


@cache
def _traced(surface: str) -> tuple[trimesh.Trimesh, RayTracer]:
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=RADIUS) if surface == "mirror" else body()
    return mesh, RayTracer(mesh.vertices, mesh.faces)
