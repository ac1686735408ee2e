"""Where a render is seen from: an azimuth and an elevation, all around, or as a photograph was."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from capture.arc.gantry import look_at
from capture.camera import Camera
from invrender.output.render.numbers import direction, numbers

Floats = NDArray[np.float64]

_VIEW = "AZIMUTH,ELEVATION or AZIMUTH,ELEVATION,DISTANCE, in degrees and metres (30,20 or 30,20,0.6)"
# Where there are no photographs to go by: a square picture of which the object fills three quarters, from ten radii.
_SIDE, _FILLED, _RADII = 512, 0.75, 10.0
_MAX_SIDE = 20_000
_UNUSABLE = "--size {}: cannot be used; give width and height in pixels, such as 640x480"


@dataclass(frozen=True, eq=False)
class ViewCamera:
    """A camera for new views. camera : at any pose, without distortion. radii : its distance from the object's centre,
    in radii of the object; of an orthographic camera without meaning."""

    camera: Camera
    radii: float


@dataclass(frozen=True)
class View:
    """Degrees; distance in metres, None for that of the photographs."""

    azimuth: float
    elevation: float
    distance: float | None

    def turned(self, degrees: float) -> View:
        """The view from further round, counter-clockwise seen from above."""
        return replace(self, azimuth=self.azimuth + degrees)


# Where a camera stands if nobody says.
DEFAULT_VIEW = View(0.0, 20.0, None)


def parse_view(text: str) -> View:
    """A view as it is written for `--view`."""
    return view_of(numbers(text, "--view", _VIEW, (2, 3)))


def view_of(values: Sequence[float]) -> View:
    """A view from azimuth and elevation, degrees, and the distance, metres, if it is given."""
    where = f"--view {','.join(f'{value:g}' for value in values)}"
    if len(values) not in (2, 3):
        raise ValueError(f"{where}: cannot be read; give {_VIEW}")
    direction(values[0], values[1], where)
    distance = values[2] if len(values) == 3 else None
    if distance is not None and not distance > 0:
        raise ValueError(f"{where}: the distance is {distance:g} m; it must be > 0")
    return View(values[0], values[1], distance)


def parse_size(text: str) -> tuple[int, int]:
    """Width and height in pixels of "640x480"."""
    match = re.fullmatch(r"(\d+)x(\d+)", text)
    if match is None:
        raise ValueError(_UNUSABLE.format(text))
    return checked_size(tuple(map(int, match.groups())))


def checked_size(size: Sequence[int]) -> tuple[int, int]:
    """Width and height in pixels; ValueError where a picture can't have them."""
    if len(size) != 2 or not all(0 < side <= _MAX_SIDE for side in size):
        raise ValueError(_UNUSABLE.format("x".join(map(str, size))))
    return size[0], size[1]


def new_optics(
    photographs: tuple[Sequence[Camera], Floats, float] | None,
    radius: float,
    size: tuple[int, int] | None,
    fov_deg: float | None,
) -> ViewCamera:
    """A camera for new views of an object of a radius: the photographs', as far as size and fov_deg leave it.

    photographs : their cameras, and centre and radius of what they show, metres; None where they aren't known.
    Another size keeps the field of view, cut to the shorter side. fov_deg : across the width. Of an object larger
    than the photographed one the camera stands as much further away, so that it fills as much of the picture.
    """
    if fov_deg is not None and not 0 < fov_deg < 170:
        raise ValueError(f"--fov is {fov_deg:g} degrees; it must be above 0 and below 170")
    if photographs is None:
        width, height = size or (_SIDE, _SIDE)
        focal = _FILLED * min(width, height) / 2 * np.sqrt(_RADII**2 - 1)
        radii, orthographic, photographed = _RADII, False, radius
    else:
        cameras, centre, photographed = photographs
        first = cameras[0]
        width, height = size or (first.width, first.height)
        focal = first.focal_px * min(width / first.width, height / first.height)
        orthographic = first.is_orthographic
        apart = [np.linalg.norm(camera.centre - centre) for camera in cameras]
        radii = _RADII if orthographic else float(np.median(apart)) / photographed
    middle = [width / 2, height / 2]
    if fov_deg is not None:
        focal, orthographic = width / 2 / np.tan(np.radians(fov_deg) / 2), False
    if orthographic:
        scale = focal * photographed / radius
        return ViewCamera(Camera("ORTHOGRAPHIC", np.array([scale, *middle]), width, height, np.eye(4)), radii)
    return ViewCamera(Camera("PINHOLE", np.array([focal, focal, *middle]), width, height, np.eye(4)), radii)


def seen_from(optics: ViewCamera, view: View, centre: Floats, radius: float) -> Camera:
    """The camera at a view of an object; metres. +Z is up in its picture; ValueError if it stands inside."""
    distance = optics.radii * radius if view.distance is None else view.distance
    if distance <= radius:
        raise ValueError(
            f"--view: the camera is {distance:g} m from the object's centre, inside the {radius:g} m that the object"
            " reaches: stand further away"
        )
    outward = direction(view.azimuth, view.elevation, "--view")
    # Square to the line of sight, so that it is defined at the poles, too.
    azimuth, elevation = np.radians([view.azimuth, view.elevation])
    level = np.sin(elevation)
    up = [-level * np.cos(azimuth), -level * np.sin(azimuth), np.cos(elevation)]
    return optics.camera.posed(look_at(centre + distance * outward, centre, up))
