"""Features' places to a few hundredths of a pixel, by least-squares matching of the patches around them.

Gruen 1985, "Adaptive least squares correlation: a powerful image matching technique": an affine map, a gain and an
offset bring each photograph's patch onto the same patch in one reference. SIFT's own places are off by some tenths of a
pixel.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from recon.poses.register.bundle import Bundle

Floats = NDArray[np.float64]

# Points along a patch's side; their spacing in the reference, pixels, at least, and as a share of the feature's size.
_SIDE, _SPACING, _SHARE = 15, 0.9, 0.3
# Blur (standard deviation over the spacing) that keeps points from falling between pixels' grain.
_BLUR = 0.4
# Spacings double so often; what would need wider ones keeps its place.
_LEVELS = 3
_STEPS = 15
# What a match must reach: correlation with the reference, and how far it may leave SIFT's place, spacings.
_ALIKE, _MOVED = 0.85, 2.5
# Least standard deviation of a place, pixels: interpolation, and surfaces that bend within a patch.
_LEAST = 0.02


def refine_places(
    bundle: Bundle, shapes: Floats, picture: Callable[[int], NDArray[np.uint8]], unrefined: float
) -> Bundle:
    """The bundle with observations where patches match best, their widths in pixels.

    shapes : (n, 2, 2), the affine shape of each observation's feature, whose square is about its size in pixels.
    picture : of a photograph by its place in the bundle, (h, w); called several times, so that no two are held.
    unrefined : standard deviation in pixels, of an observation of width 1, where nothing matches well and it stays.
    """
    reference = _references(bundle)
    own = reference == np.arange(len(reference))
    sizes = np.sqrt(np.abs(np.linalg.det(shapes)))[reference]
    level = np.round(np.log2(np.maximum(_SHARE * sizes / _SPACING, 1))).astype(int)
    steps = np.arange(_SIDE) - _SIDE // 2
    square = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2).astype(float)
    photos = range(len(bundle.poses))

    pixels, widths = bundle.pixels.copy(), unrefined * bundle.widths
    for number in range(_LEVELS):
        spacing = _SPACING * 2.0**number
        rows = np.flatnonzero(own & (level == number))
        templates = np.zeros((len(rows), len(square)), np.float32)
        for photo in photos:
            mine = bundle.photo[rows] == photo
            if mine.any():
                places = bundle.pixels[rows[mine]][:, None] + spacing * square
                templates[mine] = _sampled(_blurred(picture(photo), spacing), places)
        # The patch itself is the point: what its own pixels' noise does to it, it does to all of the others.
        widths[rows] = _LEAST
        for photo in photos:
            seen = np.flatnonzero(~own & (level == number) & (bundle.photo == photo))
            if not len(seen):
                continue
            start = shapes[seen] @ np.linalg.inv(shapes[reference[seen]])
            wanted = templates[np.searchsorted(rows, reference[seen])]
            shown = _blurred(picture(photo), spacing)
            places, stds, found = _matched(
                shown, bundle.pixels[seen], start, wanted, square * spacing, spacing
            )
            pixels[seen[found]] = places[found]
            widths[seen[found]] = np.hypot(stds[found], _LEAST)
    return replace(bundle, pixels=pixels, widths=widths)


def _blurred(picture: NDArray[np.uint8], spacing: float) -> NDArray[np.float32]:
    return np.asarray(cv2.GaussianBlur(picture.astype(np.float32), (0, 0), _BLUR * spacing), np.float32)


def _references(bundle: Bundle) -> NDArray[np.int64]:
    """For each observation (n,) that of the same point whose line of sight is nearest to the mean of all of its."""
    rotations = bundle.poses[bundle.photo, :3, :3]
    local = bundle.local
    sight = np.einsum("nji,nj->ni", rotations, local / np.linalg.norm(local, axis=1, keepdims=True))
    mean = np.zeros((len(bundle.points), 3))
    np.add.at(mean, bundle.point, sight)
    central = (sight * mean[bundle.point]).sum(axis=1)
    order = np.lexsort((-central, bundle.point))
    first = np.concatenate([[True], np.diff(bundle.point[order]) > 0])
    best = np.zeros(len(bundle.points), np.int64)
    best[bundle.point[order][first]] = order[first]
    return best[bundle.point]


def _sampled(picture: NDArray[Any], places: Floats) -> NDArray[np.float32]:
    """A picture at places (n, m, 2) in pixels; OpenCV counts centres at integers."""
    shifted = (places - 0.5).astype(np.float32)
    # OpenCV takes at most 32767 rows at once.
    parts = np.array_split(shifted, len(places) // 30_000 + 1)
    border = cv2.BORDER_REPLICATE
    empty: Any = None  # OpenCV's annotations forget that one map may hold both coordinates
    return np.concatenate(
        [cv2.remap(picture, part, empty, cv2.INTER_CUBIC, borderMode=border) for part in parts]
    )


def _matched(
    picture: NDArray[np.float32],
    pixels: Floats,
    maps: Floats,
    templates: NDArray[np.float32],
    grid: Floats,
    spacing: float,
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Where patches match their templates (n, m): places (n, 2), their standard deviations (n,), and whether they do.

    pixels : (n, 2), maps : (n, 2, 2), where to begin: template point u is seen at pixels + maps @ u.
    """
    right, down = (
        cv2.Sobel(picture, cv2.CV_32F, dx, dy, ksize=3, scale=1 / 8) for dx, dy in ((1, 0), (0, 1))
    )
    contrast = templates.std(axis=1) + 1e-6
    wanted = (templates - templates.mean(axis=1, keepdims=True)) / contrast[:, None]
    places, maps = pixels.copy(), maps.copy()
    design = np.empty((len(pixels), len(grid), 8))
    # Not `capture.gaussnewton`: all patches step side by side.
    for _ in range(_STEPS):
        at = places[:, None] + np.einsum("nij,mj->nmi", maps, grid)
        shown = _sampled(picture, at).astype(float)
        mean, size = shown.mean(axis=1, keepdims=True), shown.std(axis=1, keepdims=True) + 1e-6
        slopes = [_sampled(slope, at) / size for slope in (right, down)]
        shown = (shown - mean) / size
        for axis, slope in enumerate(slopes):
            design[:, :, 2 * axis] = slope * grid[:, 0] / spacing
            design[:, :, 2 * axis + 1] = slope * grid[:, 1] / spacing
            design[:, :, 4 + axis] = slope
        design[:, :, 6], design[:, :, 7] = shown, 1.0
        off = wanted - shown
        matrix = design.mT @ design
        matrix += 1e-6 * np.trace(matrix, axis1=1, axis2=2)[:, None, None] * np.eye(8)
        step = np.linalg.solve(matrix, design.mT @ off[..., None])[..., 0]
        # A step that leaves the patch would never come back.
        step[:, :6] *= np.minimum(1, spacing / np.maximum(np.abs(step[:, 4:6]).max(axis=1), 1e-9))[:, None]
        maps += np.stack([step[:, 0:2], step[:, 2:4]], axis=1) / spacing
        places += step[:, 4:6]
    alike = (wanted * shown).mean(axis=1)
    variance = (off**2).mean(axis=1)
    stds = np.sqrt(variance * np.trace(np.linalg.inv(matrix)[:, 4:6, 4:6], axis1=1, axis2=2) / 2)
    height, width = picture.shape
    reach = np.abs(grid).max() * spacing
    inside = ((places > reach) & (places < np.array([width, height]) - reach)).all(axis=1)
    still = np.abs(step[:, 4:6]).max(axis=1) < 0.05 * spacing
    near = np.linalg.norm(places - pixels, axis=1) < _MOVED * spacing
    grown = np.linalg.det(maps)
    found = (alike > _ALIKE) & inside & still & near & (grown > 0.2) & (grown < 5)
    return places, stds, found
