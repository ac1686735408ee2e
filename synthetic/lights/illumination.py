"""All the light that falls on the scene in one photograph."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from capture.lighting import latlong_pixels, latlong_solid_angles
from synthetic.lights.disc import DiscLight
from synthetic.lights.light import ExtendedLight
from synthetic.lights.sources import DirectionalSource, PointSource

Floats = NDArray[np.float64]
AnyFloats = NDArray[np.floating]
Given = Literal["all", "ball", "nothing"]

# Sub-samples per side of a lat-long pixel.
_SUBSAMPLES = 3
# They may miss discs of a radius below so many pixels, which are cut into so many parts along radius and azimuth.
_SMALL_DISC, _DISC_PARTS = 4, 128


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
        if isinstance(light, DiscLight) and light.radius_rad < _SMALL_DISC * np.pi / height:
            total += _shared_out(light, height)
            continue
        fine_map = light.radiance_from(directions)
        total += fine_map.reshape(height, _SUBSAMPLES, 2 * height, _SUBSAMPLES, 3).mean(axis=(1, 3))
    return total.astype(np.float32)


def _shared_out(disc: DiscLight, height: int) -> Floats:
    """Means over pixels (height, 2 height, 3) of a small disc: its light, dealt to those that parts of it lie in."""
    share = (np.arange(_DISC_PARTS) + 0.5) / _DISC_PARTS
    directions = disc.sample(np.stack(np.meshgrid(share, share), axis=-1).reshape(-1, 2))
    row, column = (place.astype(int) for place in latlong_pixels(directions, height))
    place = np.minimum(row, height - 1) * 2 * height + column % (2 * height)
    counts = np.bincount(place, minlength=2 * height**2)
    parts = counts.reshape(height, 2 * height, 1) / len(directions)
    power = disc.radiance_from(disc.direction) / disc.density(disc.direction)
    return parts * power / latlong_solid_angles(height)[..., None]
