"""Photographs of a mirror ball as a user names them: grouped to views, decoded, posed and read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture.camera import ORTHOGRAPHIC, Camera
from capture.decode import check_size, decode, read_mask
from capture.exposure import bracket_exposures, read_exif_exposure, read_times, relative_exposure
from capture.files.documents import read_json
from capture.files.tables import Matrix4, Table
from capture.manifest import CameraTable
from capture.photoset import build_camera
from capture.placing import matrix4
from capture.radiance import RadianceImage
from capture.terminal import track
from recon.mirrorball.bracket import view_bracket
from recon.mirrorball.figure import panel
from recon.mirrorball.light import ball_lighting
from recon.mirrorball.result import BallShot, Reading
from recon.mirrorball.view import BallView
from recon.sphere.circle import Disk

Floats = NDArray[np.float64]

# The world in which a level camera looks at the ball: x right, y up, z towards the camera.
UPRIGHT = np.diag([1.0, -1.0, -1.0, 1.0])


class PosesTable(Table):
    """What --poses holds."""

    world_to_camera: tuple[Matrix4, ...]


@dataclass(frozen=True)
class Setup:
    """What all photographs share, as the options give it. times : exposure times in seconds, or a file of them."""

    camera: Path | None
    focal_px: float | None
    encoding: str
    response: Path | None
    exposure: str
    times: str | None
    reflectance: tuple[float, float, float]
    camera_mask_deg: float


def group(
    photos: Sequence[Path],
    bracket: int,
    masks: Sequence[Path],
    balls: Sequence[str],
    backgrounds: Sequence[Path],
) -> list[BallShot]:
    """The views, each of `bracket` consecutive photos; masks, balls and backgrounds are one for all, or one each."""
    if len(photos) % bracket:
        raise ValueError(
            f"{len(photos)} photos cannot be brackets of {bracket}: give as many photos for each view, in order"
        )
    views = [tuple(photos[k : k + bracket]) for k in range(0, len(photos), bracket)]
    noun = "views" if bracket > 1 else "photos"
    disks = [read_disk(text) for text in balls]
    each = [
        _each(given, len(views), what, noun)
        for given, what in ((masks, "masks"), (disks, "balls"), (backgrounds, "backgrounds"))
    ]
    stems = [view[0].stem for view in views]
    for stem in stems:
        if stems.count(stem) > 1:
            raise ValueError(f"two photos are named {stem!r}, and so would their maps be: rename one of them")
    return [BallShot(*entry) for entry in zip(views, *each, strict=True)]


def read_disk(text: str) -> Disk:
    """A circle as a user writes it: column, row and radius in pixels, "756,548,72"."""
    try:
        x, y, radius = (float(part) for part in text.split(","))
    except ValueError:
        raise ValueError(
            f"--ball {text}: must be column, row and radius in pixels, as in 756,548,72"
        ) from None
    if not (np.isfinite([x, y]).all() and 0 < radius < np.inf):
        raise ValueError(f"--ball {text}: the radius must be above 0 pixels, and all three finite")
    return Disk(x, y, radius)


def read_reflectance(text: str) -> tuple[float, float, float]:
    """A reflectance as a user writes it, one number or three: "0.6" or "0.55,0.56,0.58"."""
    try:
        shares = [float(part) for part in text.split(",")]
    except ValueError:
        shares = []
    if len(shares) not in (1, 3) or not all(0 < share <= 1 for share in shares):
        raise ValueError(f"--reflectance {text}: must be one number, or R,G,B, above 0 and at most 1")
    red, green, blue = shares if len(shares) == 3 else shares * 3
    return red, green, blue


def view_poses(count: int, angles: str | None, file: Path | None) -> list[Floats] | None:
    """world_to_camera (4, 4) of each view, from angles in degrees or a file; None if neither is given."""
    if angles is not None:
        try:
            turns = [float(part) for part in angles.split(",")]
        except ValueError:
            turns = [np.nan]
        if not np.isfinite(turns).all():
            raise ValueError(f"--view-angle-deg {angles}: must be angles in degrees, as in 0,90")
        _as_many(len(turns), count, f"--view-angle-deg {angles}: {len(turns)} angles")
        return [UPRIGHT @ _about_y(-np.radians(turn)) for turn in turns]
    if file is not None:
        what = 'a file of poses holds {"world_to_camera": [4x4 matrix, ...]}'
        table = read_json(file, PosesTable, ["world_to_camera"], what)
        _as_many(len(table.world_to_camera), count, f"{file}: {len(table.world_to_camera)} poses")
        return [matrix4(rows, f"{file}: pose {k + 1}") for k, rows in enumerate(table.world_to_camera)]
    return None


def read(
    shots: Sequence[BallShot], setup: Setup, poses: Sequence[Floats] | None, register: bool, height: int
) -> Reading:
    """Decode and read all views, and merge them if their poses are given or to be found."""
    exposures = _exposures(shots, setup)
    if len(shots) < 2 and (register or poses is not None) and not (poses is not None and len(poses) == 1):
        raise ValueError(f"{shots[0].photos[0]}: is one view only; merging takes at least two")
    views: list[BallView] = []
    panels = []
    for index, shot in enumerate(track(shots, "Reading mirror balls")):
        pose = UPRIGHT if poses is None else poses[index]
        view, image = _view(shot, setup, exposures[index], pose)
        views.append(view)
        panels.append(panel(view, image))
    turns = None
    if register:
        from recon.mirrorball.register import registered

        views, turns = registered(views)
        panels = [drawn.of(view) for drawn, view in zip(panels, views, strict=True)]
    singles = tuple(ball_lighting([view], view.name, height) for view in views)
    merged = ball_lighting(views, "lighting", height) if poses is not None or register else None
    return Reading(tuple(shots), tuple(views), singles, merged, tuple(panels), turns)


def _view(
    shot: BallShot, setup: Setup, exposures: Sequence[float], pose: Floats
) -> tuple[BallView, RadianceImage]:
    images = [_decoded(path, setup, exposure) for path, exposure in zip(shot.photos, exposures, strict=True)]
    # From the longest exposure on: it shows the ball's outline best, and neighbours share the most.
    order = np.argsort(exposures)[::-1]
    images, exposures = [images[k] for k in order], [exposures[k] for k in order]
    size = images[0].saturated.shape
    camera = _camera(shot.photos[0], setup, images[0], pose)
    background = None
    if shot.background is not None:
        background = _decoded(shot.background, setup, 1.0)
        check_size(shot.background, background.radiance, size)
    return view_bracket(
        images,
        camera,
        shot.photos[0].name,
        read_mask(shot.mask, size) if shot.mask else None,
        background,
        shot.disk,
        setup.reflectance,
        setup.camera_mask_deg,
        exposures,
    )


def _decoded(path: Path, setup: Setup, exposure: float) -> RadianceImage:
    encoding: Any = setup.encoding
    if setup.response is not None:
        from capture.bracket.response import read_response

        encoding = read_response(setup.response)
    return decode(path, encoding, exposure)


def _exposures(shots: Sequence[BallShot], setup: Setup) -> list[tuple[float, ...]]:
    """The relative exposures of each view's photos."""
    if setup.times is not None:
        seconds = read_times(setup.times)
        if len(seconds) == len(shots[0].photos):
            seconds = seconds * len(shots)
        found = bracket_exposures([path for shot in shots for path in shot.photos], seconds)
        count = len(shots[0].photos)
        return [found[k * count : (k + 1) * count] for k in range(len(shots))]
    if len(shots[0].photos) == 1 and setup.exposure == "equal":
        return [(1.0,)] * len(shots)
    return [tuple(_exif_exposure(path) for path in shot.photos) for shot in shots]


