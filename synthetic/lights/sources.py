"""Light from single directions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture.arrays import frozen_array
from synthetic.lights.values import rgb, unit_vector

Floats = NDArray[np.float64]


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
