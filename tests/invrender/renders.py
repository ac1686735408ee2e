"""What tests of renders share: results written by hand, pictures read back, meshes."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import trimesh

from capture.camera import Camera
from capture.files.documents import file_hash
from capture.files.imagefile import read_exr_layers, read_pixels, write_exr
from recon.mesh.trianglemesh import TriangleMesh, write_mesh

KD, KS = [0.1, 0.12, 0.15], [0.06, 0.05, 0.04]


def write_result(
    folder: Path,
    model: str = "lambertian",
    mu: float | None = None,
    sigma: float | None = None,
    covariance: tuple[Sequence[str], np.ndarray] = ((), np.zeros((0, 0))),
    **changes: Any,
) -> Path:
    """A result that nobody fitted: a sphere of 20 mm of KD and KS under a white sky, and no photographs.

    covariance : names and matrix. changes : other values of result.json's own keys.
    """

    def quantity(value: Any) -> Any:
        if value is None:
            return None
        return {"value": value, "std": np.zeros_like(value).tolist(), "status": "determined"}

    ks = None if sigma is None else KS
    numbers = {"kd": KD, "ks": ks, "mu": mu, "sigma": sigma}
    document = {
        "format": 1,
        "name": "by hand",
        "gauge": "absolute",
        "brdf": {
            "model": model,
            **{name: quantity(value) for name, value in numbers.items()},
            "normalised": {"kd": None, "ks": None},
            "covariance": {"names": list(covariance[0]), "values": covariance[1].tolist()},
        },
        "object": {"shape": "sphere", "centre": [0, 0, 0], "radius": 0.02},
        "lighting": [{"name": "sky", "sh": {"value": []}, "directional": [], "map": "lighting.exr"}],
        "photos": [],
        "identifiability": [],
        "inputs": {},
    } | changes
    folder.mkdir()
    (folder / "result.json").write_text(json.dumps(document))
    write_exr(folder / "lighting.exr", np.ones((64, 128, 3), np.float32))
    return folder


def read(path: Path) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """A picture's radiance, and its other layers."""
    return read_pixels(path).astype(float), read_exr_layers(path)


def within(alpha: np.ndarray) -> np.ndarray:
    """Pixels that the outline doesn't run through: a covered one next to it may yet lack a corner."""
    return cv2.erode((alpha == 1).astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)


def cameras(folder: Path) -> list[Camera]:
    """The cameras that a turntable's folder says."""
    views = json.loads((folder / "views.json").read_text())["views"]
    keys = ("model", "params", "width", "height", "world_to_camera")
    return [Camera(*(view[key] for key in keys)) for view in views]


def plates(path: Path) -> None:
    """A table, 2 m wide, its top at z = 0, and a smaller plate 0.5 m above its middle."""
    corners, faces, normals = [], [], []
    for side, bottom, top in ((2.0, -0.1, 0.0), (0.6, 0.5, 0.6)):
        box = trimesh.creation.box((side, side, top - bottom))
        box.apply_translation((0, 0, (top + bottom) / 2))
        for k, face in enumerate(box.faces):
            faces.append([len(corners), len(corners) + 1, len(corners) + 2])
            corners.extend(box.vertices[face])
            normals.extend([box.face_normals[k]] * 3)
    write_mesh(path, TriangleMesh(np.array(corners), np.array(faces), np.array(normals)))


def tile(path: Path, with_uv: bool = True) -> None:
    """A square of 1 m that faces up, u growing along +X and v along +Y."""
    uv = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    corners = np.column_stack([uv - 0.5, np.zeros(4)])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    write_mesh(path, TriangleMesh(corners, faces, np.tile([0, 0, 1.0], (4, 1)), uv if with_uv else None))


TILE_SET = """
format = 1
name = "tile"
camera = { model = "PINHOLE", params = [100.0, 100.0, 20.0, 20.0], width = 40, height = 40 }
radiometry = { encoding = "linear", exposure = "equal" }

[object]
shape = "mesh"
mesh = "tile.obj"
mesh_to_world = [[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0.5], [0, 0, 0, 1]]

[[lighting]]
name = "sky"
directional = [{ direction = [0.0, 0, 1], irradiance = [1.0, 1, 1] }]

[[photo]]
file = "000.exr"
world_to_camera = [[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 3], [0, 0, 0, 1]]
"""


def tile_result(folder: Path, **changes: Any) -> Path:
    """The result of a photo set of a tile, half a metre up, the set beside it; changes as of `write_result`."""
    photographs = folder / "set"
    photographs.mkdir()
    manifest = photographs / "photoset.toml"
    manifest.write_text(TILE_SET)
    write_exr(photographs / "000.exr", np.zeros((40, 40, 3), np.float32))
    tile(photographs / "tile.obj")
    pose = np.eye(4)
    pose[2, 3] = 0.5
    known: dict[str, Any] = {
        "shape": "mesh",
        "mesh_to_world": pose.tolist(),
        "centre": [0, 0, 0.5],
        "radius": 0.5**0.5,
    }
    inputs = {path.name: file_hash(path) for path in (manifest, photographs / "tile.obj")}
    return write_result(folder / "result", object=known, inputs=inputs, **changes)
