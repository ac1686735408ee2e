"""Isotropic BRDFs from tables over half and difference angles.

The coordinates are Rusinkiewicz's ("A new change of variables for efficient BRDF representation", EGWR 1998), the
layout that of the MERL database (Matusik, Pfister, Brand, McMillan, "A data-driven reflectance model", SIGGRAPH 2003),
with bins that start at

    theta_h = pi/2 (i / n_h)^2,   theta_d = pi/2 j / n_d,   phi_d = pi k / n_p

phi_d covers half a turn, for the other half is the same pair with light and viewer exchanged: every table is
reciprocal.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from capture.arrays import frozen_array
from capture.reflectance.merl import read_merl
from synthetic.materials.material import AnyFloats, Floats, Material, cosine_density, sample_cosine
from synthetic.vectors import dot


class RusinkiewiczAngles(NamedTuple):
    """Rusinkiewicz's coordinates of pairs of directions, radians: theta_h and theta_d 0 to pi/2, phi_d 0 to pi."""

    theta_h: AnyFloats
    theta_d: AnyFloats
    phi_d: AnyFloats


def half_angles(wi: AnyFloats, wo: AnyFloats) -> RusinkiewiczAngles:
    """Coordinates (...,) of local unit directions (..., 3) above the surface, broadcast; keeps the dtype."""
    half, difference = wi + wo, wi - wo
    across = np.hypot(half[..., 0], half[..., 1])
    theta_h = np.arctan2(across, half[..., 2])
    theta_d = np.arctan2(np.sqrt(dot(difference, difference)), np.sqrt(dot(half, half)))
    # The half vector's azimuth; where it is the normal, any.
    upright = across == 0
    safe = np.where(upright, 1, across)
    cos, sin = np.where(upright, 1, half[..., 0] / safe), half[..., 1] / safe
    # Turned so that the half vector becomes the pole.
    outwards = cos * difference[..., 0] + sin * difference[..., 1]
    x = np.cos(theta_h) * outwards - np.sin(theta_h) * difference[..., 2]
    y = cos * difference[..., 1] - sin * difference[..., 0]
    return RusinkiewiczAngles(theta_h, theta_d, np.arctan2(y, x) % np.pi)


def directions(angles: RusinkiewiczAngles) -> tuple[AnyFloats, AnyFloats]:
    """Pairs of directions wi, wo (..., 3), the half vector at azimuth 0, that have these coordinates (...,)."""
    cos_h, sin_h = np.cos(angles.theta_h), np.sin(angles.theta_h)
    x = np.sin(angles.theta_d) * np.cos(angles.phi_d)
    y = np.sin(angles.theta_d) * np.sin(angles.phi_d)
    z = np.cos(angles.theta_d)

    def tilted(side: int) -> AnyFloats:
        return np.stack([cos_h * side * x + sin_h * z, side * y, cos_h * z - sin_h * side * x], axis=-1)

    return tilted(1), tilted(-1)


def bin_centres(shape: tuple[int, int, int]) -> RusinkiewiczAngles:
    """Coordinates of the values of a table (n_h, n_d, n_p), each shaped to broadcast to it."""
    h, d, p = ((np.arange(n) + 0.5) / n for n in shape)
    return RusinkiewiczAngles(np.pi / 2 * h[:, None, None] ** 2, np.pi / 2 * d[:, None], np.pi * p)


