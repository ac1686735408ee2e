"""A flat field pixel by pixel: the mean of several photographs, of which noise is taken away but no detail."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from capture.radiance import RadianceImage
from capture.sensor.flatfield import FlatFieldMap, RadialFlatField, half_diagonal
from capture.sensor.flatlight import light_over

Floats = NDArray[np.float64]
Image = NDArray[np.float32]

# Standard deviations of the Gaussians between which bands of detail lie, pixels; 0 is none.
_WIDTHS = (0.0, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
# The energy of noise in a neighbourhood scatters by about this share, and is no detail.
_DOUBT = 0.2
# A dead pixel is this many deviations off the median of its 3x3 neighbourhood; dust is wider.
_DEAD = 8.0


def fit_map(
    images: Iterable[RadianceImage], radial: RadialFlatField, light: Floats, light_covariance: Floats
) -> FlatFieldMap:
    """A map of the illumination.

    images : the flat-field photographs. radial : fitted to them: only what departs from it is smoothed, so that
    smoothing bends nothing at the borders. light : (p, 4) in each, as in `flatlight`, which is divided out;
    light_covariance : (3, 3) of their mean gradient and a bowl, which bend the map where they are off.

    What departs is split into bands of detail, and each is weakened to the share that detail has of its energy in the
    neighbourhood: a local Wiener filter (Lee, "Digital image enhancement and noise filtering by use of local
    statistics", 1980), whose error is that share of the noise. The noise is that between two halves of the
    photographs; of a single one, what most of its pixels have, grain of the sensor included. Their variance is what
    compression lost: as much again in the mean, for it loses the same of each.
    """
    halves = [np.zeros((radial.height, radial.width, 3), np.float32) for _ in range(2)]
    counts = [0, 0]
    compression = np.zeros(3)
    lens = radial.gain(radial.width, radial.height)
    for number, (image, own) in enumerate(zip(images, light, strict=True)):
        ratio = image.radiance / (lens * light_over(radial.width, radial.height, own)[..., None])
        halves[number % 2] += ratio / np.median(ratio[::4, ::4], axis=(0, 1))
        counts[number % 2] += 1
        compression += np.mean(
            image.variance / np.maximum(image.radiance, 1e-6) ** 2, axis=(0, 1), dtype=float
        )
    parts = [_without_dead(half / count) for half, count in zip(halves, counts, strict=True) if count]
    detail, relative_std = _without_noise(parts, counts, np.sqrt(lens))
    # Coordinates in half diagonals, and the square of the radius, uniform over the image, have these mean squares.
    x, y = np.array([radial.width, radial.height]) ** 2 / (
        12 * half_diagonal(radial.width, radial.height) ** 2
    )
    squares = np.array([x, y, 9 / 5 * (x**2 + y**2) + 2 * x * y])
    relative_std = np.sqrt(relative_std**2 + squares @ np.diag(light_covariance) + compression / sum(counts))
    illumination = detail * lens
    side = max(radial.width // 32, 3)
    brightest = cv2.blur(illumination, (side, side)).max(axis=(0, 1))
    return FlatFieldMap(illumination / brightest, relative_std)


def _without_noise(parts: Sequence[Image], counts: Sequence[int], steadiness: Image) -> tuple[Image, Floats]:
    """The mean of the parts without its noise (h, w, 3), and the relative standard deviation of what is left (3,).

    steadiness : (h, w, 3), the inverse of the relative noise, up to a factor: shot noise is less where it is bright.
    """
    one, two = parts[0], parts[-1]
    mean = one if len(parts) == 1 else (counts[0] * one + counts[1] * two) / np.float32(sum(counts))
    # Between halves of p and q photographs the difference has (p + q)^2 / (p q) times the mean's variance.
    noise = (one - two) * np.float32(np.sqrt(counts[0] * counts[1]) / sum(counts))
    result, variance = np.zeros_like(mean), np.zeros(3)
    for narrow, wide in pairwise(_WIDTHS):
        band = (_blurred(mean, narrow) - _blurred(mean, wide)) * steadiness
        if len(parts) > 1:
            of_noise = (_blurred(noise, narrow) - _blurred(noise, wide)) * steadiness
            power = np.mean(of_noise.astype(float) ** 2, axis=(0, 1))
        else:
            power = (1.4826 * np.median(np.abs(band), axis=(0, 1))) ** 2
        energy = np.maximum(_blurred(band**2, 2 * wide), 1e-20)
        share = np.maximum(1 - (1 + _DOUBT) * power.astype(np.float32) / energy, 0)
        result += share * band / steadiness
        variance += np.mean(share / steadiness**2, axis=(0, 1), dtype=float) * power
    result += _blurred(mean, _WIDTHS[-1])
    return result, np.sqrt(variance + np.mean(_blurred(noise, _WIDTHS[-1]).astype(float) ** 2, axis=(0, 1)))


def _blurred(image: Image, width: float) -> Image:
    if width == 0:
        return image
    size = 2 * int(4 * width + 0.5) + 1
    return np.asarray(cv2.GaussianBlur(image, (size, size), width, borderType=cv2.BORDER_REFLECT), np.float32)


def _without_dead(image: NDArray[np.floating]) -> Image:
    """The same with dead and hot pixels replaced by the median of their neighbourhood."""
    result = image.astype(np.float32)
    for channel in range(3):
        plane = np.ascontiguousarray(result[..., channel])
        median = cv2.medianBlur(plane, 3)
        off = np.abs(plane - median)
        dead = off > _DEAD * 1.4826 * max(float(np.median(off)), 1e-6)
        result[..., channel] = np.where(dead, median, plane)
    return result
