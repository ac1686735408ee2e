"""Plain fits to the real ball, made with its true normals at hand: what the product is measured against."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize, nnls

from benchmarks.gloss.photosets import Lamps

Floats = NDArray[np.float64]

# Pixels within this angle of the mirror direction are all taken, of the others one in so many, which stands for them.
_NEAR, _SHARE = np.radians(8.0), 16


def ball_pixels(source: Path, name: str) -> tuple[Floats, NDArray[np.bool_], NDArray[np.bool_]]:
    """A photograph (h, w, 3) in 0 to 1, which of its pixels are the ball's, and which are saturated, (h, w) each."""
    photo = cv2.imread(str(source / f"{name}.png"), cv2.IMREAD_UNCHANGED)[:, :, ::-1]
    mask = cv2.imread(str(source / "mask.png"), cv2.IMREAD_GRAYSCALE) > 0
    return photo / 65535.0, mask, (photo >= 65535).any(axis=2)


class Peers:
    """Least squares over all unsaturated pixels: Kd and the strengths of GGX lobes, per channel, none negative."""

    def __init__(self, source: Path, lamps: Lamps) -> None:
        normals = np.load(source / "normals.npz")["normals"].astype(float)
        size = np.linalg.norm(normals, axis=2)
        rng = np.random.default_rng(0)
        self._photos = []
        for name, direction, irradiance in zip(lamps.names, lamps.directions, lamps.irradiances, strict=True):
            photo, mask, saturated = ball_pixels(source, name)
            used = mask & (size > 0.5) & ~saturated
            n = normals[used] / size[used][:, None]
            half = direction + np.array([0.0, 0.0, 1.0])
            half /= np.linalg.norm(half)
            theta = np.arctan2(np.linalg.norm(np.cross(n, half), axis=1), n @ half)
            near = theta < _NEAR
            taken = near | (rng.random(len(n)) < 1 / _SHARE)
            weight = np.where(near, 1, _SHARE)[taken] / (photo[used] ** 2).sum()
            cos = np.maximum(n @ direction, 0)[taken]
            self._photos.append(
                (theta[taken], cos, np.maximum(n[taken, 2], 0.05), photo[used][taken], weight, irradiance)
            )

    def errors(self, fitted: Sequence[int], held_out: Sequence[int], lobes: int) -> tuple[float, float]:
        """Mean relative RMS of fitted and of held-out photographs by a base and so many lobes."""
        if not lobes:
            return self._errors(fitted, held_out, ())
        start = np.log([0.03, 0.3][:lobes])
        found = minimize(
            lambda x: self._errors(fitted, held_out, np.exp(x))[0],
            start,
            method="Nelder-Mead",
            options={"xatol": 0.01, "fatol": 1e-6, "maxfev": 120},
        )
        return self._errors(fitted, held_out, np.exp(found.x))

    def _errors(
        self, fitted: Sequence[int], held_out: Sequence[int], widths: Sequence[float] | Floats
    ) -> tuple[float, float]:
        columns = {k: self._columns(k, widths) for k in (*fitted, *held_out)}
        left = {k: np.zeros(3) for k in columns}
        for channel in range(3):
            rows, values = [], []
            for k in fitted:
                _, _, _, photo, weight, irradiance = self._photos[k]
                root = np.sqrt(weight)
                rows.append(columns[k] * (irradiance[channel] * root)[:, None])
                values.append(photo[:, channel] * root)
            best = nnls(np.concatenate(rows), np.concatenate(values))[0]
            for k in columns:
                _, _, _, photo, weight, irradiance = self._photos[k]
                off = photo[:, channel] - columns[k] @ best * irradiance[channel]
                left[k][channel] = weight @ off**2
        mean = [float(np.mean([np.sqrt(left[k].sum()) for k in part])) for part in (fitted, held_out)]
        return mean[0], mean[1]

    def _columns(self, k: int, widths: Sequence[float] | Floats) -> Floats:
        theta, cos, cos_out, *_ = self._photos[k]
        columns = [cos]
        for a in widths:
            cos2 = np.cos(theta) ** 2
            density = a**2 / (np.pi * (cos2 * (a**2 - 1) + 1) ** 2)
            hidden = sum(
                (np.sqrt(1 + a**2 * (1 / np.maximum(c, 1e-3) ** 2 - 1)) - 1) / 2 for c in (cos, cos_out)
            )
            columns.append(np.where(cos > 0, density / (1 + hidden) / (4 * cos_out), 0))
        return np.stack(columns, axis=1)
