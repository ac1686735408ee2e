"""A sphere's edge in a photograph, at sub-pixel accuracy, near where it is roughly known.

Radiance is smooth in the normal, which near the rim turns with the square root of the distance from it: it falls or
rises ever more steeply towards the rim. So the edge is not where the picture changes most, but where two such smooth
pieces, blurred, meet best: the sphere's, in powers of that root, and the background's.
"""

from __future__ import annotations

from functools import cache, lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from capture.camera import Camera
from recon.sphere.circle import Disk
from recon.sphere.sphere import Sphere, sphere_outline

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Picture = NDArray[np.float32]

# Steps of profiles across an outline in pixels, and how far along it they are smoothed, against noise.
STEP = 0.5
_ALONG_PX = 2.0
# Fewest and most points around an outline, which otherwise are a pixel apart.
FEWEST, _MOST = 180, 1440
# How far profiles reach to either side, in pixels, and how far off an edge may be.
_SPAN, _REACH = 6.0, 3.0
# Where edges are tried, in pixels; and blurs of lens and demosaicing: how many, and the steps of their standard
# deviations in pixels.
_TRIED = np.arange(-_REACH, _REACH + 1e-9, 0.1)
_BLURS, _BLUR_STEP = 27, 0.1
# Profiles from which the blur is measured.
_EVERY = 4
# An edge leaves this share at most of the variance that a cubic leaves, and is known to this many pixels.
_BETTER, _KNOWN_PX = 0.5, 0.4
# Contrast below which an edge counts for nothing, and error beyond which it does, in those of the others: noise makes
# an edge look like a rim that darkens further out.
_FAINT, _VAGUE = 0.2, 2.0


def disk_sphere(camera: Camera, disk: Disk) -> Sphere | None:
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


def rim(sphere: Sphere, camera: Camera) -> tuple[Floats, Floats]:
    """Points (n, 2) around the sphere's outline in the image, a pixel apart or so, and outward normals (n, 2)."""
    around = 2 * np.pi * sphere.pixel_radius(camera)
    outline = sphere_outline(sphere, camera, int(np.clip(around, FEWEST, _MOST)))
    along = np.roll(outline, -1, axis=0) - np.roll(outline, 1, axis=0)
    outward = np.column_stack([along[:, 1], -along[:, 0]])
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    outward *= np.sign(((outline - outline.mean(axis=0)) * outward).sum(axis=1, keepdims=True))
    return outline, outward


def profiles(picture: Picture, outline: Floats, outward: Floats, span: float) -> Floats:
    """A picture (h, w, c) across an outline, (n, 2 k + 1, c) from -span to span outward, in steps of `STEP`.

    Outside of the picture its edge is repeated.
    """
    half = int(np.ceil(span / STEP)) + 1
    steps = np.arange(-half, half + 1) * STEP
    at = (outline[:, None] + steps[None, :, None] * outward[:, None] - 0.5).astype(np.float32)
    values = cv2.remap(
        np.ascontiguousarray(picture),
        at[..., 0],
        at[..., 1],
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )
    across = values.reshape(*at.shape[:2], -1).astype(float)
    spacing = np.linalg.norm(outline[1] - outline[0])
    return np.asarray(gaussian_filter1d(across, _ALONG_PX / spacing, axis=0, mode="wrap"))


