"""Where the photographs of a set were taken from, and where its mesh lies: as manifest, gantry and registration say."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from capture.arc.gantry import Arc
from capture.camera import rigid_transform
from capture.files.documents import read_json
from capture.files.tables import Matrix4
from capture.found import ALIGNMENT_NAME, POSES_NAME, Alignment, Poses, read_alignment, read_poses
from capture.manifest import ArcTable, GantryTable, Manifest, PhotoTable, resolve

_ARC_KEYS = ("centre", "axis", "radius", "start", "mount", "step_deg")
_ARC_FILE = f"a gantry.json holds {', '.join(_ARC_KEYS)}"


def registered_poses(manifest_path: Path, manifest: Manifest) -> Poses | None:
    """Registered poses: those that the manifest names, or that lie beside it where a photo has none of its own."""
    if manifest.poses is not None:
        return read_poses(resolve(manifest_path, manifest.poses))
    path = manifest_path.parent / POSES_NAME
    lacking = any(
        table.world_to_camera is None and table.gantry_angle_deg is None for table in manifest.photo
    )
    return read_poses(path) if lacking and path.is_file() else None


def photo_poses(
    manifest_path: Path, manifest: Manifest, registered: Poses | None, may_lack: bool
) -> list[np.ndarray | None]:
    """The photos' poses, (4, 4) each; None where nothing gives one, which is an error unless they may lack one."""
    gantry = read_arc(manifest_path, "gantry", manifest.gantry)
    poses: list[np.ndarray | None] = []
    stops = 0
    for table in manifest.photo:
        if registered is not None and takes_registered(manifest, table):
            poses.append(registered.of(table.file))
            continue
        try:
            pose = _pose(manifest_path, gantry, table, stops)
        except ValueError:
            if not may_lack or table.world_to_camera is not None or table.gantry_angle_deg is not None:
                raise
            pose = None
        poses.append(pose)
        stops += table.world_to_camera is None
    return poses


def takes_registered(manifest: Manifest, table: PhotoTable) -> bool:
    """Whether a photo's pose is the registered one, if there is any.

    Registered poses that the manifest names stand before all others: they were asked for.
    """
    return manifest.poses is not None or (table.world_to_camera is None and table.gantry_angle_deg is None)


def mesh_placement(
    manifest_path: Path, manifest: Manifest, poses: Poses | None, only_given: bool
) -> tuple[Alignment | None, list[Path]]:
    """Where the mesh lies, None where nothing says so, and the files that gave it.

    only_given : what was found by `lightfactor align` doesn't count.
    """
    table = manifest.object
    if table.mesh is None:
        return None, []
    if table.mesh_to_world is not None:
        try:
            return Alignment(rigid_transform(table.mesh_to_world, "mesh_to_world"), 1.0, None), []
        except ValueError as error:
            raise ValueError(f"{manifest_path}: [object]: {error}") from error
    if only_given:
        return None, []
    path = manifest_path.parent / ALIGNMENT_NAME
    if path.is_file():
        files = {"mesh": resolve(manifest_path, table.mesh)}
        if poses is not None:
            files["poses"] = poses.path
        return read_alignment(path, files), [path]
    if table.align is not None:
        raise ValueError(
            f"{manifest_path}: [object] align = {table.align!r}, but the mesh has not been aligned yet:"
            f" run `lightfactor align {manifest_path.parent}`"
        )
    return Alignment(np.eye(4), 1.0, None), []


def read_arc(manifest: Path, name: str, table: ArcTable | None) -> Arc | None:
    """The arc of a [gantry] or [light_arc] table, from the file that it names or its own keys."""
    if table is None:
        return None
    step = table.step_deg if isinstance(table, GantryTable) else None
    if table.file is not None:
        table = read_json(resolve(manifest, table.file), GantryTable, _ARC_KEYS, _ARC_FILE)
        step = table.step_deg if step is None else step
    mount = table.mount if isinstance(table, GantryTable) else np.eye(3)
    try:
        return Arc(
            centre=np.array(table.centre),
            axis=np.array(table.axis),
            radius=table.radius or 0.0,
            start=np.array(table.start),
            mount=np.array(mount),
            step=None if step is None else float(np.radians(step)),
        )
    except ValueError as error:
        raise ValueError(f"{manifest}: [{name}]: {error}") from error


def matrix4(rows: Matrix4, where: str) -> np.ndarray:
    """A manifest's matrix as an array, checked to be 4x4."""
    matrix = np.array(rows, float)
    if matrix.shape != (4, 4):
        raise ValueError(f"{where}: world_to_camera has {len(rows)} rows; it must be 4x4")
    return matrix


def _pose(manifest: Path, gantry: Arc | None, table: PhotoTable, stop: int) -> np.ndarray:
    """The pose that a manifest gives of a photo; stop : how many photos before it stand on the gantry."""
    where = f'photo "{table.file}"'
    if table.world_to_camera is not None:
        return matrix4(table.world_to_camera, f"{manifest}: {where}")
    if table.gantry_angle_deg is not None:
        if gantry is None:
            raise ValueError(f"{manifest}: {where} has gantry_angle_deg, but there is no [gantry] table")
        return gantry.pose(np.radians(table.gantry_angle_deg))
    if gantry is not None and gantry.step is not None:
        return gantry.pose(stop * gantry.step)
    if gantry is None:
        raise ValueError(
            f"{manifest}: {where} has no pose; give world_to_camera (4x4), or gantry_angle_deg with a [gantry] table,"
            f" or let `lightfactor register {manifest.parent}` find the poses"
        )
    raise ValueError(
        f"{manifest}: {where} has no pose; give gantry_angle_deg, or step_deg in [gantry] if the photos"
        " were taken at equal steps in the order listed"
    )
