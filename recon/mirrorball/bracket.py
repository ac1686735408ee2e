"""A bracket of one view of a mirror ball, aligned on the ball and merged; and the ball found in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from capture.bracket.hdr import merge
from capture.camera import Camera
from capture.radiance import RadianceImage
from capture.source_region import SourceRegion
from recon.mirrorball.find import find_ball
from recon.mirrorball.shift import WHOLE, Window, bracket_shifts, moved_image
from recon.mirrorball.view import CAMERA_MASK_DEG, BallView, view_ball
from recon.sphere.circle import Disk
from recon.sphere.sphere import Sphere

# What of the picture, in radii about the ball's centre, aligns it: the ball, and little of what is farther away.
_ABOUT_BALL = 1.2
# Standard deviations of its noise that a short exposure's signal must reach to count.
_SIGNAL = 3.0


def view_bracket(
    images: Sequence[RadianceImage],
    camera: Camera,
    name: str,
    mask: NDArray[np.float32] | None = None,
    background: RadianceImage | None = None,
    disk: Disk | None = None,
    reflectance: Sequence[float] = (1.0, 1.0, 1.0),
    camera_mask_deg: float = CAMERA_MASK_DEG,
    exposures: Sequence[float] = (1.0,),
    source_region: SourceRegion | None = None,
) -> tuple[BallView, RadianceImage]:
    """One view of a mirror ball from its photograph, or from several of different exposure; and its radiance.

    images : radiance in one unit, from the longest exposure to the shortest, at least one. They may be shifted
        against each other by a few pixels, as by a camera that is touched between exposures; mask, disk and the
        view's geometry are the first one's.
    mask, background, disk : where the ball is (`recon.mirrorball.find`).
    reflectance, camera_mask_deg, source_region : as in `recon.mirrorball.view`.
    exposures : what was divided out of each image.

    ValueError names the view if the photographs' sizes differ or no ball is found, or if it is black or saturated.
    """
    for image in images[1:]:
        if image.saturated.shape != images[0].saturated.shape:
            sizes = [f"{w}x{h}" for h, w in (each.saturated.shape for each in (images[0], image))]
            raise ValueError(
                f"{name}: a bracket's photographs must be of one size; they are {' and '.join(sizes)}"
            )
    aligned = _aligned(images, WHOLE)
    merged = _merged(aligned, exposures)
    sphere, guessed = find_ball(merged, camera, name, mask, background, disk)
    if len(images) > 1:
        # What is behind the ball moves otherwise than the ball does when the camera does.
        aligned = _aligned(images, _about(sphere, camera))
        merged = _merged(aligned, exposures)
        sphere, guessed = find_ball(merged, camera, name, mask, background, disk)
    view = view_ball(merged, sphere, mask, camera, name, reflectance, camera_mask_deg, source_region)
    (left, top), (h, w) = view.corner, view.in_source.shape
    window = slice(top, top + h), slice(left, left + w)
    factors = []
    for one, other in pairwise(aligned):
        both = _above_noise(aligned[0], one) & _above_noise(aligned[0], other)
        shown = np.asarray(both.all(axis=2))
        factors.append(_factor(one, other, window, view.pixels.usable & shown[window]))
    return replace(view, bracket_factors=tuple(factors), guessed=guessed), merged


def _about(sphere: Sphere, camera: Camera) -> Window:
    x, y = camera.project(sphere.centre[None])[0]
    reach = _ABOUT_BALL * sphere.pixel_radius(camera)
    rows, columns = (slice(max(int(c - reach), 0), max(int(c + reach) + 1, 1)) for c in (y, x))
    return rows, columns


def _aligned(images: Sequence[RadianceImage], window: Window) -> list[RadianceImage]:
    """The photographs of a bracket, shifted to the first by what a part of the picture shows."""
    shifts = bracket_shifts(images, window)
    return [moved_image(image, shift) for image, shift in zip(images, shifts, strict=True)]


def _merged(images: Sequence[RadianceImage], exposures: Sequence[float]) -> RadianceImage:
    if len(images) == 1:
        return images[0]

    def load(index: int) -> tuple[RadianceImage, NDArray[np.bool_]]:
        image = images[index]
        return image, np.broadcast_to(~image.saturated[..., None], image.radiance.shape)

    return merge(load, exposures).image


def _above_noise(longer: RadianceImage, shorter: RadianceImage) -> NDArray[np.bool_]:
    """Where (h, w, 3) a shorter exposure shows light, not noise: that is clipped at black, and too bright on average.

    Judged by the longer exposure, so that no noisy number decides about itself.
    """
    shows = longer.radiance > _SIGNAL * np.sqrt(shorter.variance)
    return np.asarray(longer.saturated[..., None] | shows)


def _factor(one: RadianceImage, other: RadianceImage, window: Window, usable: NDArray[np.bool_]) -> float:
    """How many times as bright another photograph shows the brighter half of what both show unsaturated."""
    first, second = (image.radiance[window].mean(axis=2) for image in (one, other))
    both = usable & ~one.saturated[window] & ~other.saturated[window]
    bright = both & (first >= np.median(first[both])) if both.any() else both
    total = float(first[bright].sum())
    return float(second[bright].sum()) / total if total > 0 and second[bright].sum() > 0 else 1.0
