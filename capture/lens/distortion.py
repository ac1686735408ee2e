"""Lens models from the simplest to the richest, each as OpenCV fits it and as COLMAP names it.

Both write the same formulas (Brown 1971; OpenCV's rational radial factor), but order the coefficients differently,
and COLMAP puts the centre of the first pixel at (0.5, 0.5), OpenCV at (0, 0).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture.boards.cornerwindow import HALF_PIXEL
from capture.camera import Camera

Floats = NDArray[np.float64]

# OpenCV's order of distortion coefficients, of which the first eight are used.
_OPENCV_ORDER = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
PARAM_NAMES = {
    "SIMPLE_PINHOLE": ("f", "cx", "cy"),
    "PINHOLE": ("fx", "fy", "cx", "cy"),
    "SIMPLE_RADIAL": ("f", "cx", "cy", "k1"),
    "RADIAL": ("f", "cx", "cy", "k1", "k2"),
    "OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
    "FULL_OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
}


@dataclass(frozen=True)
class LensModel:
    """A candidate of the ladder: one of COLMAP's models with some of its parameters left at zero.

    name : how reports call it. model : COLMAP's name. free : the distortion coefficients that are fitted.
    """

    name: str
    model: str
    free: tuple[str, ...]

    @property
    def one_focal(self) -> bool:
        """Whether pixels are taken to be square."""
        return PARAM_NAMES[self.model][0] == "f"

    @property
    def fitted(self) -> tuple[str, ...]:
        """Names of the parameters that are fitted, in COLMAP's order."""
        return tuple(
            name for name in PARAM_NAMES[self.model] if name in self.free or name not in _OPENCV_ORDER
        )

    @property
    def flags(self) -> int:
        """OpenCV's flags that leave only this model's parameters free."""
        import cv2

        flags = cv2.CALIB_FIX_ASPECT_RATIO if self.one_focal else 0
        if "p1" not in self.free:
            flags |= cv2.CALIB_ZERO_TANGENT_DIST
        rational = "k4" in self.free
        flags |= cv2.CALIB_RATIONAL_MODEL if rational else 0
        for name in ("k1", "k2", "k3", *(("k4", "k5", "k6") if rational else ())):
            if name not in self.free:
                flags |= getattr(cv2, f"CALIB_FIX_{name.upper()}")
        return flags

    def params(self, matrix: Floats, coefficients: Floats) -> Floats:
        """COLMAP's parameters from OpenCV's camera matrix (3, 3) and distortion coefficients."""
        values = dict(zip(_OPENCV_ORDER, np.ravel(coefficients)[:8], strict=False))
        values |= {"f": matrix[0, 0], "fx": matrix[0, 0], "fy": matrix[1, 1]}
        values |= {"cx": matrix[0, 2] + HALF_PIXEL, "cy": matrix[1, 2] + HALF_PIXEL}
        return np.array([values.get(name, 0.0) for name in PARAM_NAMES[self.model]])

    def opencv(self, params: Floats) -> tuple[Floats, Floats]:
        """OpenCV's camera matrix (3, 3) and eight distortion coefficients from COLMAP's parameters."""
        values = dict(zip(PARAM_NAMES[self.model], params, strict=True))
        fx, fy = values.get("fx", values.get("f")), values.get("fy", values.get("f"))
        matrix = np.array(
            [[fx, 0, values["cx"] - HALF_PIXEL], [0, fy, values["cy"] - HALF_PIXEL], [0, 0, 1]], float
        )
        return matrix, np.array([values.get(name, 0.0) for name in _OPENCV_ORDER])

    def camera(self, params: Floats, size: tuple[int, int]) -> Camera:
        """The camera at the world's origin."""
        return Camera(self.model, params, *size, np.eye(4))


# Each nests the one before; the last but one is what OpenCV fits unless flags say otherwise.
LADDER = (
    LensModel("SIMPLE_PINHOLE", "SIMPLE_PINHOLE", ()),
    LensModel("PINHOLE", "PINHOLE", ()),
    LensModel("SIMPLE_RADIAL", "SIMPLE_RADIAL", ("k1",)),
    LensModel("RADIAL", "RADIAL", ("k1", "k2")),
    LensModel("OPENCV", "OPENCV", ("k1", "k2", "p1", "p2")),
    LensModel("FULL_OPENCV, k1-k3", "FULL_OPENCV", ("k1", "k2", "p1", "p2", "k3")),
    LensModel("FULL_OPENCV", "FULL_OPENCV", _OPENCV_ORDER),
)


def folds_at(camera: Camera, points: Floats) -> NDArray[np.bool_]:
    """Where in the picture a lens model is no model: no ray leads there, or neighbouring rays cross.

    points : (n, 2) pixels. Returns (n,) bool.
    """
    step = 0.5
    corners = [(0, 0), (step, 0), (0, step)]
    here, right, below = (_plane(camera, points + np.array(shift)) for shift in corners)
    across, down = (right - here) / step, (below - here) / step
    orientation = across[:, 0] * down[:, 1] - across[:, 1] * down[:, 0]
    # On the axis a pixel is 1 / f^2: where it has shrunk or grown a hundredfold, no lens does that.
    relative = orientation * camera.focal_px**2
    back = camera.project(np.column_stack([here, np.ones(len(here))]))
    with np.errstate(invalid="ignore"):
        sound = (relative > 0.01) & (relative < 100) & (np.linalg.norm(back - points, axis=1) < 0.01)
    return ~sound


def picture_grid(size: tuple[int, int], count: int = 24) -> Floats:
    """Points (n, 2) all over a picture, its border included, `count` of them along the longer side."""
    width, height = size
    step = max(size) / count
    x = np.linspace(0, width, max(2, round(width / step) + 1))
    y = np.linspace(0, height, max(2, round(height / step) + 1))
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def displacement(camera: Camera, points: Sequence[Sequence[float]] | Floats) -> Floats:
    """How far in pixels the lens moves image points (n, 2) from where a pinhole would put them, (n,)."""
    points = np.asarray(points, float)
    plane = _plane(camera, points)
    names = PARAM_NAMES[camera.model]
    values = dict(zip(names, camera.params, strict=True))
    focal = np.array([values.get("fx", values.get("f")), values.get("fy", values.get("f"))], float)
    straight = plane * focal + np.array([values["cx"], values["cy"]])
    return np.asarray(np.linalg.norm(straight - points, axis=1))


def _plane(camera: Camera, points: Floats) -> Floats:
    _, directions = camera.rays(points)
    return directions[:, :2] / directions[:, 2:]
