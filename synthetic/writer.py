"""A photo set on disk, photographed as staged, with the truth beside it.

photoset.toml, photographs, masks, lighting maps and the mesh are what a photographer would hand over, faults and all.
truth.json and the folder truth/ hold what nobody could know: parameters, poses, photographs without noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion

from capture.boards.board import parse_board
from capture.files.documents import write_json
from capture.files.imagefile import read_pixels, write_exr
from capture.photoset import MANIFEST_NAME
from recon.mesh.trianglemesh import write_mesh
from synthetic.faults import with_background, with_outliers
from synthetic.given import given_mesh, given_place, given_poses
from synthetic.lights.illumination import Illumination, latlong_map
from synthetic.manifest import Photograph, WrittenSet, manifest_text
from synthetic.materials.texture import Textured
from synthetic.mirrorball import write_mirror_balls
from synthetic.render.photograph import Progress, Tile, photographs
from synthetic.sensing.autoexposure import choose_exposure, object_brightness
from synthetic.sensing.calibrationshots import write_calibration_shots
from synthetic.sensing.development import Development, write_photograph
from synthetic.sensing.masks import write_mask
from synthetic.sensing.radiometryfiles import RADIOMETRY_FILES, write_radiometry
from synthetic.sensing.room import room_background
from synthetic.staging import Staging
from synthetic.truth import integration_error, truth_document

Floats = NDArray[np.float64]

TRUTH_NAME = "truth.json"
SCENE_NAME = "scene.toml"
CONTACT_NAME = "contact.png"
MESH_NAME = "object.obj"
# Names that a written set holds; the first is in every one.
PHOTOSET_FILES = (
    MANIFEST_NAME,
    TRUTH_NAME,
    SCENE_NAME,
    MESH_NAME,
    f"{Path(MESH_NAME).stem}.transfer.npz",
    "truth",
    "mirrorball",
    "calibration",
    *(f"*{ending}" for ending in (".exr", ".png", ".tif", ".jpg", ".dng")),
    *RADIOMETRY_FILES,
)
_MAP_HEIGHT = 128
# What random numbers are for: each use has a stream of its own, so that none changes another's. Others are in `given`.
_PHOTOGRAPHS, _CALIBRATION, _ROOM_LOOK = 4, 5, 6
# Pixels by which the integration is judged, of each of so many photographs.
_JUDGED_PIXELS, _JUDGED_PHOTOS = 48, 12
# Side of the room behind the object, in largest distances of a camera.
_ROOM = 4.0


def write_photoset(staging: Staging, folder: Path, progress: Progress | None = None) -> None:
    """Photograph a scene into a folder, made if missing; files of the same names are replaced.

    progress : called with the steps of the work and a description; iterates over what it returns.
    The bytes depend on nothing but the staging.
    """
    (folder / "truth").mkdir(parents=True, exist_ok=True)
    scene = staging.scene
    taken, judged = _write_photographs(staging, folder, progress)
    written = WrittenSet(
        maps=_write_maps(scene.illuminations, folder),
        balls=write_mirror_balls(staging, folder, progress),
        poses=given_poses(staging),
        mesh_to_world=None if staging.mesh is None else given_place(staging),
        radiometry=_write_radiometry(staging, folder),
        photographs=taken,
    )
    _write_mesh(staging, folder)
    calibration = _write_calibration(staging, folder, progress)
    error = integration_error(scene, judged)
    write_json(folder / TRUTH_NAME, truth_document(staging, written, calibration, error))
    if staging.source:
        (folder / SCENE_NAME).write_text(staging.source, encoding="utf-8")
    # Last: a folder without a manifest isn't taken for a whole set.
    (folder / MANIFEST_NAME).write_text(manifest_text(staging, written, MESH_NAME), encoding="utf-8")


def _write_maps(illuminations: Sequence[Illumination], folder: Path) -> dict[str, str]:
    """Lat-long maps of the extended lights, by the lighting's name; those that the set leaves out go to truth/."""
    maps = {}
    for illumination in illuminations:
        if illumination.extended:
            stem = "lighting" if len(illuminations) == 1 else f"lighting-{illumination.name}"
            name = f"{stem}.exr" if illumination.given in ("all", "distant") else f"truth/{stem}.exr"
            write_exr(folder / name, latlong_map(illumination.extended, _MAP_HEIGHT))
            maps[illumination.name] = name
    return maps


def _write_mesh(staging: Staging, folder: Path) -> None:
    """Write the mesh as it is handed over, and if that isn't the true one, the true one."""
    mesh = staging.mesh
    if mesh is None:
        return
    handed = given_mesh(staging, mesh)
    if handed is not mesh:
        write_mesh(folder / "truth" / MESH_NAME, mesh)
    write_mesh(folder / MESH_NAME, handed)
    if isinstance(staging.scene.material, Textured):
        write_exr(folder / "truth" / "texture_kd.exr", staging.scene.material.kd_map)
        write_exr(folder / "truth" / "texture_ks.exr", staging.scene.material.ks_map)


