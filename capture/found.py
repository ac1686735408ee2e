"""What `recon` has found and left beside a manifest: where photographs were taken from, and where the mesh lies."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from capture.files.documents import file_hash, read_json
from capture.files.tables import LenientTable

Floats = NDArray[np.float64]

POSES_NAME = "poses.json"
ALIGNMENT_NAME = "alignment.json"

_Row = tuple[float, float, float, float]
_Rows = tuple[_Row, _Row, _Row, _Row]


_Six = tuple[float, float, float, float, float, float]
_Seven = tuple[float, float, float, float, float, float, float]


class _PosedPhoto(LenientTable):
    file: str
    world_to_camera: _Rows
    covariance: tuple[_Six, ...] | None = None


class _UnposedPhoto(LenientTable):
    file: str
    reason: str


class _Scale(LenientTable):
    metric: bool


class _Poses(LenientTable):
    photos: tuple[_PosedPhoto, ...]
    unregistered: tuple[_UnposedPhoto, ...]
    scale: _Scale


class _Alignment(LenientTable):
    mesh_to_world: _Rows
    world_scale: Annotated[float, Field(gt=0)]
    covariance: tuple[_Seven, ...] | None = None
    made_from: dict[str, str]


@dataclass(frozen=True, eq=False)
class Poses:
    """Poses of photographs by the manifest's names of their files.

    world_to_camera : (4, 4) each. covariances : (6, 6) each, as in `calibrationerrors`, or None. unregistered : why the
        others have none. own_frame : whether place, direction and size of their world are the finder's own choice, so
        that nothing else can be given in it.
    """

    path: Path
    world_to_camera: Mapping[str, Floats]
    covariances: Mapping[str, Floats | None]
    unregistered: Mapping[str, str]
    own_frame: bool = False

    def of(self, file: str) -> Floats:
        """The pose of a photograph; ValueError says why it has none."""
        if file in self.world_to_camera:
            return self.world_to_camera[file]
        reason = self.unregistered.get(file, "it was not in the set when the poses were found")
        raise ValueError(
            f'{self.path}: has no pose for photo "{file}": {reason}; take the photo out of the manifest, give'
            " it world_to_camera there, or run `lightfactor register` again"
        )


@dataclass(frozen=True, eq=False)
class Alignment:
    """Where a mesh lies in the world, and how large the world is.

    mesh_to_world : (4, 4) rigid, from the mesh in metres. world_scale : what positions of cameras are multiplied by,
        so that they are in the mesh's metres. covariance : (7, 7), as in `calibrationerrors`, or None.
    """

    mesh_to_world: Floats
    world_scale: float
    covariance: Floats | None


def read_poses(path: Path) -> Poses:
    """The poses of a poses.json, as `lightfactor register` writes it."""
    what = "a poses.json, as `lightfactor register` writes it, holds photos, unregistered and scale"
    table = read_json(path, _Poses, ("photos", "unregistered", "scale"), what)
    return Poses(
        path,
        {photo.file: np.array(photo.world_to_camera) for photo in table.photos},
        {photo.file: _square(path, photo.covariance, 6) for photo in table.photos},
        {photo.file: photo.reason for photo in table.unregistered},
        not table.scale.metric,
    )


def read_alignment(path: Path, files: Mapping[str, Path]) -> Alignment:
    """The alignment of an alignment.json, as `lightfactor align` writes it.

    files : what it must have been made from: "mesh", and "poses" where poses were registered.
    ValueError if those files have changed since.
    """
    keys = ("mesh_to_world", "world_scale", "made_from")
    what = (
        "an alignment.json, as `lightfactor align` writes it, holds mesh_to_world, world_scale and made_from"
    )
    table = read_json(path, _Alignment, keys, what, ("covariance",))
    for name in sorted({*files, *table.made_from}):
        now = file_hash(files[name]) if name in files else None
        if now != table.made_from.get(name):
            file = files[name].name if name in files else f"{name}, which the set no longer has"
            raise ValueError(f"{path}: was made with another {file}; run `lightfactor align` again")
    covariance = _square(path, table.covariance, 7)
    return Alignment(np.array(table.mesh_to_world), table.world_scale, covariance)


def _square(path: Path, rows: tuple[tuple[float, ...], ...] | None, size: int) -> Floats | None:
    """A covariance, checked for its size; None where there is none."""
    if rows is None:
        return None
    if len(rows) != size:
        raise ValueError(f"{path}: a covariance has {len(rows)} rows; it must be {size}x{size}")
    return np.array(rows, float)
