"""The reflection map in the world's axes: for a distant viewer the harmonics of the view are the same in all pixels.

    B(R, V) = sum_pq B^_pq(alpha, beta) Y_pq(V)                                                        [R02, eq. 5.11]

Its coefficients are the local map's, turned from the frame of R to the world [R02, eq. 5.12 to 5.14]. Local ones spin
with that frame about the poles, where it is undefined. These are as smooth as what is reflected,
and can be interpolated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capture.lighting import latlong_pixels
from invrender.prefilter.reflectionmap import ReflectionMap
from recon.harmonics.basis import degree_of, evaluate_harmonics
from recon.harmonics.wigner import complex_from_real, wigner_d

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class GlobalReflectionMap:
    """B^_pq(alpha, beta), ((p_max + 1)^2, c, H, 2H) single precision, at the pixel centres of a lat-long grid of R."""

    maps: Singles

    def seen_from(self, viewers: ArrayLike) -> Singles:
        """The one reflection map (n, c, H, 2H) of each distant viewer in a direction (n, 3), unit [R02, eq. 5.35].

        Raises ValueError for directions that aren't unit.
        """
        basis = evaluate_harmonics(viewers, degree_of(len(self.maps))).astype(np.float32)
        return np.tensordot(basis, self.maps, axes=1)

    def radiance(self, centres: Floats, views: Floats) -> Floats:
        """Radiance (n, c) at directions R (n, 3) seen from (n, 3), all unit; linear between pixels."""
        basis = evaluate_harmonics(views, degree_of(len(self.maps)))
        return np.einsum("nk,knc->nc", basis, [interpolated(each, centres) for each in self.maps])


def global_map(local: ReflectionMap) -> GlobalReflectionMap:
    """The global of a local reflection map [R02, eq. 5.14], in real harmonics."""
    height = local.maps.shape[2]
    p_max = degree_of(len(local.maps))
    alpha, beta = ((np.arange(count) + 0.5) * np.pi / height for count in (height, 2 * height))
    turned = np.empty_like(local.maps)
    for p, matrix in enumerate(wigner_d(p_max, -alpha)):
        own = slice(p * p, (p + 1) ** 2)
        mixing = complex_from_real(p)
        # y(Ry(-alpha) w) = M^T d(-alpha) conj(M) y(w) of real harmonics y.
        tilted = (mixing.T @ matrix @ mixing.conj()).real.astype(np.float32)
        level = np.einsum("hsq,schw->qchw", tilted, local.maps[own])
        q = np.arange(-p, p + 1)[:, None, None, None]
        cosine, sine = np.cos(q * beta).astype(np.float32), np.sin(q * beta).astype(np.float32)
        turned[own] = cosine * level - sine * level[::-1]
    return GlobalReflectionMap(turned)


def interpolated(values: Singles, directions: Floats) -> Floats:
    """Values (n, c) of a lat-long grid (c, H, 2H) at directions (n, 3), linear between pixel centres."""
    height = values.shape[1]
    # Over the poles comes the row on the other side.
    padded = np.concatenate([values[:, :1], values, values[:, -1:]], axis=1)
    padded[:, [0, -1]] = np.roll(padded[:, [0, -1]], height, axis=2)
    row, column = latlong_pixels(directions, height)
    row, column = row + 0.5, column - 0.5
    top, left = np.floor(row).astype(int).clip(0, height), np.floor(column).astype(int)
    down, right = row - top, column - left
    corners = [padded[:, top + i, (left + j) % (2 * height)] for i in (0, 1) for j in (0, 1)]
    weights = [(1 - down) * (1 - right), (1 - down) * right, down * (1 - right), down * right]
    return np.asarray(sum(weight * corner for weight, corner in zip(weights, corners, strict=True))).T