@dataclass(frozen=True, eq=False)
class Tabulated(Material):
    """A Lambertian base under a tabulated lobe; the table alone if kd is 0 and ks is 1.

    table : (n_h, n_d, n_p, 3) linear RGB, 1/sr, >= 0; kept as float32. A value stands for its bin, of which it is
        the centre. The lobe is linear in the table's coordinates between centres, and constant beyond the first and
        last of theta_h and theta_d.
    """

    table: AnyFloats

    def __post_init__(self) -> None:
        super().__post_init__()
        table = np.asarray(self.table)
        if table.ndim != 4 or table.shape[3] != 3 or table.size == 0:
            raise ValueError(f"the table has the shape {table.shape}; it must be (n_h, n_d, n_p, 3)")
        wrong = ~(np.isfinite(table) & (table >= 0))
        if wrong.any():
            place = tuple(int(i) for i in np.argwhere(wrong)[0])
            raise ValueError(f"the table is {table[place]} at {place}; it must be finite and >= 0")
        object.__setattr__(self, "table", frozen_array(table, np.float32))

    def lobe(self, wi: AnyFloats, wo: AnyFloats) -> AnyFloats:
        above = (wi[..., 2] > 0) & (wo[..., 2] > 0)
        n_h, n_d, n_p, _ = self.table.shape
        angles = half_angles(wi, wo)
        h = np.sqrt(np.minimum(angles.theta_h * (2 / np.pi), 1)) * n_h - 0.5
        d = angles.theta_d * (2 / np.pi) * n_d - 0.5
        p = angles.phi_d * (n_p / np.pi) - 0.5
        corners = [_neighbours(np.clip(h, 0, n_h - 1)), _neighbours(np.clip(d, 0, n_d - 1)), _neighbours(p)]
        values = self.table.reshape(-1, 3)
        lobe = np.zeros((*above.shape, 3), h.dtype)
        for (i, i_share), (j, j_share), (k, k_share) in product(*corners):
            place = (np.minimum(i, n_h - 1) * n_d + np.minimum(j, n_d - 1)) * n_p + k % n_p
            lobe += values[place] * (i_share * j_share * k_share)[..., None]
        lobe[~above] = 0
        return lobe

    # Half vectors of one half of the samples follow the table's own marginal; the other half follows the cosine.
    @cached_property
    def _half_cdf(self) -> tuple[Floats, Floats]:
        """Cosines of theta_h at the edges of bins, from the normal out, and the share of samples up to there."""
        n_h, n_d, _, _ = self.table.shape
        cosines = np.cos(np.pi / 2 * (np.arange(n_h + 1) / n_h) ** 2)
        theta_d = bin_centres((n_h, n_d, 1)).theta_d
        rings = self.table.mean(axis=(2, 3), dtype=float) @ (np.sin(theta_d) * np.cos(theta_d)).ravel()
        # The cosine is that between facet and surface, as in D cos.
        shares = rings * -np.diff(cosines**2)
        if shares.sum() == 0:
            shares = -np.diff(cosines**2)
        return cosines, np.append(0, np.cumsum(shares) / shares.sum())

    def sample(self, wo: AnyFloats, u: AnyFloats) -> AnyFloats:
        cosines, cdf = self._half_cdf
        first = 2 * u[..., 0] % 1
        cos = np.interp(first, cdf, cosines)
        sin, phi = np.sqrt(1 - cos * cos), 2 * np.pi * u[..., 1]
        half = np.stack([sin * np.cos(phi), sin * np.sin(phi), cos], axis=-1).astype(wo.dtype)
        reflected = 2 * dot(wo, half)[..., None] * half - wo
        by_cosine = sample_cosine(np.stack([first, u[..., 1]], axis=-1))
        return np.where(u[..., :1] < 0.5, reflected, by_cosine)

    def density(self, wi: AnyFloats, wo: AnyFloats) -> AnyFloats:
        cosines, cdf = self._half_cdf
        densities = (np.diff(cdf) / -np.diff(cosines) / (2 * np.pi)).astype(wo.dtype)
        half = wi + wo
        # A half vector that points down was an upward one on the viewer's far side.
        theta_h = np.arctan2(np.hypot(half[..., 0], half[..., 1]), np.abs(half[..., 2]))
        place = (np.sqrt(theta_h * (2 / np.pi)) * len(densities)).astype(int)
        # Half of |wi + wo| is wo.h; it is 0 for opposite directions only.
        cos_d = np.maximum(np.sqrt(dot(half, half)) / 2, 1e-6)
        reflected = densities[np.minimum(place, len(densities) - 1)] / (4 * cos_d)
        return (reflected + cosine_density(wi)) / 2


def _neighbours(
    x: AnyFloats,
) -> tuple[tuple[NDArray[np.int64], AnyFloats], tuple[NDArray[np.int64], AnyFloats]]:
    """The whole numbers below and above, and the share of each in what lies between."""
    below = np.floor(x)
    share = x - below
    return (below.astype(int), 1 - share), (below.astype(int) + 1, share)


def of_merl(path: Path) -> Tabulated:
    """A material of the MERL database, from its binary file.

    What was not measured counts as 0, so that the lobe darkens within a bin of the horizon. Raises ValueError for a
    file of another kind.
    """
    return Tabulated(np.zeros(3), np.ones(3), np.nan_to_num(read_merl(path)))
