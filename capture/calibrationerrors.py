"""How far off what a photo set gives may be: poses, lenses, the mesh and its place, sources, the camera's colours."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict

from capture.arrays import frozen_array
from capture.camera import Camera
from capture.files.documents import read_json
from capture.files.tables import Table

Floats = NDArray[np.float64]


class _Lens(Table):
    model_config = ConfigDict(extra="ignore")
    covariance: tuple[tuple[float, ...], ...] | None = None


@dataclass(frozen=True, eq=False)
class SharedError:
    """An error that some photographs have in common. photos : their labels. covariance : (p, p)."""

    photos: tuple[str, ...]
    covariance: Floats

    def __post_init__(self) -> None:
        object.__setattr__(self, "covariance", frozen_array(self.covariance))


@dataclass(frozen=True, eq=False)
class CalibrationErrors:
    """Covariances of what a photo set gives; what isn't named counts as exact.

    poses : of the turn w (radians, about the camera's axes) and shift s (metres) in [exp(w) R | t + s], one for each
        place that photographs were taken from.
    stated_pose : radians and metres, standard deviations of every pose's turn about the object, and of its shift, about
        and along each axis; it stands before `poses`. None where the manifest states none.
    lenses : of the camera's params, one for each lens.
    mesh_place : (7, 7) of the mesh's turn about the world's axes, its shift, and the logarithm of the world's scale.
    height : metres, standard deviation of each vertex along its normal. height_correlation : metres, over which it
        varies, as in `recon.mesh.scannoise`; 0 where each vertex is off by itself.
    stated : whether the manifest states any of them, or of light directions.
    color : (9, 9) of dM M^-1, row by row, where M makes linear sRGB of the camera's colours.
    extinction : standard deviation of what crossed filters pass of the lobe, as `Extinction` has it.
    """

    poses: tuple[SharedError, ...] = ()
    stated_pose: tuple[float, float] | None = None
    lenses: tuple[SharedError, ...] = ()
    mesh_place: Floats | None = None
    height: float = 0.0
    height_correlation: float = 0.0
    stated: bool = False
    color: Floats | None = None
    extinction: float = 0.0

    @property
    def named(self) -> bool:
        """Whether there is any, of light directions apart."""
        moved = self.poses or self.stated_pose or self.lenses or self.mesh_place is not None or self.height
        return bool(moved or self.extinction) or self.color is not None

    @property
    def geometric(self) -> CalibrationErrors:
        """Those that move what photographs show, without those of colours and filters."""
        return replace(self, color=None, extinction=0.0)

    def poses_about(self, centre: Floats, cameras: Mapping[str, Camera]) -> tuple[SharedError, ...]:
        """Errors of poses; centre : the object's, (3,). cameras : of photographs by their labels."""
        if self.stated_pose is None:
            return self.poses
        return tuple(
            SharedError(tuple(labels), _turned_about(cameras[labels[0]], centre, *self.stated_pose))
            for labels in _alike(cameras, lambda camera: camera.world_to_camera.tobytes())
        )


NO_ERRORS = CalibrationErrors()


def read_lens_covariance(path: Path) -> Floats | None:
    """The covariance of a camera.json's params, None where it has none; ValueError names what is wrong."""
    table = read_json(path, _Lens, (), "a camera.json holds covariance", ("covariance",))
    if table.covariance is None:
        return None
    if len({len(table.covariance), *map(len, table.covariance)}) != 1:
        raise ValueError(f"{path}: covariance must have as many rows as columns, one for each of params")
    return np.array(table.covariance, float)


def pose_errors(
    cameras: Mapping[str, Camera], covariances: Mapping[str, Floats | None]
) -> tuple[SharedError, ...]:
    """Errors of poses that registration found, by photographs' labels. Photographs of one pose share its error."""
    found = []
    for labels in _alike(cameras, lambda camera: camera.world_to_camera.tobytes()):
        covariance = covariances.get(labels[0])
        if covariance is not None and covariance.any():
            found.append(SharedError(tuple(labels), covariance))
    return tuple(found)


def stated_pose(rotation_deg: float | None, position: float | None) -> tuple[float, float] | None:
    """A stated error of every pose as `CalibrationErrors` has it; None where neither is stated."""
    return (np.radians(rotation_deg or 0.0), position or 0.0) if rotation_deg or position else None


def lens_errors(
    cameras: Mapping[str, Camera], covariances: Mapping[str, Floats | None], focal_length: float | None
) -> tuple[SharedError, ...]:
    """Errors of lenses: of the focal length as it is stated, else those of calibration, by photographs' labels.

    focal_length : standard deviation as a share of it, or None. Cameras with the same params are one lens.
    """
    found = []
    for labels in _alike(cameras, lambda camera: camera.model.encode() + camera.params.tobytes()):
        camera, covariance = cameras[labels[0]], covariances.get(labels[0])
        if focal_length is not None:
            longer = camera.zoomed(1 + focal_length).params - camera.params
            covariance = np.outer(longer, longer)
        if covariance is not None and covariance.any():
            found.append(SharedError(tuple(labels), covariance))
    return tuple(found)


def check_lens_covariance(path: Path, covariance: Floats, params: Floats) -> None:
    """ValueError unless the covariance is of as many numbers as params."""
    if len(covariance) != len(params):
        raise ValueError(
            f"{path}: covariance is of {len(covariance)} numbers, but params are {len(params)}: calibrate again"
        )


def _alike(cameras: Mapping[str, Camera], key: Callable[[Camera], bytes]) -> list[list[str]]:
    """Labels of cameras that have a key in common."""
    found: dict[bytes, list[str]] = {}
    for label, camera in cameras.items():
        found.setdefault(key(camera), []).append(label)
    return list(found.values())


def _turned_about(camera: Camera, centre: Floats, turn: float, shift: float) -> Floats:
    """The covariance (6, 6) of a pose that is turned about a point and shifted, independently in each axis."""
    x, y, z = camera.world_to_camera[:3, :3] @ centre
    # What keeps the point where the camera sees it: s = (R c) x w.
    change = np.eye(6)
    change[3:, :3] = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
    variances = np.repeat([turn**2, shift**2], 3)
    return np.asarray((change * variances) @ change.T)
