"""Distant light from a lat-long map."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from capture.arrays import frozen_array
from capture.lighting import latlong_pixels, latlong_solid_angles

Floats = NDArray[np.float64]
AnyFloats = NDArray[np.floating]


@dataclass(frozen=True, eq=False)
class LatLongLight:
    """Light whose radiance is a lat-long map, linear between the centres of its pixels.

    pixels : (h, 2h, 3) RGB, >= 0; rows run from +Z, columns from +X towards +Y, as `capture.lighting` has it.
    map_to_world : (3, 3) rotation of the map's axes into the world's.
    """

    pixels: AnyFloats
    map_to_world: Floats = field(default_factory=lambda: np.eye(3))
    # How `sample` finds its pixel: the probability of each, and cumulated, of rows and along each row.
    _share: Floats = field(init=False, repr=False)
    _row_edges: Floats = field(init=False, repr=False)
    _column_edges: Floats = field(init=False, repr=False)

    def __post_init__(self) -> None:
        pixels = np.asarray(self.pixels, float)
        if pixels.ndim != 3 or pixels.shape[1:] != (2 * pixels.shape[0], 3):
            raise ValueError(
                f"a lat-long map is {pixels.shape}; it must be (h, 2h, 3): twice as wide as high"
            )
        if not np.isfinite(pixels).all() or (pixels < 0).any():
            raise ValueError(
                f"a lat-long map holds values from {np.min(pixels)} to {np.max(pixels)}; they must be finite and >= 0"
            )
        object.__setattr__(self, "pixels", frozen_array(pixels))
        object.__setattr__(self, "map_to_world", frozen_array(self.map_to_world))
        # Between pixels the radiance is at most the largest around: so the density is 0 only where it is.
        peak = maximum_filter(pixels.sum(axis=2), size=3, mode=("nearest", "wrap"))
        weights = peak * latlong_solid_angles(len(pixels))
        if not weights.sum() > 0:
            raise ValueError("a lat-long map is black all over; there is no light in it")
        share = weights / weights.sum()
        rows = share.sum(axis=1)
        within = np.cumsum(share, axis=1) / np.where(rows > 0, rows, 1)[:, None]
        within[:, -1] = 1
        for name, value in (
            ("_share", share),
            ("_row_edges", np.append(0, np.cumsum(rows))),
            ("_column_edges", np.concatenate([np.zeros((len(rows), 1)), within], axis=1)),
        ):
            object.__setattr__(self, name, frozen_array(value))

    def radiance_from(self, directions: AnyFloats) -> AnyFloats:
        """Radiance (..., 3) from unit directions (..., 3), dtype kept."""
        height = len(self.pixels)
        row, column = self._place(directions)
        row = np.clip(row - 0.5, 0, height - 1)
        above = np.minimum(row.astype(np.intp), max(height - 2, 0))
        below = np.minimum(above + 1, height - 1)
        column = column - 0.5
        left = np.floor(column).astype(np.intp)
        down, right = (row - above)[..., None], (column - left)[..., None]
        left, next_ = left % (2 * height), (left + 1) % (2 * height)
        pixels = self.pixels.astype(directions.dtype)
        upper = pixels[above, left] * (1 - right) + pixels[above, next_] * right
        lower = pixels[below, left] * (1 - right) + pixels[below, next_] * right
        return np.asarray(upper * (1 - down) + lower * down, directions.dtype)

    def sample(self, u: AnyFloats) -> AnyFloats:
        """Directions (..., 3), about as dense as the radiance, for u (..., 2) in 0 to 1."""
        height = len(self.pixels)
        rows, columns = self._row_edges, self._column_edges
        row = np.clip(np.searchsorted(rows, u[..., 0], side="right") - 1, 0, height - 1)
        down = (u[..., 0] - rows[row]) / np.maximum(rows[row + 1] - rows[row], 1e-300)
        # One search through all rows' edges, row after row.
        flat = (columns + 2.0 * np.arange(height)[:, None]).ravel()
        place = np.searchsorted(flat, u[..., 1] + 2.0 * row, side="right") - 1
        column = np.clip(place - row * (2 * height + 1), 0, 2 * height - 1)
        left, right = columns[row, column], columns[row, column + 1]
        along = (u[..., 1] - left) / np.maximum(right - left, 1e-300)
        top, bottom = np.cos(row * np.pi / height), np.cos((row + 1) * np.pi / height)
        z = top + np.clip(down, 0, 1) * (bottom - top)
        phi = (column + np.clip(along, 0, 1)) * np.pi / height
        ring = np.sqrt(np.maximum(1 - z * z, 0))
        local = np.stack([ring * np.cos(phi), ring * np.sin(phi), z], axis=-1)
        return (local @ self.map_to_world.T).astype(u.dtype)

    def density(self, directions: AnyFloats) -> AnyFloats:
        """Density (...,) of `sample`, 1/sr."""
        height = len(self.pixels)
        row, column = self._place(directions)
        row = np.minimum(row.astype(np.intp), height - 1)
        column = np.minimum(column.astype(np.intp), 2 * height - 1)
        return (self._share / latlong_solid_angles(height)).astype(directions.dtype)[row, column]

    def turned(self, rotation: Floats) -> LatLongLight:
        """The same light after a rotation (3, 3) of the world."""
        return replace(self, map_to_world=rotation @ self.map_to_world)

    def _place(self, directions: AnyFloats) -> tuple[AnyFloats, AnyFloats]:
        """Row (0 to h) and column (0 to 2h) of directions, edges of pixels being at integers."""
        return latlong_pixels(directions @ self.map_to_world.astype(directions.dtype), len(self.pixels))
