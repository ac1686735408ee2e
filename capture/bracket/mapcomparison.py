"""A radiance map against another of the same scene, up to one scale per channel."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from capture.bracket.hdr import Merge
from capture.decode import decode

# Edges of what no light explains (borders of scans) blend over a few pixels.
_MARGIN = np.ones((9, 9), np.uint8)


@dataclass(frozen=True, eq=False)
class ChannelDifference:
    """Relative difference of one channel. scale : what the other map was multiplied by, the median ratio."""

    scale: float
    median: float
    quantile90: float


@dataclass(frozen=True, eq=False)
class Comparison:
    """How a merge differs from another map. difference : (h, w, 3) float32, merged / (scale x other) - 1; NaN where not
    compared: saturated, contradicted, or not positive in the other."""

    name: str
    channels: tuple[ChannelDifference, ...]
    difference: NDArray[np.float32]


def compare_maps(merged: Merge, path: Path) -> Comparison:
    """Compare with an EXR or .hdr of the same size. ValueError if it isn't, or if nothing can be compared."""
    other = decode(path).radiance
    if other.shape != merged.image.radiance.shape:
        raise ValueError(
            f"{path}: is {other.shape[1]}x{other.shape[0]} pixels, but the bracket is"
            f" {merged.image.radiance.shape[1]}x{merged.image.radiance.shape[0]}; compare maps of one size"
        )
    near = cv2.dilate(merged.contradicted.astype(np.uint8), _MARGIN) > 0
    compared = ~merged.image.saturated & ~near & (other > 0).all(axis=2)
    if not compared.any():
        raise ValueError(f"{path}: no pixel is known in both maps, so that there is nothing to compare")
    ratio = merged.image.radiance / np.where(compared[..., None], other, 1)
    scale = np.median(ratio[compared], axis=0)
    difference = np.where(compared[..., None], ratio / scale - 1, np.nan).astype(np.float32)
    size = np.abs(difference[compared])
    channels = tuple(
        ChannelDifference(float(scale[c]), float(np.median(size[:, c])), float(np.quantile(size[:, c], 0.9)))
        for c in range(3)
    )
    return Comparison(path.name, channels, difference)
