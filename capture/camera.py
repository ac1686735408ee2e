"""Cameras: pixels to rays and back, perspective through COLMAP's models, and orthographic.

Frames are OpenCV's (x right, y down, z forward). The centre of the top-left pixel is (0.5, 0.5), as in
COLMAP, so `pycolmap` is called without any shift.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capture.arrays import frozen_array

Floats = NDArray[np.float64]

ORTHOGRAPHIC = "ORTHOGRAPHIC"
_IDENTITY, _LAST_ROW = np.eye(3), np.array([0.0, 0.0, 0.0, 1.0])
PERSPECTIVE_MODELS = ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV")
MODELS = (*PERSPECTIVE_MODELS, ORTHOGRAPHIC)


@dataclass(frozen=True, eq=False)
class Camera:
    """A calibrated, posed camera.

    model : one of `MODELS`; COLMAP's names and parameter order, or ORTHOGRAPHIC.
    params : float64. ORTHOGRAPHIC takes [scale, cx, cy] or [scale_x, scale_y, cx, cy], scale in pixels
        per metre; none at all means one pixel per metre about the image centre.
    width, height : pixels.
    world_to_camera : (4, 4) float64, rigid.
    """

    model: str
    params: Floats
    width: int
    height: int
    world_to_camera: Floats

    def __post_init__(self) -> None:
        if self.model not in MODELS:
            raise ValueError(f"camera model {self.model!r} is not known; use one of {', '.join(MODELS)}")
        if self.width <= 0 or self.height <= 0:
            raise ValueError(f"camera size is {self.width}x{self.height}; width and height must be > 0")
        object.__setattr__(self, "params", frozen_array(_complete_params(self)))
        object.__setattr__(self, "world_to_camera", frozen_array(rigid_transform(self.world_to_camera)))

    @property
    def is_orthographic(self) -> bool:
        return self.model == ORTHOGRAPHIC

    @cached_property
    def camera_to_world(self) -> Floats:
        return np.asarray(np.linalg.inv(self.world_to_camera))

    @property
    def centre(self) -> Floats:
        """Centre of projection in the world, (3,) metres (orthographic: the origin of its frame)."""
        return self.camera_to_world[:3, 3]

    @property
    def focal_px(self) -> float:
        """Mean focal length of x and y in pixels (orthographic: geometric mean of pixels per metre)."""
        if self.is_orthographic:
            return float(np.sqrt(self.params[0] * self.params[1]))
        return float(self._colmap.mean_focal_length())

    @cached_property
    def _colmap(self) -> Any:
        import pycolmap

        return pycolmap.Camera(
            model=self.model, width=self.width, height=self.height, params=self.params.tolist()
        )

    def posed(self, world_to_camera: ArrayLike) -> Camera:
        """The same camera at another pose."""
        return replace(self, world_to_camera=np.asarray(world_to_camera, float))

    def zoomed(self, factor: float) -> Camera:
        """The same camera with `factor` times the focal length (orthographic: the scale)."""
        params = self.params.copy()
        params[[0, 1] if self.is_orthographic else list(self._colmap.focal_length_idxs())] *= factor
        return replace(self, params=params)

    def binned(self, factor: int) -> Camera:
        """The camera of pictures whose pixels are `factor` by `factor` of this one's; what fills none is cut off."""
        width, height = self.width // factor, self.height // factor
        if self.is_orthographic:
            return replace(self, params=self.params / factor, width=width, height=height)
        import pycolmap

        # Lens distortion is a matter of directions, which stay.
        whole = {"width": width * factor, "height": height * factor}
        smaller = pycolmap.Camera(model=self.model, **whole, params=self.params.tolist())
        smaller.rescale(width, height)
        return replace(self, params=np.asarray(smaller.params), width=width, height=height)

    def rays(self, pixels: ArrayLike) -> tuple[Floats, Floats]:
        """Rays through image points, in the world.

        pixels : (n, 2) in pixels, the centre of the first pixel being (0.5, 0.5).
        Returns origins (n, 3) metres and directions (n, 3), unit, pointing into the scene; a direction is
        NaN where the lens distortion reaches no such pixel.
        """
        pixels = np.asarray(pixels, float).reshape(-1, 2)
        rotation = self.camera_to_world[:3, :3]
        if self.is_orthographic:
            plane = (pixels - self.params[2:]) / self.params[:2]
            local = np.column_stack([plane, np.zeros(len(plane))])
            origins = local @ rotation.T + self.centre
            directions = np.broadcast_to(rotation[:, 2], origins.shape)
            return origins, directions
        plane = np.asarray(self._colmap.cam_from_img(pixels), float)
        directions = plane @ rotation[:, :2].T
        directions += rotation[:, 2]
        # As `np.linalg.norm` has it, in a third of the time; turns keep lengths.
        directions /= np.sqrt(np.einsum("nc,nc->n", plane, plane) + 1)[:, None]
        return np.broadcast_to(self.centre, directions.shape), directions

    def project(self, points: ArrayLike) -> Floats:
        """Image points (n, 2) in pixels of world points (n, 3) in metres; NaN behind a perspective camera."""
        points = np.asarray(points, float).reshape(-1, 3)
        local = points @ self.world_to_camera[:3, :3].T + self.world_to_camera[:3, 3]
        if self.is_orthographic:
            return local[:, :2] * self.params[:2] + self.params[2:]
        ahead = local[:, 2] > 0
        if len(local) and ahead.all():
            return np.asarray(self._colmap.img_from_cam(local), float)
        pixels = np.full((len(local), 2), np.nan)
        if ahead.any():
            pixels[ahead] = self._colmap.img_from_cam(local[ahead])
        return pixels

    def views(self, points: ArrayLike) -> Floats:
        """Directions (n, 3), unit, from world points (n, 3) towards the camera."""
        points = np.asarray(points, float).reshape(-1, 3)
        if self.is_orthographic:
            return np.broadcast_to(-self.camera_to_world[:3, 2], points.shape)
        towards = self.centre - points
        return np.asarray(towards / np.linalg.norm(towards, axis=1, keepdims=True))

    def depth(self, points: ArrayLike) -> Floats:
        """Depth along the optical axis, (n,) metres, positive in front of the camera."""
        points = np.asarray(points, float).reshape(-1, 3)
        return points @ self.world_to_camera[2, :3] + self.world_to_camera[2, 3]


