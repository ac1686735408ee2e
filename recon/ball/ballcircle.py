"""The outline of a ball near a circle that is roughly known, at sub-pixel accuracy.

A mirror ball mirrors what is behind it at its rim, so that its edge is faint for long stretches, while brighter
edges of what it mirrors run along it. So the outline is searched for as a whole: the largest closed curve, among
those a sphere can have, along which the picture changes about as much as along any; then each point's own edge.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, maximum_filter1d
from scipy.optimize import least_squares

from capture.camera import Camera
from recon.ball.reflection import sphere_outline
from recon.sphere import Sphere

Floats = NDArray[np.float64]

# Steps of profiles across an outline in pixels, and how far along it they are smoothed, against noise.
_STEP, _ALONG_PX = 0.5, 2.0
# Fewest and most points around an outline, which otherwise are a pixel apart; and those that a search looks at.
_FEWEST, _MOST, _SEARCHED = 180, 1440, 120
# Share of an outline along which it must be seen, and how far from it, in pixels, an edge may be one of its.
_LEAST_SEEN, _NEAR_PX = 0.35, 2.0
# What the rim mirrors is what the ball hides, just there; edges begin further in, by this much in pixels, which no
# scatter shows. Renderings from three sides: 0.15 to 0.7.
_RIM_PX = 0.4
# Arcs of an outline whose edges err independently.
_ARCS = 24


@dataclass(frozen=True)
class Disk:
    """A circle drawn by hand: column, row and radius in pixels; the first pixel's centre is (0.5, 0.5)."""

    x: float
    y: float
    radius: float


def refined(
    picture: NDArray[np.float32], camera: Camera, disk: Disk, reach: float, as_good: float, name: str
) -> tuple[Sphere, float]:
    """The sphere near a disk along whose outline a picture (h, w, c) changes most, and the share that shows.

    reach : how far off the disk's outline may be, as a share of its radius. as_good : share of the best outline's
    score at which a larger one is preferred.
    """
    sphere = _sphere(camera, disk)
    if sphere is None or not 4 <= disk.radius <= max(picture.shape):
        raise ValueError(
            f"{name}: no ball can lie at column {disk.x:g}, row {disk.y:g} with a radius of {disk.radius:g} pixels"
            " in this photograph; check the ball's centre and radius"
        )
    reach_px = max(3.0, reach * disk.radius)
    # Coarsely by all points at once, which a few wrong edges don't sway; then each point's own edge.
    for span in (reach_px, max(3.0, reach_px / 3)):
        outline, outward = _outline(sphere, camera)
        change = _change(_profiles(picture, outline, outward, span))
        sphere = _moved(sphere, camera, _best_shift(change, outward, span, as_good))
    for _ in range(3):
        outline, outward = _outline(sphere, camera)
        offset, clear = _edges(_change(_profiles(picture, outline, outward, _NEAR_PX + 2)))
        if clear.mean() < _LEAST_SEEN:
            raise ValueError(
                f"{name}: only {clear.mean():.0%} of the ball's outline can be seen near column {disk.x:.0f}, row"
                f" {disk.y:.0f}, radius {disk.radius:.0f} pixels; check these numbers, or give a mask"
            )
        sphere = _fitted(sphere, camera, (outline + offset[:, None] * outward)[clear])
    return sphere, float(clear.mean())


def _sphere(camera: Camera, disk: Disk) -> Sphere | None:
    """A sphere whose outline is about a disk's; None where the camera sees none there."""
    turn = np.arange(8) * np.pi / 4
    rim = np.array([disk.x, disk.y]) + disk.radius * np.column_stack([np.cos(turn), np.sin(turn)])
    origins, rays = camera.rays(rim)
    if not np.isfinite(rays).all():
        return None
    axis = rays.mean(axis=0)
    axis /= np.linalg.norm(axis)
    centre = origins.mean(axis=0) + axis
    if camera.is_orthographic:
        radius = disk.radius / camera.focal_px
        # Its depth means nothing: keep all of it before the camera.
        centre = centre + 2 * radius * axis
    else:
        radius = float(np.sin(np.arccos(np.clip(rays @ axis, -1, 1)).mean()))
    return Sphere(centre, radius, np.zeros((4, 4)))


def _outline(sphere: Sphere, camera: Camera) -> tuple[Floats, Floats]:
    """Points (n, 2) around the sphere's outline in the image, and its outward normals (n, 2)."""
    around = 2 * np.pi * sphere.pixel_radius(camera)
    outline = sphere_outline(sphere, camera, int(np.clip(around, _FEWEST, _MOST)))
    along = np.roll(outline, -1, axis=0) - np.roll(outline, 1, axis=0)
    outward = np.column_stack([along[:, 1], -along[:, 0]])
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    outward *= np.sign(((outline - outline.mean(axis=0)) * outward).sum(axis=1, keepdims=True))
    return outline, outward


