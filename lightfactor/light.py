"""The lightings of a fit as arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture.lighting import Lighting
from invrender.estimate.quantities import FittedLighting
from invrender.result.saved import SavedResult

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class FittedLight:
    """A lighting as the fit leaves it.

    directions : (k, 3) unit vectors from the object's centre towards the sources. positions : (k, 3), metres, of near
    sources, NaN of those far away. irradiances, irradiance_std : (k, 3), their irradiance on a plane at the centre that
    faces them; the deviation is 0 where it was given, NaN where unknown.
    map : (H, 2H, 3) float32, radiance of everything else, lat-long (docs/conventions.md); None where it is dark.
    recovered : what of it was fitted: "irradiance", "ambient", "distance", "scale", "all"; empty where all was given.
    """

    name: str
    directions: Floats
    positions: Floats
    irradiances: Floats
    irradiance_std: Floats
    map: NDArray[np.float32] | None
    recovered: tuple[str, ...]

    @property
    def as_fitted(self) -> FittedLighting:
        """The same as figures take it, what is uniform in the map."""
        lighting = Lighting(self.name, self.map, self.directions, self.irradiances)
        return FittedLighting(lighting, self.irradiance_std, None, None)


def fitted_lights(result: SavedResult) -> tuple[FittedLight, ...]:
    """The lightings of a result, in their order there."""
    found = []
    for entry in result.content.lighting:
        lighting = result.read_lighting(entry)
        found.append(
            FittedLight(
                lighting.name,
                lighting.directions,
                np.array([np.full(3, np.nan) if p is None else p[0] for p in lighting.places]).reshape(-1, 3),
                lighting.irradiances,
                entry.irradiance_std,
                lighting.radiance_map,
                entry.recovered,
            )
        )
    return tuple(found)
