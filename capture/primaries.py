"""Primaries of linear RGB: sRGB's, in which results are, and others that pictures may be written in."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# What cones see of XYZ, as Bradford has it [Lam 1985].
_BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
# Chromaticities x, y of daylight D65, and of ACES' white.
_D65, _ACES_WHITE = (0.3127, 0.3290), (0.32168, 0.33767)


def adaptation(seen: Floats, wanted: Floats) -> Floats:
    """The matrix (3, 3) of XYZ that look under one white, XYZ (3,), as others under another [Lam 1985]."""
    cones = np.diag((_BRADFORD @ wanted) / (_BRADFORD @ seen))
    return np.asarray(np.linalg.inv(_BRADFORD) @ cones @ _BRADFORD)


@dataclass(frozen=True)
class Primaries:
    """A set of primaries.

    red, green, blue, white : chromaticities x, y. png_code : of the primaries in a PNG's cICP chunk [ITU-T H.273]; None
    where no PNG is written in them.
    """

    name: str
    red: tuple[float, float]
    green: tuple[float, float]
    blue: tuple[float, float]
    png_code: int | None
    white: tuple[float, float] = _D65

    @property
    def chromaticities(self) -> tuple[float, ...]:
        """As EXR has them: x, y of red, green, blue and white."""
        return (*self.red, *self.green, *self.blue, *self.white)

    @cached_property
    def to_xyz(self) -> Floats:
        """The matrix (3, 3) to XYZ, white having Y = 1."""
        columns = np.array([_xyz(*place) for place in (self.red, self.green, self.blue)]).T
        return np.asarray(columns * np.linalg.solve(columns, _xyz(*self.white)))

    @cached_property
    def of_srgb(self) -> Floats:
        """The matrix (3, 3) from linear sRGB; white stays white."""
        srgb = PRIMARIES["srgb"]
        change = adaptation(_xyz(*srgb.white), _xyz(*self.white))
        return np.asarray(np.linalg.solve(self.to_xyz, change @ srgb.to_xyz))


def _xyz(x: float, y: float) -> Floats:
    return np.array([x / y, 1.0, (1 - x - y) / y])


PRIMARIES = {
    own.name: own
    for own in (
        Primaries("srgb", (0.64, 0.33), (0.30, 0.60), (0.15, 0.06), 1),
        Primaries("p3", (0.680, 0.320), (0.265, 0.690), (0.150, 0.060), 12),
        Primaries("rec2020", (0.708, 0.292), (0.170, 0.797), (0.131, 0.046), 9),
        Primaries("acescg", (0.713, 0.293), (0.165, 0.830), (0.128, 0.044), None, _ACES_WHITE),
    )
}
