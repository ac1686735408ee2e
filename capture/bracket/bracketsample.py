"""Samples of a bracket's codes: the same pixels in every photograph, spread over the picture and over the codes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from capture.arrays import frozen_array
from capture.files.imagefile import read_image
from capture.radiance import LOSSY_REACH

Floats = NDArray[np.float64]
Codes = NDArray[Any]
# Observations per channel that a fit is given; more cost time and add little.
_OBSERVATIONS = 60_000
_MAX_PIXELS = 12_000
# The picture is divided into this many patches each way: errors within a patch count as correlated.
_PATCHES = 16
_STRATA = 64
# JPEG rounds noise of up to about this away, a standard deviation in shares of the top code: what is left to see
# of a photograph's noise doesn't show how large it was when the codes were made.
_JPEG_HIDES = 1.5 / 255


@dataclass(frozen=True, eq=False)
class BracketSample:
    """Codes of the same pixels in every photograph of a bracket.

    values : (3, n, p) float64, channel, pixel, photograph; share of the file's top code, 0 to 1.
    usable : (3, n, p) bool, where a code is neither clipped below nor above, nor spoilt by a clipped neighbour.
    patch : (n,) intp, which patch of the picture a pixel lies in.
    clip : (3, 2) float64, the values at which a channel clips below and above; outside 0 to 1 where it doesn't.
    step : the distance between neighbouring codes, 1/255 or 1/65535.
    hidden_noise : standard deviation, share of the top code, of noise that compression may have removed; 0 for none.
    """

    values: Floats
    usable: NDArray[np.bool_]
    patch: NDArray[np.intp]
    clip: Floats
    step: float
    hidden_noise: float = 0.0

    def __post_init__(self) -> None:
        for name in ("values", "clip"):
            object.__setattr__(self, name, frozen_array(getattr(self, name)))
        object.__setattr__(self, "patch", frozen_array(self.patch, np.intp))
        object.__setattr__(self, "usable", frozen_array(self.usable, np.bool_))

    def part(self, pixels: NDArray[np.bool_]) -> BracketSample:
        """The sample reduced to some pixels, a mask (n,)."""
        return replace(
            self, values=self.values[:, pixels], usable=self.usable[:, pixels], patch=self.patch[pixels]
        )


def sample_bracket(paths: Sequence[Path], rng: np.random.Generator) -> BracketSample:
    """Read a bracket of 8- or 16-bit files twice and sample it; memory doesn't grow with their number.

    Pixels are drawn evenly over the brightness of the scene (so that every code is seen), from the half with the
    smaller gradients, where a slight misalignment does least. A pixel's own code has no part in its gradient:
    choosing by it would choose the noise. ValueError names a file whose size or depth differs, or which isn't
    integer.
    """
    if len(paths) < 2:
        raise ValueError(
            f"{paths[0] if paths else 'no photograph'}: a bracket needs two or more photographs of one scene"
            " with different exposures"
        )
    first, _ = _read_codes(paths[0])
    histogram = np.zeros((3, _top(first) + 1), np.int64)
    brightness = np.zeros(first.shape[:2], np.float32)
    gradient = np.zeros(first.shape[:2], np.float32)
    for path in paths:
        pixels, _ = _read_codes(path, first, paths[0])
        for channel in range(3):
            histogram[channel] += np.bincount(pixels[..., channel].ravel(), minlength=histogram.shape[1])
        mean = pixels.astype(np.float32).mean(axis=2)
        brightness += mean
        gradient += np.hypot(cv2.Sobel(mean, cv2.CV_32F, 1, 0), cv2.Sobel(mean, cv2.CV_32F, 0, 1))
    clip = np.array([_clip_values(counts) for counts in histogram])
    count = min(_MAX_PIXELS, _OBSERVATIONS // len(paths))
    chosen = _spread(brightness.ravel(), gradient.ravel(), count, rng)
    top = float(_top(first))
    values, usable, any_lossy = [], [], False
    for path in paths:
        pixels, lossy = _read_codes(path, first, paths[0])
        any_lossy |= lossy
        values.append(pixels.reshape(-1, 3)[chosen] / top)
        usable.append(_inside(pixels, clip * top, lossy).reshape(-1, 3)[chosen])
    rows, columns = np.divmod(chosen, first.shape[1])
    patch = (rows * _PATCHES // first.shape[0]) * _PATCHES + columns * _PATCHES // first.shape[1]
    return BracketSample(
        values=np.stack(values, axis=-1).transpose(1, 0, 2),
        usable=np.stack(usable, axis=-1).transpose(1, 0, 2),
        patch=patch,
        clip=clip,
        step=1 / top,
        hidden_noise=_JPEG_HIDES if any_lossy else 0.0,
    )


def _inside(pixels: Codes, clip: Floats, lossy: bool) -> NDArray[np.bool_]:
    """(h, w, 3), where codes lie between the clipping codes, and in a JPEG no neighbour is saturated in any channel."""
    inside = (pixels > clip[:, 0]) & (pixels < clip[:, 1])
    if lossy:
        whole = np.asarray((pixels < clip[:, 1]).all(axis=2), np.uint8)
        inside &= (cv2.erode(whole, LOSSY_REACH) > 0)[..., None]
    return np.asarray(inside)


def _top(pixels: Codes) -> int:
    return 255 if pixels.dtype == np.uint8 else 65535


def _read_codes(path: Path, like: Codes | None = None, like_path: Path | None = None) -> tuple[Codes, bool]:
    pixels, header = read_image(path)
    if pixels.dtype not in (np.uint8, np.uint16):
        raise ValueError(
            f"{path}: holds {pixels.dtype} numbers, which are linear already; a response is recovered from 8- or"
            " 16-bit photographs"
        )
    if like is not None and pixels.shape != like.shape:
        raise ValueError(
            f"{path}: is {pixels.shape[1]}x{pixels.shape[0]} pixels, but {like_path} is"
            f" {like.shape[1]}x{like.shape[0]}; a bracket's photographs must be of one size"
        )
    if like is not None and pixels.dtype != like.dtype:
        raise ValueError(
            f"{path}: is {pixels.dtype}, but {like_path} is {like.dtype}; a bracket's files must be of one depth"
        )
    return pixels, header.lossy


def _clip_values(counts: NDArray[np.int64]) -> tuple[float, float]:
    """The values at which codes pile up below and above, from their counts; -1 and 2 where nothing clips."""
    codes = np.flatnonzero(counts)
    top = len(counts) - 1
    # As wide as a few codes of 8 bits.
    near = max(1, 4 * (top + 1) // 256)

    def piled(code: int, side: slice) -> bool:
        return bool(counts[code] > 4 * max(counts[side].max(initial=0), 4))

    low, high = int(codes[0]), int(codes[-1])
    clips_below = low < top / 2 and (low == 0 or piled(low, slice(low + 1, low + 1 + near)))
    clips_above = high > top / 2 and (high == top or piled(high, slice(max(high - near, 0), high)))
    return (low / top if clips_below else -1.0), (high / top if clips_above else 2.0)


def _spread(
    brightness: NDArray[np.float32], gradient: NDArray[np.float32], count: int, rng: np.random.Generator
) -> NDArray[np.intp]:
    """Indices of at most `count` pixels, evenly over brightness, in each stratum from the flatter half."""
    if len(brightness) <= count:
        return np.arange(len(brightness))
    low, high = float(brightness.min()), float(brightness.max())
    stratum = ((brightness - low) * (_STRATA / max(high - low, 1e-9))).astype(int).clip(0, _STRATA - 1)
    members = [np.flatnonzero(stratum == index) for index in range(_STRATA)]
    flat = [one[gradient[one] <= np.median(gradient[one])] if len(one) > 8 else one for one in members]
    # The same number from each stratum, and what small strata leave is shared among the others.
    left, chosen = count, []
    for position, one in enumerate(sorted(flat, key=len)):
        share = min(len(one), left // (_STRATA - position))
        chosen.append(rng.choice(one, share, replace=False))
        left -= share
    return np.sort(np.concatenate(chosen))
