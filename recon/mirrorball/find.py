"""Finding a mirror ball in a photograph: by its mask, against the empty room, near a circle drawn by hand, or as
the one bright disk.

No brightness distinguishes a mirror ball from the room that it mirrors. A photograph of the room without it does.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from capture.camera import Camera
from capture.radiance import RadianceImage
from recon.mirrorball.circle import refined, shown_share
from recon.mirrorball.shift import moved, shift_between
from recon.placement.locate import LocatedPhoto, locate_sphere
from recon.sphere.circle import Disk
from recon.sphere.finddisk import SEARCHED_PX, find_rim, likely_circles
from recon.sphere.outline import mask_silhouette
from recon.sphere.sphere import Sphere

Coverage = NDArray[np.float32]

# How far off, as shares of the radius, a circle may be that was drawn by hand, and one read off a difference.
_BY_HAND, _BY_DIFFERENCE = 0.08, 0.3
# And where it is read off edges in a small picture, and off a picture a third as fine.
_BY_EDGES, _BY_LEVEL = 0.15, 0.0
# Share of an outline that must show within a pixel, and pixels of it, in the small picture, where nothing else shows it
# the ball: of one in a room 0.89 to 0.92 show, of what else seems round 0.84 at most.
_LEAST_AROUND, _LEAST_LENGTH_PX = 0.86, 100.0
# How many times as coarse as 480 pixels pictures are in which circles are looked for: edges that vote differ in each.
_COARSER = (1.0, 1.25, 1.5)
# Share of the best outline's score at which another is as good, in a picture and in a difference that was cut off.
_AS_GOOD, _BEST = 0.95, 1.0
# Relative differences from the empty room at which the ball may part from noise, moved edges and shadows.
_LEVELS = (0.1, 0.15, 0.22, 0.33, 0.5)
_REMEDY = (
    "give a mask (an image of the same size, nonzero where the ball is), a photograph of the same view without the"
    " ball (background), or the ball's centre and radius in pixels (ball)"
)


def find_ball(
    image: RadianceImage,
    camera: Camera,
    name: str,
    mask: Coverage | None = None,
    background: RadianceImage | None = None,
    disk: Disk | None = None,
) -> tuple[Sphere, bool]:
    """The mirror ball in a photograph, from the first of mask, disk and background that is given; with none, it
    must stand out bright from the background, or nearly all of its outline must show.

    And whether it was only guessed from that outline: other things are round, too.

    mask : (h, w) in 0 to 1; the ball may be cut off by the image's edge. background : the room without the ball,
    from the same place; its exposure may differ. disk : the outline roughly, within 8% of the radius.

    ValueError names the photograph if sizes disagree, no ball is found, or the mask is not a ball's outline.
    """
    check_size(image.saturated, camera, f"{name}: the photograph")
    if mask is not None:
        check_size(mask, camera, f"{name}: the mask")
        return locate_sphere([LocatedPhoto(name, camera, mask_silhouette(mask))]), False
    if disk is not None:
        return refined(_contrast(image), camera, disk, _BY_HAND, _AS_GOOD, name)[0], False
    if background is not None:
        check_size(background.saturated, camera, f"{name}: the background")
        return _against(image, background, camera, name), False
    rim = find_rim(camera, image)
    return (_roundest(image, camera, name), True) if rim is None else (rim.sphere, False)


def check_size(pixels: NDArray[np.generic], camera: Camera, what: str) -> None:
    """ValueError unless pixels (h, w, ...) are as many as the camera's. what : the culprit."""
    height, width = pixels.shape[:2]
    if (height, width) != (camera.height, camera.width):
        raise ValueError(f"{what} is {width}x{height} pixels, but its camera {camera.width}x{camera.height}")


def _contrast(image: RadianceImage) -> NDArray[np.float32]:
    """The picture (h, w, 3) in 0 to 1, in which dark and bright parts show their edges alike."""
    radiance = np.maximum(image.radiance, 0)
    return np.asarray(radiance / (radiance + max(float(np.median(radiance)), 1e-12)), np.float32)


