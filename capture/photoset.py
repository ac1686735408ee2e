"""A photo set: what was shot, with which camera, from where, under which light."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from capture.arc.gantry import Arc
from capture.calibrationerrors import (
    NO_ERRORS,
    CalibrationErrors,
    check_lens_covariance,
    lens_errors,
    pose_errors,
    read_lens_covariance,
    stated_pose,
)
from capture.camera import Camera
from capture.exposure import ExposureSettings, check_alike, read_exif_exposure
from capture.files.documents import read_json
from capture.found import Alignment, Poses
from capture.manifest import (
    CameraTable,
    LightingTable,
    Manifest,
    ObjectTable,
    PhotoTable,
    RadiometryTable,
    SourceTable,
    read_manifest,
    resolve,
)
from capture.photo import Photo
from capture.placing import mesh_placement, photo_poses, read_arc, registered_poses, takes_registered
from capture.polarisation import Extinction, polariser_of, read_extinction
from capture.radiometry import Radiometry, read_radiometry
from capture.reference import balance, check_references, see_references
from capture.referencetable import ReferenceTable

MANIFEST_NAME = "photoset.toml"
# What the light is called of which a manifest says nothing.
UNNAMED = "lighting"
# What a manifest says of normals that are to be found.
UNKNOWN_NORMALS = "unknown"


@dataclass(frozen=True, eq=False)
class PhotoSet:
    """A whole set, as the manifest gives it, with paths resolved and cameras posed.

    lightings : the tables of the manifest by their name, or one that is unknown where it has none; nothing of them is
        read yet.
    calibration_files : the files of cameras, radiometry, arcs, poses and alignment that were read.
    mesh_to_world : (4, 4) rigid, from the mesh of [object] in metres; None where there is none, or nothing places it.
    own_frame : whether the poses were registered in a frame of their own, which light directions can't know of.
    errors : how far off poses, lenses and mesh may be.
    direction_std_deg : of directions that the manifest gives of sources, in any direction across; 0 if they are exact.
    extinction : of the filters that all photographs were taken through; None without.
    references : the tables of what in photographs is of known reflectance.
    """

    name: str
    manifest: Path
    radiometry: Radiometry
    object: ObjectTable
    lightings: tuple[LightingTable, ...]
    photos: tuple[Photo, ...]
    calibration_files: tuple[Path, ...] = ()
    mesh_to_world: np.ndarray | None = None
    own_frame: bool = False
    errors: CalibrationErrors = NO_ERRORS
    direction_std_deg: float = 0.0
    extinction: Extinction | None = None
    references: tuple[ReferenceTable, ...] = ()

    @property
    def folder(self) -> Path:
        return self.manifest.parent

    @property
    def fitted(self) -> tuple[Photo, ...]:
        """The photographs that are fitted."""
        return tuple(photo for photo in self.photos if not photo.held_out)

    @property
    def held_out(self) -> tuple[Photo, ...]:
        """Those that only score predictions."""
        return tuple(photo for photo in self.photos if photo.held_out)

    @property
    def files(self) -> tuple[Path, ...]:
        """Every file that the set is made of, the manifest first; each once."""
        paths = [self.manifest, *self.calibration_files]
        paths += [self.resolve(self.object.mesh)] if self.object.mesh else []
        if self.object.normals not in (None, UNKNOWN_NORMALS):
            paths += [self.resolve(self.object.normals)]
        paths += [file for photo in self.photos for file in (photo.file, photo.mask) if file is not None]
        for table in self.lightings:
            named = (table.map, *(table.mirror_ball.files if table.mirror_ball else ()))
            paths += [self.resolve(name) for name in named if name is not None]
        return tuple(dict.fromkeys(paths))

    def with_extinction(self, extinction: Extinction) -> PhotoSet:
        """The same set, its filters of another extinction."""
        photos = [
            photo
            if photo.polariser is None
            else replace(photo, polariser=replace(photo.polariser, extinction=extinction.value))
            for photo in self.photos
        ]
        errors = replace(self.errors, extinction=extinction.std)
        return replace(self, photos=tuple(photos), errors=errors, extinction=extinction)

    def resolve(self, path: str) -> Path:
        """A path of the manifest, relative to it, with environment variables filled in."""
        return resolve(self.manifest, path)


def check_present(path: Path) -> PhotoSet:
    """A photo set, loaded; ValueError if a file of it is missing, before anything is computed."""
    photoset = load_photoset(path)
    missing = [file for file in photoset.files if not file.exists()]
    if missing:
        others = f"; {len(missing) - 1} of the set's other files are missing, too" if len(missing) > 1 else ""
        raise ValueError(
            f"{missing[0]}: does not exist; check its name, and the folder that it is relative to{others}"
        )
    return photoset


def load_photoset(path: Path, *, find_poses: bool = False, find_alignment: bool = False) -> PhotoSet:
    """Read a photo set from its folder (or its `photoset.toml`); ValueError says what is wrong, where.

    find_poses : for who looks for the poses: only those of the manifest itself are read, and photos may lack one.
    find_alignment : for who looks for the mesh's place: only mesh_to_world of the manifest itself is read.
    """
    manifest_path = path / MANIFEST_NAME if path.is_dir() else path
    if not manifest_path.exists():
        what = "holds no photoset.toml" if path.is_dir() else "does not exist"
        raise ValueError(
            f"{path}: {what}; give the folder of a photo set (docs/photosets.md describes its format)"
        )
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
    poses = None if find_poses else registered_poses(manifest_path, manifest)
    given = photo_poses(manifest_path, manifest, poses, find_poses)
    placement, alignment_files = mesh_placement(manifest_path, manifest, poses, find_poses or find_alignment)
    world_scale = 1.0 if placement is None else placement.world_scale
    photos, extinction = [], read_extinction(manifest_path, manifest)
    for table, label, pose in zip(manifest.photo, labels, given, strict=True):
        if pose is not None:
            pose = pose.copy()
            pose[:3, 3] *= world_scale
        photos.append(_photo(manifest_path, manifest, names, table, label, pose, extinction))
    if manifest.radiometry.exposure != "equal":
        _check_exposures(manifest_path, manifest, photos)
    light_arc = read_arc(manifest_path, "light_arc", manifest.light_arc)
    target = np.array(manifest.object.centre or (0.0, 0.0, 0.0))
    found_files = ([] if poses is None else [poses.path]) + alignment_files
    check_references(manifest_path, manifest)
    radiometry = _radiometry(manifest_path, manifest.radiometry, [photo.file for photo in photos])
    if manifest.radiometry.white_balance == "reference":
        (first,) = see_references(manifest_path, manifest.reference[:1], photos, radiometry)
        radiometry = replace(radiometry, white_balance=balance(first))
    errors = replace(
        _errors(manifest_path, manifest, photos, poses, placement),
        color=None if radiometry.color is None else radiometry.color.relative_covariance,
        extinction=0.0 if extinction is None else extinction.std,
    )
    return PhotoSet(
        name=manifest.name,
        manifest=manifest_path,
        radiometry=radiometry,
        object=manifest.object,
        lightings=tuple(
            _with_directions(manifest_path, light_arc, target, table)
            for table in manifest.lighting or (LightingTable(name=UNNAMED, unknown=True),)
        ),
        photos=tuple(photos),
        calibration_files=(*_calibration_files(manifest_path, manifest), *found_files),
        mesh_to_world=None if placement is None else placement.mesh_to_world,
        own_frame=poses is not None and poses.own_frame,
        errors=errors,
        direction_std_deg=manifest.uncertainty.direction_deg or 0.0,
        extinction=extinction,
        references=manifest.reference,
    )


def _errors(
    manifest_path: Path,
    manifest: Manifest,
    photos: Sequence[Photo],
    poses: Poses | None,
    placement: Alignment | None,
) -> CalibrationErrors:
    """How far off poses, lenses and mesh may be, as the manifest and calibrations say."""
    given = manifest.uncertainty
    if given.height and manifest.object.shape != "mesh":
        raise ValueError(
            f"{manifest_path}: [uncertainty] height is of a mesh's vertices, but [object] shape is"
            f" {manifest.object.shape!r}: remove it"
        )
    cameras = {photo.label: photo.camera for photo in photos}
    scaled = np.repeat([1.0, 1.0 if placement is None else placement.world_scale], 3)
    of_poses: dict[str, np.ndarray | None] = {}
    of_lenses: dict[str, np.ndarray | None] = {}
    files: dict[Path, np.ndarray | None] = {}
    for photo, table in zip(photos, manifest.photo, strict=True):
        own = None
        if poses is not None and takes_registered(manifest, table):
            own = poses.covariances.get(table.file)
        of_poses[photo.label] = None if own is None else own * np.outer(scaled, scaled)
        file = (
            manifest.camera.file if table.camera is None or table.camera.file is None else table.camera.file
        )
        if file is not None:
            path = resolve(manifest_path, file)
            if path not in files:
                files[path] = read_lens_covariance(path)
            covariance = files[path]
            if covariance is not None:
                check_lens_covariance(path, covariance, photo.camera.params)
            of_lenses[photo.label] = covariance
    return CalibrationErrors(
        pose_errors(cameras, of_poses),
        stated_pose(given.rotation_deg, given.position),
        lens_errors(cameras, of_lenses, given.focal_length),
        None if placement is None else placement.covariance,
        given.height or 0.0,
        given.height_correlation or 0.0,
        any(given.model_dump(exclude_none=True).values()),
    )


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
        manifest.radiometry.color,
        *(arc.file for arc in (manifest.gantry, manifest.light_arc) if arc is not None),
    ]
    return tuple(resolve(manifest_path, name) for name in named if name is not None)


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
    extinction: Extinction | None,
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
        lighting=table.lighting or (lightings[0] if lightings else UNNAMED),
        exposure=ExposureSettings(table.exposure_s, table.iso, table.f_number),
        held_out=table.held_out,
        posed=pose is not None,
        polariser=polariser_of(table.polarisation, manifest.polarisation, extinction),
    )


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


def _camera_file(path: Path) -> dict[str, object]:
    keys = ("model", "params", "width", "height")
    table = read_json(path, CameraTable, keys, f"a camera.json holds {', '.join(keys)}")
    return table.model_dump(exclude_none=True)
