"""Finding a sphere in a photograph without a mask, wherever part of its outline shows: bright on dark, dark on
bright, or lit from one side.

Edges vote for the centres of circles that they may be part of; the circles with most edges along them are refined as
spheres' outlines, and the best is taken if enough of its outline shows.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, maximum_filter

from capture.camera import Camera
from capture.radiance import RadianceImage
from recon.sphere.circle import Disk
from recon.sphere.diskedge import disk_sphere, rim, rim_edges
from recon.sphere.fit import fit_to_outlines
from recon.sphere.outline import Silhouette
from recon.sphere.sphere import Sphere

Floats = NDArray[np.float64]
Picture = NDArray[np.float32]

# Pixels along the longer side of the picture in which circles are searched for.
SEARCHED_PX = 480
# Edges that are looked for and that vote, and circles that are looked at closely.
_EDGES, _VOTERS, _CANDIDATES = 8000, 2000, 8
# Smallest radius in pixels of the picture that is searched, and largest as a share of its longer side.
_SMALLEST_PX, _LARGEST = 8.0, 1.0
# Share of an outline along which it must show for a sphere to be believed where nothing else is known, and where
# other photographs say where it is.
_LEAST_SEEN, _LEAST_SEEN_NEAR = 0.3, 0.1
# Pixels of it that must show in the picture that is searched: small circles are found everywhere.
_LEAST_LENGTH_PX = 64.0
_ROUNDS = 4
# How far an outline as a whole may be off that is read off shading: in renderings 0.00 to 0.1, 0.02 RMS; in twelve
# photographs of a grey ball, each under another light, 0.05 to 0.4, 0.2 RMS.
_HIDDEN_PX = 0.1
# And the share of its blur: a blurred edge looks like a dark rim.
_HIDDEN_BLUR = 0.1
# How far, in pixels and as shares of the blur (of up to a pixel) and of the radius, an edge may be off the outline and
# count as its.
_AGREE_PX, _AGREE_BLUR, _AGREE_SHARE = 0.15, 0.15, 0.003
# Blur in pixels up to which a picture may be looked at in thrice the size.
_SHARP_PX = 0.85
# Share of a circle's turn along which there are edges for it to be looked at closely.
_WORTH = 0.25


@dataclass(frozen=True, eq=False)
class SphereRim:
    """A sphere's outline as a photograph shows it.

    sphere : that it belongs to. points : (n, 2) of it, pixels. hidden_px : standard deviation of errors that they
    share. length : of what shows, in pixels. blur : standard deviation, in pixels of the picture that was looked at.
    """

    sphere: Sphere
    points: Floats
    hidden_px: float
    length: float
    blur: float


def rim_silhouette(rim: SphereRim, camera: Camera) -> Silhouette:
    """What locating a sphere needs of its outline in a photograph."""
    return Silhouette(rim.points, rim.hidden_px, None, (camera.height, camera.width))


def find_rim(camera: Camera, image: RadianceImage) -> SphereRim | None:
    """The sphere's outline that shows best in a photograph; None if none does.

    It is searched for in a picture of 480 pixels; there, 64 pixels of its outline and a third of it must show.
    """
    coarse, *finer = _levels(image)
    rims = []
    for disk in likely_circles(coarse.picture):
        sphere = disk_sphere(camera, disk.scaled(1 / coarse.factor))
        found = None if sphere is None else _refined(camera, coarse, sphere, _LEAST_SEEN)
        if found is not None and found.length * coarse.factor >= _LEAST_LENGTH_PX:
            rims.append(found)
    # A sphere's highlights and shadows, too, may be round: of all outlines, most of its own shows.
    rims.sort(key=lambda found: -found.length)
    return _sharpened(camera, finer, rims[0], _LEAST_SEEN) if rims else None


def rim_near(sphere: Sphere, camera: Camera, image: RadianceImage) -> SphereRim | None:
    """What a photograph shows of the outline of a sphere that is known to a few pixels of 480; None if nothing."""
    if not camera.is_orthographic and camera.depth(sphere.centre)[0] <= sphere.radius:
        return None
    coarse, *finer = _levels(image)
    found = _refined(camera, coarse, sphere, _LEAST_SEEN_NEAR)
    return None if found is None else _sharpened(camera, finer, found, _LEAST_SEEN_NEAR)


@dataclass(frozen=True, eq=False)
class _Level:
    """A photograph, `factor` times as large as its camera's.

    picture : (h, w, 3), linear. saturated : (h, w), nonzero where it is.
    """

    picture: Picture
    saturated: Picture
    factor: float


def _levels(image: RadianceImage) -> Iterator[_Level]:
    """The photograph at the size at which spheres are searched for, at thrice that, and so on up to its own."""
    height, width = image.saturated.shape
    saturated = image.saturated.astype(np.float32)
    factor = SEARCHED_PX / max(height, width)
    while factor < 1:
        size = (round(width * factor), round(height * factor))
        small, clipped = (
            cv2.resize(each, size, interpolation=cv2.INTER_AREA) for each in (image.radiance, saturated)
        )
        yield _Level(np.asarray(small, np.float32), np.asarray(clipped, np.float32), factor)
        factor *= 3
    yield _Level(image.radiance, saturated, 1.0)


def _sharpened(camera: Camera, finer: Sequence[_Level], found: SphereRim, least: float) -> SphereRim | None:
    """The outline as finer levels show it, as far as they do: a large photograph may be blurred over many pixels, and
    noisy in each; None where already the first one, of 1440 pixels or less, denies it."""
    for level in finer:
        # One thrice as large would be blurred beyond what is tried.
        if found.blur > _SHARP_PX:
            break
        sharper = _refined(camera, level, found.sphere, least)
        if sharper is None:
            return None if level is finer[0] else found
        found = sharper
    return found


def _refined(camera: Camera, level: _Level, sphere: Sphere, least: float) -> SphereRim | None:
    """The outline near a sphere's; None where less than a share `least` of it shows."""
    factor, blur = level.factor, np.nan
    for turn in range(_ROUNDS):
        outline, outward = rim(sphere, camera)
        if not np.isfinite(outline).all():
            return None
        offset, clear, blur = rim_edges(
            level.picture, level.saturated, outline * factor, outward, None if turn < 2 else blur
        )
        if clear.mean() < least or clear.sum() < 12:
            return None
        points = (outline + offset[:, None] / factor * outward)[clear]
        hidden = float(np.hypot(_HIDDEN_PX, _HIDDEN_BLUR * blur)) / factor
        start = np.append(sphere.centre, sphere.radius)
        sphere = fit_to_outlines([camera], [points], start, np.ones(4, bool), [hidden])
    agreed = (_AGREE_PX + _AGREE_BLUR * min(blur, 1.0)) / factor + _AGREE_SHARE * sphere.pixel_radius(camera)
    good = np.abs(_outside(sphere, camera, points)) < agreed
    share = good.sum() / len(outline)
    if share < least or good.sum() < 12 or sphere.residual_px[0] > agreed:
        return None
    return SphereRim(sphere, points[good], hidden, 2 * np.pi * sphere.pixel_radius(camera) * share, blur)