def _roundest(image: RadianceImage, camera: Camera, name: str) -> Sphere:
    """The largest sphere whose outline shows nearly all around, found in small pictures and refined in finer ones."""
    factor = -(-max(image.saturated.shape) // SEARCHED_PX)
    found: list[tuple[float, Disk, bool]] = []
    for coarse in dict.fromkeys(round(factor * coarser) for coarser in _COARSER):
        found += _round_ones(image, camera, coarse, name)
    found.sort(key=lambda entry: -entry[0])
    best = next((at for _, at, clear in found if clear), None)
    if best is None:
        guesses = [",".join(f"{value:.0f}" for value in (at.x, at.y, at.radius)) for at in _apart(found)]
        seen = f" (the likeliest circles are {' and '.join(guesses[:3])})" if guesses else ""
        raise ValueError(
            f"{name}: no mask is given and no ball stands out from the background{seen}; {_REMEDY}"
        )
    picture, eye = _contrast(image.binned(factor)), camera.binned(factor)
    sphere = refined(picture, eye, best.scaled(1 / factor), _BY_HAND, _AS_GOOD, name)[0]
    while factor > 1:
        factor = -(-factor // 3)
        eye = camera.binned(factor)
        try:
            sphere = refined(
                _contrast(image.binned(factor)), eye, _outline(sphere, eye), _BY_LEVEL, _AS_GOOD, name
            )[0]
        except ValueError:
            break  # A large photograph may be blurred over many of its pixels.
    return sphere


def _round_ones(
    image: RadianceImage, camera: Camera, factor: int, name: str
) -> list[tuple[float, Disk, bool]]:
    """Outlines that show in a photograph binned by a factor: the length that shows, the circle, whether it is clear.

    Both in pixels of the photograph.
    """
    small, eye = image.binned(factor), camera.binned(factor)
    picture = _contrast(small)
    found = []
    for disk in likely_circles(small.radiance):
        try:
            sphere = refined(picture, eye, disk, _BY_EDGES, _AS_GOOD, name)[0]
        except ValueError:
            continue
        share, at = shown_share(picture, eye, sphere), _outline(sphere, eye)
        length = 2 * np.pi * at.radius * share
        clear = share > _LEAST_AROUND and length > _LEAST_LENGTH_PX
        found.append((factor * length, at.scaled(factor), clear))
    return found


def _apart(found: list[tuple[float, Disk, bool]]) -> list[Disk]:
    """Circles without those that others before them are nearly the same as."""
    kept: list[Disk] = []
    for _, at, _ in found:
        if all(np.hypot(at.x - old.x, at.y - old.y) > 0.2 * old.radius for old in kept):
            kept.append(at)
    return kept


def _outline(sphere: Sphere, camera: Camera) -> Disk:
    """A sphere's outline, nearly, pixels."""
    x, y = camera.project(sphere.centre[None])[0]
    return Disk(float(x), float(y), sphere.pixel_radius(camera))


def _against(image: RadianceImage, background: RadianceImage, camera: Camera, name: str) -> Sphere:
    """The ball as the largest round thing in which a photograph differs from that of the empty room."""
    room = _aligned(image, background)
    total = image.radiance + room.radiance
    changed = np.abs(image.radiance - room.radiance) / (total + np.median(total) / 8)
    changed = cv2.GaussianBlur(changed.max(axis=2), (0, 0), 1.0)
    # Where both are saturated nothing is known to differ.
    changed[image.saturated & room.saturated] = 0
    rough = []
    for level in _LEVELS:
        # Cut off at the level, since within the ball one difference is as good as another.
        flat = np.minimum(changed / level, 1)[..., None]
        for disk in _disks(changed > level):
            try:
                sphere, seen = refined(flat, camera, disk, _BY_DIFFERENCE, _BEST, name)
                rough.append((sphere, seen * _filling(flat[..., 0], camera, sphere)))
            except ValueError:
                continue
    if not rough:
        raise ValueError(
            f"{name}: nothing round differs from the background; was it taken from the same place, in the same light?"
            " Otherwise give a mask, or the ball's centre and radius in pixels (ball)"
        )
    sphere = max(rough, key=lambda entry: entry[1])[0]
    # The cut moved the outline, and a background that is shifted a little leaves edges of its own.
    return refined(_contrast(image), camera, _outline(sphere, camera), _BY_HAND, _AS_GOOD, name)[0]


def _filling(changed: NDArray[np.float32], camera: Camera, sphere: Sphere) -> float:
    """Mean change within a sphere's outline, less that in a ring around it."""
    centre, radius = camera.project(sphere.centre[None])[0], sphere.pixel_radius(camera)
    y, x = np.mgrid[: camera.height, : camera.width] + 0.5
    away = np.hypot(x - centre[0], y - centre[1]) / radius
    ring = (away > 1.1) & (away < 1.4)
    return float(changed[away < 0.9].mean() - (changed[ring].mean() if ring.any() else 0.0))


def _aligned(image: RadianceImage, background: RadianceImage) -> RadianceImage:
    """The background as bright as the photograph, and shifted to it if the camera was touched."""
    grey, empty = (np.ascontiguousarray(each.radiance.mean(axis=2)) for each in (image, background))
    gain = _gain(grey, empty, ~(image.saturated | background.saturated) & (empty > 0))
    shift = shift_between(empty * gain, grey)
    return RadianceImage(
        moved(background.radiance * gain[..., None], shift),
        np.broadcast_to(np.float32(0), background.radiance.shape),
        moved(background.saturated.astype(np.float32), shift) > 0,
    )


def _gain(
    grey: NDArray[np.float32], empty: NDArray[np.float32], clear: NDArray[np.bool_]
) -> NDArray[np.float32]:
    """How many times (h, w) a picture is as bright as another: usual at each level of the other.

    By level, since an unknown response makes the factor between two exposures depend on it.
    """
    if clear.sum() < 1000:
        return np.ones_like(empty)
    levels = np.quantile(empty[clear], np.linspace(0, 1, 17))
    bins = np.searchsorted(levels[1:-1], empty[clear])
    ratio = grey[clear] / empty[clear]
    filled = [k for k in range(16) if (bins == k).any()]
    centres = [float(np.median(empty[clear][bins == k])) for k in filled]
    factors = [float(np.median(ratio[bins == k])) for k in filled]
    return np.asarray(np.interp(empty, centres, factors), np.float32)


def _disks(changed: NDArray[np.bool_]) -> list[Disk]:
    """The largest disks inscribed in each of the three largest regions (h, w), holes filled."""
    opened = cv2.morphologyEx(changed.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    closed = cv2.morphologyEx(opened, cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8))
    contours, _ = cv2.findContours(closed, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    disks = []
    for contour in sorted(contours, key=cv2.contourArea, reverse=True)[:3]:
        region = np.zeros_like(closed)
        cv2.drawContours(region, [contour], -1, 1, thickness=cv2.FILLED)
        away = cv2.distanceTransform(region, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        row, column = np.unravel_index(int(away.argmax()), away.shape)
        if away[row, column] >= 5:
            disks.append(Disk(column + 0.5, row + 0.5, float(away[row, column])))
    return disks
