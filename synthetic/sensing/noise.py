"""The noise of an ideal sensor: Gaussian, on linear radiance that nothing clips or rounds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Noise:
    """Gaussian sensor noise of two independent parts.

    relative : standard deviation as a share of the pixel's own radiance.
    floor : standard deviation in every pixel, as a share of the object's mean radiance in the photograph.
    """

    relative: float = 0.01
    floor: float = 0.001

    def __post_init__(self) -> None:
        if not (0 <= self.relative < np.inf and 0 <= self.floor < np.inf):
            raise ValueError(f"noise is {self.relative} relative and {self.floor} floor; both must be >= 0")

    def applied(self, radiance: Floats, coverage: Floats, rng: np.random.Generator) -> NDArray[np.float32]:
        """A noisy photograph (h, w, 3) float32 of radiance (h, w, 3) in which the object covers `coverage` (h, w)."""
        seen = coverage > 0
        floor = self.floor * radiance[seen].mean() if seen.any() else 0.0
        deviation = np.hypot(self.relative * radiance, floor)
        return np.asarray(radiance + deviation * rng.standard_normal(radiance.shape), np.float32)
