"""A photo set: what was shot, with which camera, from where, under which light."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from capture.arc.gantry import Arc
from capture.camera import Camera, rigid_transform
from capture.exposure import ExposureSettings, check_alike, read_exif_exposure
from capture.files.documents import read_json
from capture.found import ALIGNMENT_NAME, POSES_NAME, Poses, read_alignment, read_poses
from capture.manifest import (
    ArcTable,
    CameraTable,
    GantryTable,
    LightingTable,
    Manifest,
    Matrix4,
    ObjectTable,
    PhotoTable,
    RadiometryTable,
    SourceTable,
    read_manifest,
)
from capture.radiometry import Radiometry, read_radiometry

MANIFEST_NAME = "photoset.toml"
_ARC_KEYS = ("centre", "axis", "radius", "start", "mount", "step_deg")
_ARC_FILE = f"a gantry.json holds {', '.join(_ARC_KEYS)}"


@dataclass(frozen=True, eq=False)
class Photo:
    """One photograph: its files, its posed camera, the name of its lighting.

    label : how the manifest names it, for messages and results. name : its file, as the manifest writes it.
    posed : false where nothing gives its pose, which only those may load who look for it; its camera then stands at
        the world's origin.
    """

    label: str
    name: str
    file: Path
    mask: Path | None
    camera: Camera
    lighting: str
    exposure: ExposureSettings
    held_out: bool
    posed: bool = True


@dataclass(frozen=True, eq=False)
class PhotoSet:
    """A whole set, as the manifest gives it, with paths resolved and cameras posed.

    lightings : the tables of the manifest by their name; nothing of them is read yet.
    calibration_files : the files of cameras, radiometry, arcs, poses and alignment that were read.
    mesh_to_world : (4, 4) rigid, from the mesh of [object] in metres; None where there is none, or nothing places it.
    """

    name: str
    manifest: Path
    radiometry: Radiometry
    object: ObjectTable
    lightings: tuple[LightingTable, ...]
    photos: tuple[Photo, ...]
    calibration_files: tuple[Path, ...] = ()
    mesh_to_world: np.ndarray | None = None

    @property
    def folder(self) -> Path:
        return self.manifest.parent

    def resolve(self, path: str) -> Path:
        """A path of the manifest, relative to it, with environment variables filled in."""
        return resolve(self.manifest, path)


def load_photoset(path: Path, *, find_poses: bool = False, find_alignment: bool = False) -> PhotoSet:
    """Read a photo set from its folder (or its `photoset.toml`); ValueError says what is wrong, where.

    find_poses : for who looks for the poses: only those of the manifest itself are read, and photos may lack one.
    find_alignment : for who looks for the mesh's place: only mesh_to_world of the manifest itself is read.
    """
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
    poses = None if find_poses else _found_poses(manifest_path, manifest)
    given = _poses(manifest_path, manifest, poses, find_poses)
    mesh_to_world, world_scale, alignment_files = _placement(
        manifest_path, manifest, poses, find_poses or find_alignment
    )
    photos = []
    for table, label, pose in zip(manifest.photo, labels, given, strict=True):
        if pose is not None:
            pose = pose.copy()
            pose[:3, 3] *= world_scale
        photos.append(_photo(manifest_path, manifest, names, table, label, pose))
    if manifest.radiometry.exposure != "equal":
        _check_exposures(manifest_path, manifest, photos)
    light_arc = _arc(manifest_path, "light_arc", manifest.light_arc)
    target = np.array(manifest.object.centre or (0.0, 0.0, 0.0))
    found_files = ([] if poses is None else [poses.path]) + alignment_files
    return PhotoSet(
        name=manifest.name,
        manifest=manifest_path,
        radiometry=_radiometry(manifest_path, manifest.radiometry, [photo.file for photo in photos]),
        object=manifest.object,
        lightings=tuple(
            _with_directions(manifest_path, light_arc, target, table) for table in manifest.lighting
        ),
        photos=tuple(photos),
        calibration_files=(*_calibration_files(manifest_path, manifest), *found_files),
        mesh_to_world=mesh_to_world,
    )


def _found_poses(manifest_path: Path, manifest: Manifest) -> Poses | None:
    """Registered poses: those that the manifest names, or that lie beside it where a photo has none of its own."""
    if manifest.poses is not None:
        return read_poses(resolve(manifest_path, manifest.poses))
    path = manifest_path.parent / POSES_NAME
    lacking = any(
        table.world_to_camera is None and table.gantry_angle_deg is None for table in manifest.photo
    )
    return read_poses(path) if lacking and path.is_file() else None


def _placement(
    manifest_path: Path, manifest: Manifest, poses: Poses | None, only_given: bool
) -> tuple[np.ndarray | None, float, list[Path]]:
    """mesh_to_world (4, 4) or None, the factor on cameras' positions, and the files that told."""
    table = manifest.object
    if table.mesh is None:
        return None, 1.0, []
    if table.mesh_to_world is not None:
        try:
            return rigid_transform(table.mesh_to_world, "mesh_to_world"), 1.0, []
        except ValueError as error:
            raise ValueError(f"{manifest_path}: [object]: {error}") from error
    if only_given:
        return None, 1.0, []
    path = manifest_path.parent / ALIGNMENT_NAME
    if path.is_file():
        files = {"mesh": resolve(manifest_path, table.mesh)}
        if poses is not None:
            files["poses"] = poses.path
        alignment = read_alignment(path, files)
        return alignment.mesh_to_world, alignment.world_scale, [path]
    if table.align is not None:
        raise ValueError(
            f"{manifest_path}: [object] align = {table.align!r}, but the mesh has not been aligned yet:"
            f" run `lightfactor align {manifest_path.parent}`"
        )
    return np.eye(4), 1.0, []