def _write_radiometry(staging: Staging, folder: Path) -> dict[str, Any]:
    if not isinstance(staging.sensor, Development):
        return {"encoding": "linear", "exposure": "equal"}
    camera = staging.scene.shots[0].camera
    return write_radiometry(folder, staging.sensor, camera.width, camera.height)


def _write_photographs(
    staging: Staging, folder: Path, progress: Progress | None
) -> tuple[list[Photograph], list[Tile]]:
    """Photographs and masks, and pixels by which the integration is to be judged.

    The radiance before the sensor goes to truth/, from where it is developed: all of it must be known to choose an
    exposure, and a photograph at a time is enough to hold.
    """
    scene, sensor = staging.scene, staging.sensor
    brightness, levels = [], []
    for index, (radiance, coverage) in enumerate(photographs(scene, progress)):
        write_exr(folder / "truth" / f"{index:03d}.exr", radiance.astype(np.float32))
        write_mask(folder / _mask_name(index), coverage)
        levels.append(float(radiance.sum() / (3 * coverage.sum())))
        if isinstance(sensor, Development):
            brightness.append(object_brightness(radiance, coverage, sensor.sensor))
    exposure_s = choose_exposure(brightness, sensor) if isinstance(sensor, Development) else 1.0
    # The room is about as bright as the object: a constant of the set.
    level = float(np.mean(levels))
    taken: list[Photograph] = []
    judged: list[Tile] = []
    stride = -(-len(scene.shots) // _JUDGED_PHOTOS)
    for index in range(len(scene.shots)):
        rng = np.random.default_rng([scene.seed, _PHOTOGRAPHS, index])
        radiance = read_pixels(folder / "truth" / f"{index:03d}.exr").astype(float)
        coverage = read_pixels(folder / _mask_name(index))[..., 0].astype(float) / 255
        if index % stride == 0:
            judged.append(_sample(index, coverage, rng))
        seen = with_background(radiance, coverage, _background(staging, index, level))
        if staging.faults.outliers:
            seen, spoilt = with_outliers(seen, coverage, staging.faults.outliers, rng)
            write_mask(folder / "truth" / f"{index:03d}_outliers.png", spoilt)
        stem = folder / f"{index:03d}"
        if isinstance(sensor, Development):
            shots = write_photograph(stem, seen, exposure_s, sensor, rng)
            given = sensor.exposure == "manual"
            taken += [
                Photograph(index, shot.file, _mask_name(index), shot.exposure_s if given else None)
                for shot in shots
            ]
        else:
            write_exr(stem.with_suffix(".exr"), sensor.applied(seen, coverage, rng))
            taken.append(Photograph(index, f"{stem.name}.exr", _mask_name(index), None))
    return taken, judged


def _sample(index: int, coverage: Floats, rng: np.random.Generator) -> Tile:
    """Some pixels of a photograph that the object fills, their neighbours included; or else some that it is in.

    At its very outline RH01's lobe grows without bound: what a pixel there holds depends on where it is looked at.
    """
    full = binary_erosion(coverage == 1, np.ones((3, 3)))
    rows, columns = np.nonzero(full if full.any() else coverage)
    chosen = np.sort(rng.choice(len(rows), min(_JUDGED_PIXELS, len(rows)), replace=False))
    return Tile(index, 0, np.column_stack([columns, rows])[chosen])


def _background(staging: Staging, index: int, level: float) -> Floats:
    """What stands behind the object in a photograph: (3,), or (h, w, 3)."""
    background = staging.faults.background
    if background == "black":
        return np.zeros(3)
    if isinstance(background, str):
        scene, camera = staging.scene, staging.scene.shots[index].camera
        centres = [shot.camera.centre - scene.surface.centre for shot in scene.shots]
        side = _ROOM * max(float(np.abs(centre).max()) for centre in centres)
        return room_background(camera, scene.surface.centre, side, level, [scene.seed, _ROOM_LOOK])
    return np.array(background)


def _mask_name(index: int) -> str:
    return f"{index:03d}_mask.png"


def _write_calibration(staging: Staging, folder: Path, progress: Progress | None) -> dict[str, Any] | None:
    table, sensor, scene = staging.calibration, staging.sensor, staging.scene
    if table is None or not isinstance(sensor, Development):
        return None
    rng = np.random.default_rng([scene.seed, _CALIBRATION])
    (folder / "calibration").mkdir(exist_ok=True)
    return write_calibration_shots(
        folder / "calibration",
        scene.shots[0].camera,
        sensor,
        parse_board(table.board),
        rng,
        table.boards,
        progress,
    )
