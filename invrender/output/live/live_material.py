"""Kd and Ks of a live picture, over texture coordinates or at vertices, as the graphics card holds them."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from capture.srgb import linear_to_srgb
from invrender.result.reflectance import Reflectance
from invrender.result.saved_textures import filled

Floats = NDArray[np.float64]

# Texels to a side that live pictures hold.
_MOST_TEXELS = 1024
# Where less than this of a point's texels or vertices is known, it isn't drawn.
LEAST_KNOWN = 0.5


@dataclass(frozen=True, eq=False)
class LiveReflectance:
    """Kd or Ks: the product of a scale, a map over texture coordinates, and values at vertices.

    scale : (3,). codes : (h, w, 4) sRGB with the share that is known in the fourth channel; the first row at v = 1; one
    texel where no map is. at_vertices : (v, 4) float16, the share that is known in the last column; ones where nothing
    varies from vertex to vertex.
    """

    scale: Floats
    codes: NDArray[np.uint8]
    at_vertices: NDArray[np.float16]

    @property
    def has_gaps(self) -> bool:
        """Whether some of it isn't known."""
        return bool(
            self.codes[..., 3].min() < 255 * LEAST_KNOWN or self.at_vertices[:, 3].min() < LEAST_KNOWN
        )


def live_reflectances(material: Reflectance, vertices: int) -> tuple[LiveReflectance, LiveReflectance]:
    """Kd and Ks of a reflectance on a mesh of so many vertices."""
    brdf, textures = material.brdf, material.textures
    white, ones = np.full((1, 1, 4), 255, np.uint8), np.ones((vertices, 4), np.float16)
    if textures is None:
        return LiveReflectance(brdf.kd, white, ones), LiveReflectance(brdf.ks, white, ones)
    found = []
    for texels in (textures.kd, textures.ks):
        texels = filled(texels, textures.known)
        scale = np.maximum(texels.max(axis=(0, 1)), np.finfo(np.float32).tiny)
        share = np.ones(texels.shape[:2])
        if textures.known is not None and texels.shape[:2] == textures.known.shape:
            share = textures.known
        if textures.at_vertices:
            row = np.concatenate([texels / scale, share[..., None]], axis=2)[0]
            found.append(
                LiveReflectance(scale, white, np.broadcast_to(row, (vertices, 4)).astype(np.float16))
            )
        else:
            found.append(LiveReflectance(scale, _codes(texels / scale, share), ones))
    return found[0], found[1]


def _codes(texels: Floats, known: Floats) -> NDArray[np.uint8]:
    """sRGB codes (h, w, 4) of a map, made smaller where it is too large."""
    height, width = texels.shape[:2]
    shrink = max(height, width) / _MOST_TEXELS
    if shrink > 1:
        size = max(round(width / shrink), 1), max(round(height / shrink), 1)
        texels, known = (
            cv2.resize(each, size, interpolation=cv2.INTER_AREA).astype(float) for each in (texels, known)
        )
    return np.round(255 * np.dstack([linear_to_srgb(np.clip(texels, 0, 1)), known])).astype(np.uint8)
