"""A photo set: what was shot, with which camera, from where, under which light."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from capture.camera import Camera
from capture.documents import read_json
from capture.gantry import arc_pose
from capture.manifest import (
    CameraTable,
    GantryTable,
    LightingTable,
    Manifest,
    Matrix4,
    ObjectTable,
    PhotoTable,
    RadiometryTable,
    read_manifest,
)

MANIFEST_NAME = "photoset.toml"


@dataclass(frozen=True)
class ExposureSettings:
    """What the manifest says of one photo's exposure; None where it says nothing."""

    exposure_s: float | None = None
    iso: float | None = None
    f_number: float | None = None


@dataclass(frozen=True, eq=False)
class Photo:
    """One photograph: its files, its posed camera, the name of its lighting.

    label : how the manifest names it, for messages and results.
    """

    label: str
    file: Path
    mask: Path | None
    camera: Camera
    lighting: str
    exposure: ExposureSettings
    held_out: bool


@dataclass(frozen=True, eq=False)
class PhotoSet:
    """A whole set, as the manifest gives it, with paths resolved and cameras posed.

    lightings : the tables of the manifest by their name; nothing of them is read yet.
    camera_files : the camera.json files that were read.
    """

    name: str
    manifest: Path
    radiometry: RadiometryTable
    object: ObjectTable
    lightings: tuple[LightingTable, ...]
    photos: tuple[Photo, ...]
    camera_files: tuple[Path, ...] = ()

    @property
    def folder(self) -> Path:
        return self.manifest.parent

    def resolve(self, path: str) -> Path:
        """A path of the manifest, relative to it, with environment variables filled in."""
        return resolve(self.manifest, path)


def load_photoset(path: Path) -> PhotoSet:
    """Read a photo set from its folder (or its `photoset.toml`); ValueError says what is wrong, where."""
    manifest_path = path / MANIFEST_NAME if path.is_dir() else path
    if not manifest_path.exists():
        what = "holds no photoset.toml" if path.is_dir() else "does not exist"
        raise ValueError(f"{path}: {what}; give the folder of a photo set (its format: README, 'Photo sets')")
    manifest = read_manifest(manifest_path)
    if not manifest.photo:
        raise ValueError(f"{manifest_path}: lists no [[photo]]")
    names = [table.name for table in manifest.lighting]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(
                f"{manifest_path}: two [[lighting]] tables are named {name!r}; names must differ"
            )
    labels = _labels(manifest_path, [table.file for table in manifest.photo])
    photos = tuple(
        _photo(manifest_path, manifest, names, table, label)
        for table, label in zip(manifest.photo, labels, strict=True)
    )
    return PhotoSet(
        name=manifest.name,
        manifest=manifest_path,
        radiometry=manifest.radiometry,
        object=manifest.object,
        lightings=manifest.lighting,
        photos=photos,
        camera_files=tuple(
            resolve(manifest_path, table.file)
            for table in (manifest.camera, *(photo.camera for photo in manifest.photo))
            if table is not None and table.file is not None
        ),
    )


def resolve(manifest: Path, path: str) -> Path:
    """`path` relative to the manifest's folder; `${NAME}` stands for an environment variable."""
    expanded = os.path.expandvars(os.path.expanduser(path))
    if "$" in expanded:
        raise ValueError(f"{manifest}: path {path!r} names an environment variable that is not set")
    return manifest.parent / expanded


def build_camera(
    manifest: Path, tables: Sequence[CameraTable | None], pose: np.ndarray, where: str
) -> Camera:
    """A camera from tables of which later ones override earlier ones key by key."""
    merged: dict[str, object] = {}
    for table in tables:
        if table is None:
            continue
        given = table.model_dump(exclude_none=True)
        if "file" in given:
            given = {**_camera_file(resolve(manifest, given["file"])), **given}
            del given["file"]
        merged |= given
    if merged.get("model") == "ORTHOGRAPHIC":
        merged.setdefault("params", ())
    for key in ("model", "params", "width", "height"):
        if key not in merged:
            raise ValueError(
                f"{manifest}: {where}: the camera lacks {key!r}; give it in [camera] or in the photo"
            )
    try:
        return Camera(world_to_camera=pose, **merged)  # type: ignore[arg-type]
    except ValueError as error:
        raise ValueError(f"{manifest}: {where}: {error}") from error


def _labels(manifest: Path, files: list[str]) -> list[str]:
    """A short name for each photo: its file's, or its whole path where two share a name."""
    for file in files:
        if files.count(file) > 1:
            raise ValueError(
                f'{manifest}: photo "{file}" is listed twice; every [[photo]] needs a file of its own'
            )
    names = [Path(file).name for file in files]
    return names if len(set(names)) == len(names) else files


def _photo(
    manifest_path: Path, manifest: Manifest, lightings: list[str], table: PhotoTable, label: str
) -> Photo:
    where = f'photo "{table.file}"'
    if table.lighting is None and len(lightings) > 1:
        raise ValueError(
            f"{manifest_path}: {where}: key 'lighting' is needed, because there are {len(lightings)}:"
            f" {', '.join(map(repr, lightings))}"
        )
    if table.lighting is not None and table.lighting not in lightings:
        raise ValueError(
            f"{manifest_path}: {where}: lighting {table.lighting!r} is not defined;"
            f" the [[lighting]] tables are {', '.join(map(repr, lightings)) or 'none'}"
        )
    pose = _pose(manifest_path, manifest.gantry, table, where)
    return Photo(
        label=label,
        file=resolve(manifest_path, table.file),
        mask=resolve(manifest_path, table.mask) if table.mask else None,
        camera=build_camera(manifest_path, (manifest.camera, table.camera), pose, where),
        lighting=table.lighting or (lightings[0] if lightings else ""),
        exposure=ExposureSettings(table.exposure_s, table.iso, table.f_number),
        held_out=table.held_out,
    )


def _pose(manifest: Path, gantry: GantryTable | None, table: PhotoTable, where: str) -> np.ndarray:
    if table.world_to_camera is not None:
        return matrix4(table.world_to_camera, f"{manifest}: {where}")
    if table.gantry_angle_deg is None:
        raise ValueError(
            f"{manifest}: {where} has no pose; give world_to_camera (4x4),"
            " or gantry_angle_deg with a [gantry] table"
        )
    if gantry is None:
        raise ValueError(f"{manifest}: {where} has gantry_angle_deg, but there is no [gantry] table")
    try:
        return arc_pose(
            np.radians(table.gantry_angle_deg), gantry.centre, gantry.axis, gantry.radius, gantry.start
        )
    except ValueError as error:
        raise ValueError(f"{manifest}: [gantry]: {error}") from error


def matrix4(rows: Matrix4, where: str) -> np.ndarray:
    """A manifest's matrix as an array, checked to be 4x4."""
    matrix = np.array(rows, float)
    if matrix.shape != (4, 4):
        raise ValueError(f"{where}: world_to_camera has {len(rows)} rows; it must be 4x4")
    return matrix


def _camera_file(path: Path) -> dict[str, object]:
    keys = ("model", "params", "width", "height")
    table = read_json(path, CameraTable, keys, f"a camera.json holds {', '.join(keys)}")
    return table.model_dump(exclude_none=True)
