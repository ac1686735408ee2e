"""The outline of a ball near a circle that is roughly known, at sub-pixel accuracy.

A mirror ball mirrors what is behind it at its rim, so that its edge is faint for long stretches, while brighter
edges of what it mirrors run along it. So the outline is searched for as a whole: the largest closed curve, among
those a sphere can have, along which the picture changes about as much as along any; then each point's own edge.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, maximum_filter1d

from capture.camera import Camera
from recon.sphere.circle import Disk
from recon.sphere.diskedge import FEWEST, STEP, disk_sphere, profiles, rim
from recon.sphere.fit import fit_to_outlines
from recon.sphere.sphere import Sphere, sphere_outline

Floats = NDArray[np.float64]

# Points of an outline that a search looks at.
_SEARCHED = 120
# Share of an outline along which it must be seen, and how far from it, in pixels, an edge may be one of its.
_LEAST_SEEN, _NEAR_PX = 0.35, 2.0
# What the rim mirrors is what the ball hides, just there; edges begin further in, by this much in pixels, which no
# scatter shows. Renderings from three sides: 0.15 to 0.7.
_RIM_PX = 0.4


def refined(
    picture: NDArray[np.float32], camera: Camera, disk: Disk, reach: float, as_good: float, name: str
) -> tuple[Sphere, float]:
    """The sphere near a disk along whose outline a picture (h, w, c) changes most, and the share that shows.

    reach : how far off the disk's outline may be, as a share of its radius. as_good : share of the best outline's
    score at which a larger one is preferred.
    """
    sphere = disk_sphere(camera, disk)
    if sphere is None or not 4 <= disk.radius <= max(picture.shape):
        raise ValueError(
            f"{name}: no ball can lie at column {disk.x:g}, row {disk.y:g} with a radius of {disk.radius:g} pixels"
            " in this photograph; check the ball's centre and radius"
        )
    reach_px = max(3.0, reach * disk.radius)
    # Coarsely by all points at once, which a few wrong edges don't sway; then each point's own edge.
    for span in (reach_px, max(3.0, reach_px / 3)):
        outline, outward = rim(sphere, camera)
        change = _change(profiles(picture, outline, outward, span))
        sphere = _moved(sphere, camera, _best_shift(change, outward, span, as_good))
    for _ in range(3):
        outline, outward = rim(sphere, camera)
        offset, clear = _edges(_change(profiles(picture, outline, outward, _NEAR_PX + 2)))
        if clear.mean() < _LEAST_SEEN:
            raise ValueError(
                f"{name}: only {clear.mean():.0%} of the ball's outline can be seen near column {disk.x:.0f}, row"
                f" {disk.y:.0f}, radius {disk.radius:.0f} pixels; check these numbers, or give a mask"
            )
        sphere = _fitted(sphere, camera, (outline + offset[:, None] * outward)[clear])
    return sphere, float(clear.mean())


def shown_share(picture: NDArray[np.float32], camera: Camera, sphere: Sphere) -> float:
    """The share of a sphere's outline along which a picture (h, w, c) has a clear edge, within a pixel of it."""
    outline, outward = rim(sphere, camera)
    offset, clear = _edges(_change(profiles(picture, outline, outward, _NEAR_PX + 2)))
    return float((clear & (np.abs(offset) < 1)).mean())


def _change(profiles: Floats) -> Floats:
    """How much profiles (n, k, c) change per step, (n, k)."""
    return np.asarray(np.linalg.norm(gaussian_filter1d(profiles, 1.0, axis=1, order=1), axis=2))


def _best_shift(change: Floats, outward: Floats, span: float, as_good: float) -> Floats:
    """The shift (x, y) and growth of an outline, in pixels, with which it lies on most change.

    Edges count by rank within their own profile more than by height: a lamp in the ball is no better an edge.
    """
    usual = np.median(change, axis=1, keepdims=True) + 0.1 * change.mean() + 1e-12
    score = maximum_filter1d(change / (change + usual), 3, axis=1)
    half = change.shape[1] // 2
    steps = np.arange(-span, span + 1e-9, max(STEP, span / 16))
    x, y, growth = (axis.ravel() for axis in np.meshgrid(steps, steps, steps, indexing="ij"))
    total, every = np.zeros(len(x)), max(1, len(score) // _SEARCHED)
    for row, (normal_x, normal_y) in zip(score[::every], outward[::every], strict=True):
        place = np.round((x * normal_x + y * normal_y + growth) / STEP).astype(int)
        inside = np.abs(place) <= half
        total += np.where(inside, row[np.clip(place + half, 0, 2 * half)], 0.0)
    # What is mirrored near the rim runs along it: of outlines as good as another, the largest is the ball's.
    good = np.flatnonzero(total >= as_good * total.max())
    best = good[np.lexsort((total[good], growth[good]))[-1]]
    return np.array([x[best], y[best], growth[best]])


def _moved(sphere: Sphere, camera: Camera, shift: Floats) -> Sphere:
    """The sphere whose outline is shifted by (x, y) and grown, in pixels."""
    outline = sphere_outline(sphere, camera, FEWEST)
    centre = outline.mean(axis=0) + shift[:2]
    radius = float(np.linalg.norm(outline - outline.mean(axis=0), axis=1).mean() + shift[2])
    moved = disk_sphere(camera, Disk(float(centre[0]), float(centre[1]), radius))
    return sphere if moved is None else moved


def _edges(change: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Offsets (n,) in pixels of the strongest change near each point of an outline, and where it is a clear one."""
    half = change.shape[1] // 2
    away = np.abs(np.arange(-half, half + 1)) * STEP
    near = np.where(away <= _NEAR_PX, change * np.exp(-0.5 * away**2), -np.inf)
    index = _tops(near, change)
    peak = change[np.arange(len(change)), np.round(index).astype(int)]
    offset = (index - half) * STEP
    clear = (np.abs(offset) < _NEAR_PX) & (peak > 1.5 * np.median(change, axis=1))
    return offset, clear


def _tops(candidates: Floats, change: Floats) -> Floats:
    """Columns (n,), with fractions, at which rows (n, k) of change peak, nearest to their largest candidates."""
    index = np.clip(candidates.argmax(axis=1), 1, change.shape[1] - 2)
    before, peak, after = (np.take_along_axis(change, (index + k)[:, None], axis=1)[:, 0] for k in (-1, 0, 1))
    curvature = before - 2 * peak + after
    # The top of the parabola through three points.
    top = np.where(curvature < 0, (before - after) / (2 * np.where(curvature < 0, curvature, -1.0)), 0.0)
    return np.asarray(index + np.clip(top, -0.5, 0.5))


def _fitted(sphere: Sphere, camera: Camera, points: Floats) -> Sphere:
    """The sphere that rays through outline points (n, 2) touch."""
    start = np.append(sphere.centre, sphere.radius)
    return fit_to_outlines([camera], [points], start, np.ones(4, bool), [_RIM_PX])