def rigid_transform(matrix: ArrayLike, name: str = "world_to_camera") -> Floats:
    """The 4x4 matrix if it is a rotation and a translation; otherwise a ValueError that says what it is."""
    matrix = np.asarray(matrix, float)
    if matrix.shape != (4, 4):
        raise ValueError(f"{name} has shape {matrix.shape}; it must be 4x4")
    if not np.isfinite(matrix).all():
        raise ValueError(f"{name} holds a value that is not finite")
    # Cameras are posed many times in a fit: a difference takes a fifth of `np.allclose`'s time.
    if np.abs(matrix[3] - _LAST_ROW).max() > 1e-6:
        hint = "; it looks transposed" if np.abs(matrix[:, 3] - _LAST_ROW).max() < 1e-6 else ""
        raise ValueError(f"the last row of {name} is {matrix[3].tolist()}, not [0, 0, 0, 1]{hint}")
    rotation = matrix[:3, :3]
    # 1e-3 admits poses that were printed with four digits.
    if np.abs(rotation @ rotation.T - _IDENTITY).max() > 1e-3:
        raise ValueError(f"the 3x3 part of {name} is not a rotation (rows not orthonormal)")
    if np.linalg.det(rotation) < 0:
        raise ValueError(f"{name} mirrors (its determinant is -1): the frame is left-handed")
    u, _, vt = np.linalg.svd(rotation)
    rigid = matrix.copy()
    rigid[:3, :3] = u @ vt
    return rigid


def _complete_params(camera: Camera) -> Floats:
    params = np.atleast_1d(np.asarray(camera.params, float))
    if params.ndim != 1:
        raise ValueError(f"camera params have shape {params.shape}; they must be one list of numbers")
    if not np.isfinite(params).all():
        raise ValueError(f"camera params {params.tolist()} are not all finite")
    if camera.is_orthographic:
        if params.size == 0:
            params = np.array([1.0, 1.0, camera.width / 2, camera.height / 2])
        elif params.size == 3:
            params = params[[0, 0, 1, 2]]
        elif params.size != 4:
            raise ValueError(
                "an ORTHOGRAPHIC camera takes params [scale, cx, cy] or [scale_x, scale_y, cx, cy];"
                f" got {params.size} numbers"
            )
        if (params[:2] <= 0).any():
            raise ValueError(f"orthographic scale is {params[:2].tolist()} px per metre; it must be > 0")
        return params
    names = _names_of_params(camera.model)
    if params.size != len(names):
        expected = ", ".join(names)
        raise ValueError(f"camera model {camera.model} takes params [{expected}]; got {params.size} numbers")
    for name, value in zip(names, params, strict=True):
        if name.startswith("f") and value <= 0:
            raise ValueError(f"focal length {name} is {value} px; it must be > 0")
    return params


@lru_cache
def _names_of_params(model: str) -> tuple[str, ...]:
    import pycolmap

    return tuple(pycolmap.Camera.create_from_model_name(0, model, 1.0, 1, 1).params_info.split(", "))
