"""Photographs of calibration boards with known truth.

Every pixel is a mean over points of it whose rays (COLMAP's, as the truth's own lens model) meet the printed board: no
image is warped and OpenCV's projection plays no part.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from capture.boards.board import Board, charuco_board
from capture.camera import Camera

Floats = NDArray[np.float64]

_DARK, _BRIGHT, _BACKGROUND = 0.06, 0.85, 0.35
# Texture pixels along a square of a charuco board.
_TEXTURE = 120
# Of so many poses per photograph some must show the whole board.
_TRIES = 300


def board_photo(
    camera: Camera,
    board: Board,
    rng: np.random.Generator,
    blur: float = 0.7,
    noise: float = 0.01,
    samples: int = 4,
    legacy: bool = False,
) -> NDArray[np.uint8]:
    """A photograph (h, w) uint8 of a board by a camera posed in the board's frame, with a gamma of 2.2.

    noise : standard deviation, share of white. The others are as in `board_radiance`.
    """
    picture = board_radiance(camera, board, rng, blur, samples, legacy)
    picture = picture + rng.normal(0, noise, picture.shape)
    return np.round(255 * np.clip(picture, 0, 1) ** (1 / 2.2)).astype(np.uint8)


def board_radiance(
    camera: Camera,
    board: Board,
    rng: np.random.Generator,
    blur: float = 0.7,
    samples: int = 4,
    legacy: bool = False,
) -> Floats:
    """What a camera posed in the board's frame sees of it, (h, w), linear and without noise; its paper is 0.85.

    blur : standard deviation of the lens's blur, pixels. samples : points along a pixel's side. legacy : charuco as
    OpenCV drew it before version 4.6. Light falls off across the board, by up to 15% of its mean.
    """
    u, v = _squares(camera, board)
    (u_down, u_right), (v_down, v_right) = np.gradient(u), np.gradient(v)
    texture = _texture(board, legacy) if board.kind == "charuco" else None
    total = np.zeros(u.shape)
    offsets = (np.arange(samples) + 0.5) / samples - 0.5
    for down in offsets:
        for right in offsets:
            total += _printed(
                board, texture, u + down * u_down + right * u_right, v + down * v_down + right * v_right
            )
    picture = gaussian_filter(total / samples**2, blur)
    slope = rng.uniform(-0.15, 0.15, 2)
    y, x = np.linspace(-0.5, 0.5, camera.height)[:, None], np.linspace(-0.5, 0.5, camera.width)
    return np.asarray(picture * (1 + slope[0] * x + slope[1] * y))


def board_poses(
    board: Board,
    camera: Camera,
    count: int,
    rng: np.random.Generator,
    tilt_deg: float = 35.0,
    fill: float = 0.6,
) -> list[Floats]:
    """Poses (4, 4), board to camera, that show the whole board, tilted by up to `tilt_deg` about two axes.

    fill : the board's longer side as a share of the picture's width, on average.
    ValueError if it hardly ever fits into the picture.
    """
    centre = board.corners.mean(axis=0)
    extent = max(board.square_counts) * board.square
    poses: list[Floats] = []
    tries = 0
    while len(poses) < count:
        tries += 1
        if tries > _TRIES * count:
            raise ValueError(
                f"of {tries - 1} poses of the board {board.spec}, {len(poses)} show it whole in {camera.width}x"
                f"{camera.height} pixels; lower fill = {fill}, or take a board of the picture's shape"
            )
        angles = rng.uniform(-1, 1, 3) * [20, tilt_deg, tilt_deg]
        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_euler("zyx", angles, degrees=True).as_matrix() @ np.diag([1.0, -1, -1])
        distance = camera.focal_px * extent / (camera.width * fill * rng.uniform(0.7, 1.3))
        pose[:3, 3] = [
            distance * rng.uniform(-0.4, 0.4) * camera.width / camera.focal_px,
            distance * rng.uniform(-0.4, 0.4) * camera.height / camera.focal_px,
            distance,
        ]
        pose[:3, 3] -= pose[:3, :3] @ centre
        seen = camera.posed(pose).project(board.corners)
        size = np.array([camera.width, camera.height])
        if (seen > 8).all() and (seen < size - 8).all():
            poses.append(pose)
    return poses


def _squares(camera: Camera, board: Board) -> tuple[Floats, Floats]:
    """Where pixels' centres lie on the board: squares right and down from the printed pattern's top left corner.

    Rays are traced every few pixels; between them splines are good to a millionth of a square.
    """
    y, x = (np.append(np.arange(0, size + 4, 8.0), size + 4.0) for size in (camera.height, camera.width))
    places = np.stack(np.meshgrid(x, y), axis=-1)
    origins, directions = camera.rays(places.reshape(-1, 2))
    distance = -origins[:, 2] / directions[:, 2]
    points = (origins + distance[:, None] * directions)[:, :2].reshape(places.shape)
    rows, columns = np.arange(camera.height) + 0.5, np.arange(camera.width) + 0.5
    right, up = (RectBivariateSpline(y, x, points[..., k])(rows, columns) / board.square for k in (0, 1))
    return right + 1, 1 - up


def _printed(board: Board, texture: Floats | None, u: Floats, v: Floats) -> Floats:
    columns, rows = board.square_counts
    paper = (u > -0.8) & (u < columns + 0.8) & (v > -0.8) & (v < rows + 0.8)
    inside = (u > 0) & (u < columns) & (v > 0) & (v < rows)
    row, column = np.where(inside, v, 0.0), np.where(inside, u, 0.0)
    if texture is None:
        dark = (np.floor(row) + np.floor(column)) % 2 == 0
    else:
        dark = texture[(row * _TEXTURE).astype(int), (column * _TEXTURE).astype(int)] < 128
    return np.where(inside & dark, _DARK, np.where(paper, _BRIGHT, _BACKGROUND))


def _texture(board: Board, legacy: bool) -> Floats:
    size = (board.columns * _TEXTURE, board.rows * _TEXTURE)
    return np.asarray(charuco_board(board, legacy).generateImage(size), float)