def rim_edges(
    picture: Picture, saturated: Picture, outline: Floats, outward: Floats, blur: float | None = None
) -> tuple[Floats, Bools, float]:
    """Offsets (n,) in pixels outward from an outline at which a sphere's edge lies, where it is a clear one (n,), and
    how blurred it is: a standard deviation in pixels, of 0 to 2.6.

    picture : (h, w, c), linear. saturated : (h, w), nonzero where it is not known. outline, outward : (n, 2), as of
    `rim`, in the picture's pixels. blur : if it is known.
    """
    height, width = picture.shape[:2]
    across = np.moveaxis(profiles(picture, outline, outward, _SPAN), 2, 1)
    across -= across.mean(axis=2, keepdims=True)
    _, channels, samples = across.shape
    plain = _left(across, _smooth_basis(samples)[None])[:, 0]
    if blur is None:
        blur = _likely_blur(across[::_EVERY], plain[::_EVERY])
    cost = _left(across, _edge_bases(samples, blur))
    best = np.clip(cost.argmin(axis=1), 1, len(_TRIED) - 2)
    before, least, after = (np.take_along_axis(cost, (best + k)[:, None], axis=1)[:, 0] for k in (-1, 0, 1))
    curvature = np.maximum(before - 2 * least + after, 1e-300)
    step = _TRIED[1] - _TRIED[0]
    offset = _TRIED[best] + np.clip((before - after) / (2 * curvature), -1, 1) * step
    # Half of a profile's samples are independent, being half a pixel apart.
    freedom = channels * (samples / 2 - 5)
    error = step * np.sqrt(2 * np.maximum(least, 0) / freedom / curvature)
    known = (outline > 1).all(axis=1) & (outline < [width - 1, height - 1]).all(axis=1)
    known &= profiles(saturated[..., None], outline, outward, _REACH).max(axis=(1, 2)) == 0
    clear = (least < _BETTER * plain) & (error < _KNOWN_PX) & (np.abs(offset) < _REACH - step) & known
    if clear.any():
        # Where a shadow begins or ends at the rim it is faint, and elsewhere than it seems.
        contrast = np.ptp(profiles(picture, outline, outward, _REACH), axis=1).max(axis=1)
        clear &= contrast > _FAINT * np.median(contrast[clear])
        clear &= error < _VAGUE * np.median(error[clear])
    return offset, clear, blur


def _left(across: Floats, bases: Floats) -> Floats:
    """Squares (n, e) that bases (e, k, p) leave of profiles (n, c, k), all channels together."""
    flat = across.reshape(-1, across.shape[2])
    explained = (flat @ np.moveaxis(bases, 1, 0).reshape(flat.shape[1], -1)) ** 2
    rest = (flat**2).sum(axis=1)[:, None] - explained.reshape(len(flat), len(bases), -1).sum(axis=2)
    return np.asarray(rest.reshape(*across.shape[:2], len(bases)).sum(axis=1))


def _likely_blur(across: Floats, plain: Floats) -> float:
    """The blur, in pixels, with which edges explain profiles (n, c, k) best; a cubic leaves plain (n,) of them.

    A wrong one would move the edge by as much as it is wrong, for a blurred edge looks like a dark rim.
    """
    shares = np.full(_BLURS, np.inf)
    for every in (4, 1):
        centre = int(shares.argmin()) if every == 1 else 0
        for k in (
            range(max(0, centre - 3), min(_BLURS, centre + 4)) if every == 1 else range(0, _BLURS, every)
        ):
            cost = _left(across, _edge_bases(across.shape[2], k * _BLUR_STEP))
            shares[k] = np.quantile(cost.min(axis=1) / np.maximum(plain, 1e-300), 0.25)
    best = int(np.clip(shares.argmin(), 1, _BLURS - 2))
    before, least, after = shares[best - 1 : best + 2]
    bend = before - 2 * least + after
    shift = np.clip((before - after) / (2 * bend), -1, 1) if np.isfinite(bend) and bend > 0 else 0.0
    return round((best + float(shift)) * _BLUR_STEP, 2)


@cache
def _smooth_basis(count: int) -> Floats:
    """Orthonormal cubics (count, 4): profiles without an edge."""
    at = np.linspace(-1, 1, count)
    return np.linalg.qr(np.vander(at, 4))[0]


@lru_cache(maxsize=128)
def _edge_bases(count: int, blur: float) -> Floats:
    """Orthonormal bases (e, count, 5) of profiles with an edge at each of `_TRIED`.

    Inside 1, the root of the depth beneath the edge, and the depth; outside 1 and the height above it; all blurred.
    """
    shifts, weights = _kernel(blur)
    height = (np.arange(count) - count // 2) * STEP - _TRIED[:, None]
    height = height[..., None] - shifts
    depth = np.maximum(-height, 0)
    pieces = (depth > 0, np.sqrt(depth), depth, height >= 0, np.maximum(height, 0))
    return np.linalg.qr(np.stack([piece @ weights for piece in pieces], axis=-1))[0]


def _kernel(blur: float) -> tuple[Floats, Floats]:
    """Offsets in pixels and weights of what blurs a profile: a pixel, linear interpolation, and a Gaussian."""
    fine = 16
    box = np.ones(fine) / fine
    pixel = np.convolve(np.convolve(box, box), box)
    half = round(4 * blur * fine)
    gaussian = np.exp(-0.5 * (np.arange(-half, half + 1) / max(blur * fine, 1e-9)) ** 2)
    weights = np.convolve(pixel, gaussian / gaussian.sum())
    return (np.arange(len(weights)) - (len(weights) - 1) / 2) / fine, weights