def _outside(sphere: Sphere, camera: Camera, points: Floats) -> Floats:
    """How far image points (n, 2) lie outside a sphere's outline, pixels (n,)."""
    origins, directions = camera.rays(points)
    offset = sphere.centre - origins
    along = (offset * directions).sum(axis=1)
    distance = np.linalg.norm(offset - along[:, None] * directions, axis=1)
    return (distance - sphere.radius) * camera.focal_px / (1.0 if camera.is_orthographic else np.abs(along))


def _contrast(radiance: Picture) -> Picture:
    """The picture (h, w, 3) in 0 to 1, in which dark and bright parts show their edges alike."""
    positive = np.maximum(radiance, 0)
    return np.asarray(positive / (positive + max(float(positive.mean()), 1e-12)), np.float32)


def likely_circles(radiance: Picture) -> list[Disk]:
    """The circles along which a small picture (h, w, 3) has most edges, eight at most; the likeliest first."""
    picture = _contrast(radiance)
    points, normals = _edges(picture)
    if len(points) < 20:
        return []
    height, width = picture.shape[:2]
    radii = np.arange(_SMALLEST_PX, _LARGEST * max(height, width), 1.0)
    # Centres may lie outside the image by a quarter.
    margin = np.array([width // 4, height // 4])
    shape = (height + 2 * margin[1], width + 2 * margin[0])
    votes = np.zeros(shape[0] * shape[1])
    some = slice(None, None, -(-len(points) // _VOTERS))
    for sign in (-1.0, 1.0):
        at = points[some, None] + sign * radii[None, :, None] * normals[some, None] + margin
        column, row = np.floor(at).astype(int).reshape(-1, 2).T
        inside = (column >= 0) & (row >= 0) & (column < shape[1]) & (row < shape[0])
        # As many edges lie on a circle as its radius: they share one vote.
        weight = np.broadcast_to(1 / radii, at.shape[:2]).ravel()
        votes += np.bincount((row * shape[1] + column)[inside], weight[inside], minlength=len(votes))
    ballots = gaussian_filter(votes.reshape(shape), 1.5)
    peaks = (maximum_filter(ballots, 7) == ballots) & (ballots > 0)
    row, column = np.nonzero(peaks)
    order = np.argsort(ballots[row, column])[::-1][: 10 * _CANDIDATES]
    disks = []
    for centre in np.column_stack([column, row])[order] + 0.5 - margin:
        away = points - centre
        distance = np.linalg.norm(away, axis=1)
        radial = np.abs((away * normals).sum(axis=1)) > 0.95 * np.maximum(distance, 1e-9)
        turn = np.arctan2(away[:, 1], away[:, 0])
        # Share of each circle's turn that edges cover.
        cells = np.zeros((len(radii) + 1, 72), bool)
        place = np.round(distance - radii[0]).astype(int)
        fits = radial & (place >= 0) & (place < len(radii))
        cells[place[fits], ((turn[fits] + np.pi) / (2 * np.pi) * 72).astype(int) % 72] = True
        covered = cells[:-1] | cells[1:]
        covered[1:] |= cells[:-2]
        share = covered.mean(axis=1)
        best = int(share.argmax())
        disks.append((Disk(float(centre[0]), float(centre[1]), float(radii[best])), float(share[best])))
    disks.sort(key=lambda entry: -entry[1])
    return [disk for disk, share in disks[:_CANDIDATES] if share > _WORTH]


def _edges(picture: Picture) -> tuple[Floats, Floats]:
    """The clearest edges of a picture: points (n, 2) and unit normals (n, 2)."""
    smooth = cv2.GaussianBlur(picture, (0, 0), 1.0)
    across, down = (cv2.Scharr(smooth, cv2.CV_32F, *axis) for axis in ((1, 0), (0, 1)))
    channel = np.hypot(across, down).argmax(axis=2)[..., None]
    across, down = (np.take_along_axis(each, channel, axis=2)[..., 0] for each in (across, down))
    height = np.hypot(across, down)
    scale = 30000 / max(float(height.max()), 1e-12)
    level = np.quantile(height, max(0.0, 1 - _EDGES / height.size))
    level = max(level, 0.02 * float(height.max()))
    dx, dy = ((each * scale).astype(np.int16) for each in (across, down))
    edges = cv2.Canny(dx, dy, level * scale, 2 * level * scale, L2gradient=True)
    row, column = np.nonzero(edges)
    slope = np.column_stack([across[row, column], down[row, column]]).astype(float)
    normals = slope / np.linalg.norm(slope, axis=1, keepdims=True)
    return np.column_stack([column, row]).astype(float) + 0.5, normals
