"""Normals as they lie on disk, with the camera that saw them: a result of photometric stereo, or a map by itself."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from capture.camera import ORTHOGRAPHIC, Camera
from capture.files.documents import read_json
from capture.files.tables import LenientTable
from recon.normals.normalmap import NormalMap, read_normal_map

RESULT_NAME = "result.json"
_WHAT = "`lightfactor process` writes normals for photo sets with [object] shape = 'normals'"


class _CameraTable(LenientTable):
    model: str
    params: tuple[float, ...]
    width: int
    height: int
    world_to_camera: tuple[tuple[float, float, float, float], ...]


class _NormalsTable(LenientTable):
    file: str


class _ObjectTable(LenientTable):
    normals: _NormalsTable
    camera: _CameraTable
    depth: float


class _ResultTable(LenientTable):
    object: _ObjectTable


@dataclass(frozen=True, eq=False)
class SeenNormals:
    """A normal map, the camera that it belongs to, and the mean depth of its surface, metres."""

    normal_map: NormalMap
    camera: Camera
    depth: float


def read_seen_normals(source: Path, pixel: float) -> SeenNormals:
    """Normals of a result's folder, or of a map: a file, seen from far away in the direction of -z.

    pixel : metres that a pixel of a file covers. ValueError names what is no normal map.
    """
    if source.is_dir() or source.name == RESULT_NAME:
        path = source / RESULT_NAME if source.is_dir() else source
        found = read_json(path, _ResultTable, ("object",), _WHAT).object
        table = found.camera
        pose = np.array(table.world_to_camera)
        camera = Camera(table.model, np.array(table.params), table.width, table.height, pose)
        return SeenNormals(read_normal_map(path.parent / found.normals.file), camera, found.depth)
    normals = read_normal_map(source)
    height, width = normals.inside.shape
    scale = np.array([1 / pixel, width / 2, height / 2])
    # The world's axes are the picture's.
    camera = Camera(ORTHOGRAPHIC, scale, width, height, np.diag([1.0, -1.0, -1.0, 1.0]))
    return SeenNormals(normals, camera, 0.0)