def _exif_exposure(path: Path) -> float:
    settings = read_exif_exposure(path)
    if settings.exposure_s is None:
        raise ValueError(
            f"{path}: its EXIF holds no exposure time; give --times 1/60,1/15,..., or, if all photos had one"
            " exposure, use --exposure equal"
        )
    return relative_exposure(path, "manual", settings)


def _camera(photo: Path, setup: Setup, image: RadianceImage, pose: Floats) -> Camera:
    rows, columns = image.saturated.shape
    if setup.camera is not None:
        camera = build_camera(setup.camera, (CameraTable(file=setup.camera.name),), pose, "--camera")
        check_size(photo, image.radiance, (camera.height, camera.width))
        return camera
    try:
        if setup.focal_px is not None:
            params = np.array([setup.focal_px, setup.focal_px, columns / 2, rows / 2])
            return Camera("PINHOLE", params, columns, rows, pose)
        return Camera(ORTHOGRAPHIC, np.array([]), columns, rows, pose)
    except ValueError as error:
        raise ValueError(f"{photo}: {error}") from error


def _about_y(angle: float) -> Floats:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0, s, 0], [0, 1, 0, 0], [-s, 0, c, 0], [0, 0, 0, 1.0]])


def _each(given: Sequence[Any], count: int, what: str, noun: str) -> list[Any]:
    """One for each view."""
    if len(given) not in (0, 1, count):
        raise ValueError(f"{len(given)} {what} for {count} {noun}: give one for all of them, or one for each")
    if not given:
        return [None] * count
    return [*given] if len(given) == count else [given[0]] * count


def _as_many(number: int, count: int, what: str) -> None:
    if number != count:
        raise ValueError(f"{what} for {count} views: give one for each")
