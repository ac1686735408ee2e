"""A measured isotropic BRDF as samples: pairs of directions and what was reflected."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ReflectanceSamples:
    """wi, wo : (n, 3) local unit directions to the light and to the sensor, the normal being +z. rgb : (n, 3) linear,
    1/sr, negative where a colour is outside the gamut."""

    wi: Floats
    wo: Floats
    rgb: Floats

    def __len__(self) -> int:
        return len(self.rgb)
