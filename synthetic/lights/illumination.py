"""All the light that falls on the scene in one photograph."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from synthetic.lights.light import ExtendedLight
from synthetic.lights.sources import DirectionalSource, PointSource

Floats = NDArray[np.float64]
AnyFloats = NDArray[np.floating]
Given = Literal["all", "ball", "nothing"]

# Sub-samples per side of a lat-long pixel.
_SUBSAMPLES = 3


@dataclass(frozen=True, eq=False)
class Illumination:
    """Light under a name.

    extended : light from ranges of directions. sources : light from single directions and places.
    given : what a photo set tells of it: everything, photographs of a mirror ball, or nothing.
    """

    name: str
    extended: tuple[ExtendedLight, ...] = ()
    sources: tuple[DirectionalSource | PointSource, ...] = ()
    given: Given = "all"

    def __post_init__(self) -> None:
        if not self.extended and not self.sources:
            raise ValueError(f"lighting {self.name!r} has no light; give an area light, a map or a source")

    def radiance_from(self, directions: AnyFloats) -> AnyFloats:
        """Radiance (..., 3) of the extended lights together from unit directions (..., 3); keeps the dtype."""
        total = np.zeros_like(directions)
        for light in self.extended:
            total += light.radiance_from(directions)
        return total

    def turned(self, rotation: Floats, name: str) -> Illumination:
        """The same light under another name after a rotation (3, 3) of the world about its origin."""
        return Illumination(
            name,
            tuple(light.turned(rotation) for light in self.extended),
            tuple(source.turned(rotation) for source in self.sources),
            self.given,
        )


def latlong_map(lights: Sequence[ExtendedLight], height: int) -> NDArray[np.float32]:
    """Lat-long map (height, 2 height, 3) float32 of the lights' sum, pixels being means over their areas.

    Rows run from +Z, columns from +X towards +Y, as `capture.lighting` has it.
    """
    fine = height * _SUBSAMPLES
    # Equal steps of cos(theta) within a row: sub-samples of equal solid angle.
    edges = np.cos(np.arange(height + 1) * np.pi / height)
    share = (np.arange(_SUBSAMPLES) + 0.5) / _SUBSAMPLES
    z = (edges[:-1, None] + np.diff(edges)[:, None] * share).ravel()[:, None]
    phi = (np.arange(2 * fine) + 0.5) * np.pi / fine
    ring = np.sqrt(1 - z**2)
    directions = np.stack(np.broadcast_arrays(ring * np.cos(phi), ring * np.sin(phi), z), axis=-1)
    total = np.zeros((height, 2 * height, 3))
    for light in lights:
        fine_map = light.radiance_from(directions)
        total += fine_map.reshape(height, _SUBSAMPLES, 2 * height, _SUBSAMPLES, 3).mean(axis=(1, 3))
    return total.astype(np.float32)