def _radiometry(manifest: Path, table: RadiometryTable, photos: Sequence[Path]) -> Radiometry:
    try:
        return read_radiometry(table, lambda name: resolve(manifest, name), photos)
    except ValueError as error:
        raise error if str(manifest) in str(error) else ValueError(f"{manifest}: {error}") from error


def _check_exposures(manifest_path: Path, manifest: Manifest, photos: Sequence[Photo]) -> None:
    """ValueError if ISO or f-number are known of some photos only, mirror balls' among them."""
    shots = [(photo.file, photo.exposure) for photo in photos]
    for table in manifest.lighting:
        for view in (table.mirror_ball.views or (table.mirror_ball,)) if table.mirror_ball else ():
            given = ExposureSettings(None, view.iso, view.f_number)
            shots += [(resolve(manifest_path, name), given) for name in view.photo]
    shots = [
        (path, given) for path, given in shots if path.is_file()
    ]  # a missing file is named when it is read
    if manifest.radiometry.exposure == "exif":
        shots = [(path, given.completed(read_exif_exposure(path))) for path, given in shots]
    check_alike([path for path, _ in shots], [given for _, given in shots])


def _calibration_files(manifest_path: Path, manifest: Manifest) -> tuple[Path, ...]:
    cameras = [manifest.camera, *(photo.camera for photo in manifest.photo)]
    named = [
        *(camera.file for camera in cameras if camera is not None),
        manifest.radiometry.file,
        manifest.radiometry.noise,
        manifest.radiometry.flat_field,
        *(arc.file for arc in (manifest.gantry, manifest.light_arc) if arc is not None),
    ]
    return tuple(resolve(manifest_path, name) for name in named if name is not None)


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
    manifest_path: Path,
    manifest: Manifest,
    lightings: list[str],
    table: PhotoTable,
    label: str,
    pose: np.ndarray | None,
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
    cameras = (manifest.camera, table.camera)
    return Photo(
        label=label,
        name=table.file,
        file=resolve(manifest_path, table.file),
        mask=resolve(manifest_path, table.mask) if table.mask else None,
        camera=build_camera(manifest_path, cameras, np.eye(4) if pose is None else pose, where),
        lighting=table.lighting or (lightings[0] if lightings else ""),
        exposure=ExposureSettings(table.exposure_s, table.iso, table.f_number),
        held_out=table.held_out,
        posed=pose is not None,
    )


def _poses(
    manifest_path: Path, manifest: Manifest, registered: Poses | None, may_lack: bool
) -> list[np.ndarray | None]:
    """The photos' poses, (4, 4) each; None where nothing gives one, which is an error unless they may lack one."""
    gantry = _arc(manifest_path, "gantry", manifest.gantry)
    poses: list[np.ndarray | None] = []
    stops = 0
    for table in manifest.photo:
        # Registered poses that the manifest names stand before all others: they were asked for.
        if registered is not None and manifest.poses is not None:
            poses.append(registered.of(table.file))
            continue
        try:
            pose = _pose(manifest_path, gantry, table, stops, registered)
        except ValueError:
            if not may_lack or table.world_to_camera is not None or table.gantry_angle_deg is not None:
                raise
            pose = None
        poses.append(pose)
        stops += table.world_to_camera is None
    return poses


def _pose(
    manifest: Path, gantry: Arc | None, table: PhotoTable, stop: int, registered: Poses | None
) -> np.ndarray:
    """The pose of a photo; stop : how many photos before it stand on the gantry."""
    where = f'photo "{table.file}"'
    if table.world_to_camera is not None:
        return matrix4(table.world_to_camera, f"{manifest}: {where}")
    if table.gantry_angle_deg is not None:
        if gantry is None:
            raise ValueError(f"{manifest}: {where} has gantry_angle_deg, but there is no [gantry] table")
        return gantry.pose(np.radians(table.gantry_angle_deg))
    if registered is not None:
        return registered.of(table.file)
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


def _arc(manifest: Path, name: str, table: ArcTable | None) -> Arc | None:
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


def _with_directions(
    manifest: Path, arc: Arc | None, target: np.ndarray, table: LightingTable
) -> LightingTable:
    """A lighting whose sources on the light arc have the direction from the object to their place on it."""
    sources = []
    for source in table.directional:
        if source.arc_angle_deg is None:
            sources.append(source)
            continue
        if arc is None:
            raise ValueError(
                f'{manifest}: [[lighting]] "{table.name}" has arc_angle_deg, but there is no [light_arc] table'
            )
        direction = arc.position(np.radians(source.arc_angle_deg)) - target
        sources.append(SourceTable(direction=tuple(direction.tolist()), irradiance=source.irradiance))
    return table.model_copy(update={"directional": tuple(sources)})


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
