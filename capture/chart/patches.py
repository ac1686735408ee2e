"""What a photograph shows of a chart's patches."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from capture.chart.chartsearch import FoundChart
from capture.radiance import RadianceImage

Floats = NDArray[np.float64]

# Pixels of a patch that lie further from its median than so many deviations are dust or scratches.
_DUST = 3.0
# Pixels of a patch that are needed; share of them that may be cut off.
_FEWEST, _CUT_OFF = 25, 0.01


@dataclass(frozen=True, eq=False)
class SeenPatches:
    """Colours of a chart's patches in one photograph.

    rgb, std : (n, 3), means of each patch's pixels, linear camera RGB, and standard deviations of these means by the
    pixels' scatter. centres : (n, 2) pixels. cut_off : (n,) bool, whether a patch is saturated.
    """

    rgb: Floats
    std: Floats
    centres: Floats
    cut_off: NDArray[np.bool_]


def seen_patches(image: RadianceImage, chart: FoundChart) -> SeenPatches:
    """The patches of a chart in a photograph; ValueError where they are too small."""
    quads = chart.patches()
    rgb, std = np.empty((len(quads), 3)), np.empty((len(quads), 3))
    cut_off = np.zeros(len(quads), bool)
    for k, quad in enumerate(quads):
        low = np.floor(quad.min(axis=0)).astype(int)
        high = np.ceil(quad.max(axis=0)).astype(int) + 1
        here = np.s_[low[1] : high[1], low[0] : high[0]]
        inside = np.zeros(image.saturated[here].shape, np.uint8)
        cv2.fillConvexPoly(inside, np.round(quad - low).astype(np.int32), 1)
        pixels = image.radiance[here][inside > 0].astype(float)
        if len(pixels) < _FEWEST:
            raise ValueError(
                f"patch {k + 1} of the chart has {len(pixels)} pixels in its middle, {_FEWEST} are needed: go nearer"
            )
        cut_off[k] = image.saturated[here][inside > 0].mean() > _CUT_OFF
        middle = np.median(pixels, axis=0)
        away = np.abs(pixels - middle)
        clean = pixels[(away <= _DUST * 1.4826 * np.median(away, axis=0) + 1e-12).all(axis=1)]
        clean = clean if len(clean) > len(pixels) / 2 else pixels
        rgb[k] = clean.mean(axis=0)
        # Neighbours share photosites: as if a quarter of the pixels were independent.
        std[k] = clean.std(axis=0) / np.sqrt(len(clean) / 4)
    return SeenPatches(rgb, std, quads.mean(axis=1), cut_off)
