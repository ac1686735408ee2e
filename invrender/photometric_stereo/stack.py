"""Hand-offs of photometric stereo: what pixels reflect of each lamp, and what is sought of them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
# Cosine to the viewer that a normal keeps at least: a surface that is seen faces the camera.
LEAST_COSINE = 0.02


@dataclass(frozen=True, eq=False)
class PixelStack:
    """Pixels of one camera under lamps.

    reflected : (p, j, 3) float32, radiance over the lamp's irradiance across its beam, 1/sr. variance : (p, j) float32,
    of its noise, mean over channels. usable : (p, j) bool, false where the sensor was saturated. lamps : (1, j, 3), or
    (p, j, 3) of near ones, unit directions towards them. views : (1, 3) or (p, 3), unit, towards the camera. bounced :
    (p, j), what arrives by way of the rest of the object, over the lamp's irradiance; None while nobody knows.
    """

    reflected: NDArray[np.float32]
    variance: NDArray[np.float32]
    usable: NDArray[np.bool_]
    lamps: Floats
    views: Floats
    bounced: Floats | None = None

    def __len__(self) -> int:
        return len(self.reflected)

    @property
    def photos(self) -> int:
        return self.reflected.shape[1]

    def at(self, pixels: NDArray[np.integer] | slice) -> PixelStack:
        """The same of some pixels."""
        return PixelStack(
            self.reflected[pixels],
            self.variance[pixels],
            self.usable[pixels],
            self.lamps if len(self.lamps) == 1 else self.lamps[pixels],
            self.views if len(self.views) == 1 else self.views[pixels],
            None if self.bounced is None else self.bounced[pixels],
        )

    def of_photos(self, photos: NDArray[np.integer]) -> PixelStack:
        """The same of some photographs."""
        return PixelStack(
            self.reflected[:, photos],
            self.variance[:, photos],
            self.usable[:, photos],
            self.lamps[:, photos],
            self.views,
            None if self.bounced is None else self.bounced[:, photos],
        )


@dataclass(frozen=True, eq=False)
class PixelSurface:
    """What pixels show: unit normals (p, 3) in the world, and Kd (p, 3), 1/sr."""

    normals: Floats
    kd: Floats

    def __len__(self) -> int:
        return len(self.normals)

    def at(self, pixels: NDArray[np.integer] | slice) -> PixelSurface:
        """The same of some pixels."""
        return PixelSurface(self.normals[pixels], self.kd[pixels])

    def moved(self, steps: Floats, views: Floats) -> PixelSurface:
        """The surface after steps (p, 5): along both tangents, radians, and in Kd, which never falls below 0."""
        kd = np.maximum(self.kd + steps[:, 2:], 0)
        if not steps[:, :2].any():
            return replace(self, kd=kd)
        right, up = tangents(self.normals)
        normals = self.normals + steps[:, :1] * right + steps[:, 1:2] * up
        return PixelSurface(facing(normals, views), kd)


def tangents(normals: Floats) -> tuple[Floats, Floats]:
    """Two unit vectors (p, 3) across normals (p, 3) and each other."""
    away = np.where(np.abs(normals[:, :1]) < 0.7, np.array([[1.0, 0, 0]]), np.array([[0, 1.0, 0]]))
    right = np.cross(normals, away)
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    return right, np.cross(normals, right)


def facing(normals: Floats, views: Floats) -> Floats:
    """Unit normals (p, 3), turned towards the camera as far as they must be to be seen; views : (1 or p, 3)."""
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = normals / np.maximum(length, 1e-12)
    short = LEAST_COSINE - np.einsum("pk,pk->p", normals, np.broadcast_to(views, normals.shape))
    turned = normals + np.maximum(short, 0)[:, None] * views
    return np.asarray(turned / np.maximum(np.linalg.norm(turned, axis=1, keepdims=True), 1e-12))
