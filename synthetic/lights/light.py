"""What every light has that comes from a range of directions."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
AnyFloats = NDArray[np.floating]


class ExtendedLight(Protocol):
    """Distant light that comes from a range of directions."""

    def radiance_from(self, directions: AnyFloats) -> AnyFloats:
        """Radiance (..., 3) from unit directions (..., 3) towards the light; keeps the dtype."""
        ...

    def sample(self, u: AnyFloats) -> AnyFloats:
        """Directions (..., 3), about as dense as the radiance, for u (..., 2) in 0 to 1."""
        ...

    def density(self, directions: AnyFloats) -> AnyFloats:
        """Density (...,) of `sample`, 1/sr."""
        ...

    def turned(self, rotation: Floats) -> ExtendedLight:
        """The same light after a rotation (3, 3) of the world."""
        ...