def _profiles(picture: NDArray[np.float32], outline: Floats, outward: Floats, span: float) -> Floats:
    """A picture (h, w, c) across an outline, (n, 2 k + 1, c) from -span to span outward, in steps of `_STEP`.

    Outside of the picture its edge is repeated.
    """
    half = int(np.ceil(span / _STEP)) + 1
    steps = np.arange(-half, half + 1) * _STEP
    at = (outline[:, None] + steps[None, :, None] * outward[:, None] - 0.5).astype(np.float32)
    values = cv2.remap(
        np.ascontiguousarray(picture),
        at[..., 0],
        at[..., 1],
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )
    profiles = values.reshape(*at.shape[:2], -1).astype(float)
    spacing = np.linalg.norm(outline[1] - outline[0])
    return np.asarray(gaussian_filter1d(profiles, _ALONG_PX / spacing, axis=0, mode="wrap"))


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
    steps = np.arange(-span, span + 1e-9, max(_STEP, span / 16))
    x, y, growth = (axis.ravel() for axis in np.meshgrid(steps, steps, steps, indexing="ij"))
    total, every = np.zeros(len(x)), max(1, len(score) // _SEARCHED)
    for row, (normal_x, normal_y) in zip(score[::every], outward[::every], strict=True):
        place = np.round((x * normal_x + y * normal_y + growth) / _STEP).astype(int)
        inside = np.abs(place) <= half
        total += np.where(inside, row[np.clip(place + half, 0, 2 * half)], 0.0)
    # What is mirrored near the rim runs along it: of outlines as good as another, the largest is the ball's.
    good = np.flatnonzero(total >= as_good * total.max())
    best = good[np.lexsort((total[good], growth[good]))[-1]]
    return np.array([x[best], y[best], growth[best]])


def _moved(sphere: Sphere, camera: Camera, shift: Floats) -> Sphere:
    """The sphere whose outline is shifted by (x, y) and grown, in pixels."""
    outline = sphere_outline(sphere, camera, _FEWEST)
    centre = outline.mean(axis=0) + shift[:2]
    radius = float(np.linalg.norm(outline - outline.mean(axis=0), axis=1).mean() + shift[2])
    moved = _sphere(camera, Disk(float(centre[0]), float(centre[1]), radius))
    return sphere if moved is None else moved


def _edges(change: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Offsets (n,) in pixels of the strongest change near each point of an outline, and where it is a clear one."""
    half = change.shape[1] // 2
    away = np.abs(np.arange(-half, half + 1)) * _STEP
    near = np.where(away <= _NEAR_PX, change * np.exp(-0.5 * away**2), -np.inf)
    index = _tops(near, change)
    peak = change[np.arange(len(change)), np.round(index).astype(int)]
    offset = (index - half) * _STEP
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
    """The sphere that rays through outline points (n, 2) touch, as in `recon.sphere`, seen from one place."""
    origins, rays = camera.rays(points)
    axis = (sphere.centre - origins.mean(axis=0)) / np.linalg.norm(sphere.centre - origins.mean(axis=0))
    first = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    first /= np.linalg.norm(first)
    basis = np.zeros((4, 3))
    basis[:3, 0], basis[:3, 1], basis[3, 2] = first, np.cross(axis, first), 1.0
    start = np.append(sphere.centre, sphere.radius)

    def residuals(step: Floats) -> Floats:
        full = start + basis @ step
        offset = full[:3] - origins
        along = (offset * rays).sum(axis=1)
        distance = np.linalg.norm(offset - along[:, None] * rays, axis=1)
        per_metre = camera.focal_px / (1.0 if camera.is_orthographic else np.abs(along))
        return np.asarray((distance - full[3]) * per_metre)

    fit = least_squares(residuals, np.zeros(3), loss="cauchy", x_scale=sphere.radius / 10)
    full = start + basis @ fit.x
    rms = float(1.4826 * np.median(np.abs(fit.fun)))
    metres_per_px = float(full[3]) / sphere.pixel_radius(camera)
    covariance = _clustered(fit.jac, fit.fun) + (_RIM_PX * metres_per_px) ** 2 * np.eye(3)
    return Sphere(full[:3], float(full[3]), basis @ covariance @ basis.T, (rms,))


def _clustered(jacobian: Floats, residuals: Floats) -> Floats:
    """Covariance (3, 3) of a robust fit to points in their order around an outline.

    A ball is not quite round, and an edge may be mistaken for another along an arc: residuals are the same for many
    points, so that arcs, not points, count as independent (a sandwich estimate, clustered by arc).
    """
    weight = 1 / (1 + residuals**2)
    # scipy scales the Jacobian of a robust loss, so that its square is the cost's Hessian.
    bread = np.linalg.pinv(jacobian.T @ jacobian, rcond=1e-9, hermitian=True)
    scale = np.sqrt(np.maximum(weight - 2 * (residuals * weight) ** 2, np.finfo(float).eps))
    slopes = (weight * residuals / scale)[:, None] * jacobian
    arcs = np.array_split(slopes, _ARCS)
    return np.asarray(bread @ sum(np.outer(g, g) for g in (arc.sum(axis=0) for arc in arcs)) @ bread)
