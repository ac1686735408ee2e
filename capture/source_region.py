"""Where on the sphere of directions sources are looked for, as whoever saw the room says."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture.arrays import frozen_array
from capture.manifest import LightingTable

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SourceRegion:
    """Directions within `radii` (k,), radians, of unit `directions` (k, 3); of one cone both may be given bare."""

    directions: Floats
    radii: Floats

    def __post_init__(self) -> None:
        directions, radii = np.atleast_2d(self.directions).astype(float), np.atleast_1d(self.radii)
        for direction, radius in zip(directions, radii.astype(float), strict=True):
            if direction.shape != (3,) or not np.isfinite(direction).all():
                raise ValueError(
                    f"the source region's direction is {direction.tolist()}; it must be three finite numbers"
                )
            if abs(np.linalg.norm(direction) - 1) > 1e-4:
                raise ValueError(
                    f"the source region's direction {direction.tolist()} has length {np.linalg.norm(direction):.3g},"
                    " outside the sphere of directions; divide it by its length"
                )
            if not 0 < radius <= np.pi:
                raise ValueError(
                    f"the source region's radius is {radius} rad, outside the sphere of directions; it must be"
                    " above 0 and at most pi"
                )
        object.__setattr__(self, "directions", frozen_array(directions))
        object.__setattr__(self, "radii", frozen_array(radii))

    def holds(self, directions: Floats) -> NDArray[np.bool_]:
        """Whether it holds unit directions (..., 3)."""
        return np.asarray((directions @ self.directions.T >= np.cos(self.radii)).any(axis=-1))


def source_regions(tables: Iterable[LightingTable]) -> dict[str, SourceRegion]:
    """The source region of each lighting of a manifest that has one, by the lighting's name."""
    regions = {}
    for table in tables:
        if table.source_regions:
            directions = np.array([cone.direction for cone in table.source_regions], float)
            directions /= np.linalg.norm(directions, axis=1, keepdims=True)
            radii = np.radians([cone.radius_deg for cone in table.source_regions])
            regions[table.name] = SourceRegion(directions, radii)
    return regions
