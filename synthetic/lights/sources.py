"""Light that reaches each point from one direction: distant sources, and lamps at a place."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from capture.arrays import frozen_array
from synthetic.lights.values import rgb, unit_vector

Floats = NDArray[np.float64]
AnyFloats = NDArray[np.floating]


@dataclass(frozen=True, eq=False)
class DirectionalSource:
    """Light from one direction.

    direction : (3,) from the object to the light, any length.
    irradiance : (3,) RGB on a plane that faces it, >= 0.
    """

    direction: Floats
    irradiance: Floats

    def __post_init__(self) -> None:
        object.__setattr__(
            self, "direction", frozen_array(unit_vector(self.direction, "direction of a source"))
        )
        object.__setattr__(self, "irradiance", frozen_array(rgb(self.irradiance, "irradiance of a source")))

    def at(self, positions: Floats) -> tuple[Floats, Floats, Floats]:
        """Directions (n, 3), distances (n,), all infinite, and irradiances (n, 3) at points (n, 3)."""
        count = len(positions)
        return (
            np.broadcast_to(self.direction, (count, 3)),
            np.full(count, np.inf),
            np.broadcast_to(self.irradiance, (count, 3)),
        )

    def turned(self, rotation: Floats) -> DirectionalSource:
        """The same light after a rotation (3, 3) of the world."""
        return replace(self, direction=rotation @ self.direction)


@dataclass(frozen=True, eq=False)
class PointSource:
    """A lamp at a place, the same in all directions: its light falls off with the square of the distance.

    position : (3,) metres. intensity : (3,) RGB, irradiance times metres squared, >= 0. radius : metres, of the bulb
    that mirrors show; nothing else sees it.
    """

    position: Floats
    intensity: Floats
    radius: float = 0.0

    def __post_init__(self) -> None:
        position = np.asarray(self.position, float)
        if position.shape != (3,) or not np.isfinite(position).all():
            raise ValueError(
                f"position of a lamp is {position.tolist()}; it must be three finite numbers, metres"
            )
        object.__setattr__(self, "position", frozen_array(position))
        object.__setattr__(self, "intensity", frozen_array(rgb(self.intensity, "intensity of a lamp")))

    def at(self, positions: Floats) -> tuple[Floats, Floats, Floats]:
        """Directions (n, 3), distances (n,) in metres and irradiances (n, 3) at points (n, 3)."""
        towards = self.position - positions
        distances = np.linalg.norm(towards, axis=1)
        return towards / distances[:, None], distances, self.intensity / distances[:, None] ** 2

    def mirrored(self, positions: Floats, directions: AnyFloats) -> Floats:
        """Radiance (n, 3) that rays from points (n, 3) in unit directions (n, 3) meet: that of the bulb, or none."""
        if not self.radius:
            return np.zeros_like(positions)
        offset = self.position - positions
        along = (offset * directions).sum(axis=1)
        beside = np.linalg.norm(offset - along[:, None] * directions, axis=1)
        met = (along > 0) & (beside < self.radius)
        return np.asarray(met[:, None] * self.intensity / (np.pi * self.radius**2))

    def turned(self, rotation: Floats) -> PointSource:
        """The same lamp after a rotation (3, 3) of the world about its origin."""
        return replace(self, position=rotation @ self.position)
