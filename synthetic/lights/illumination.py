"""All the light that falls on the scene in one photograph."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from capture.lighting import latlong_pixels, latlong_solid_angles
from synthetic.lights.arealight import AreaLight
from synthetic.lights.disc import DiscLight
from synthetic.lights.latlong import LatLongLight
from synthetic.lights.light import ExtendedLight
from synthetic.lights.sources import DirectionalSource, PointSource

Floats = NDArray[np.float64]
AnyFloats = NDArray[np.floating]
Given = Literal["all", "distant", "ball", "nothing"]

# Sub-samples per side of a lat-long pixel.
_SUBSAMPLES = 3
# Maps that are finer than the result get so many per pixel of theirs: the radiance is linear between those.
_PER_MAP_PIXEL = 2
# They may miss discs of a radius, and area lights of a width, below so many pixels; these are cut into so many parts
# along radius and azimuth.
_SMALL_DISC, _SMALL_AREA, _DISC_PARTS = 4, 1, 128


@dataclass(frozen=True, eq=False)
class Illumination:
    """Light under a name.

    extended : light from ranges of directions. sources : light from single directions and places.
    given : what a photo set gives of it: everything, everything as if lamps were distant, photographs of a mirror ball,
    or nothing.
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
    total = np.zeros((height, 2 * height, 3))
    for light in lights:
        if isinstance(light, DiscLight) and light.radius_rad < _SMALL_DISC * np.pi / height:
            total += _shared_out(light, light.direction, height)
        elif isinstance(light, AreaLight) and light.width_rad < _SMALL_AREA * np.pi / height:
            total += _shared_out(light, light.axis, height)
        else:
            total += np.stack([_row_means(light, height, row) for row in range(height)])
    return total.astype(np.float32)


def _row_means(light: ExtendedLight, height: int, row: int) -> Floats:
    """Means (2 height, 3) over the pixels of a row, by sub-samples of equal solid angle."""
    count = _SUBSAMPLES
    if isinstance(light, LatLongLight):
        count = max(count, -(-_PER_MAP_PIXEL * len(light.pixels) // height))
    top, bottom = np.cos(np.array([row, row + 1]) * np.pi / height)
    z = (top + (bottom - top) * (np.arange(count) + 0.5) / count)[:, None]
    phi = (np.arange(2 * height * count) + 0.5) * np.pi / (height * count)
    ring = np.sqrt(1 - z**2)
    directions = np.stack(np.broadcast_arrays(ring * np.cos(phi), ring * np.sin(phi), z), axis=-1)
    means = light.radiance_from(directions).reshape(count, 2 * height, count, 3).mean(axis=(0, 2))
    return np.asarray(means, float)


def _shared_out(light: DiscLight | AreaLight, middle: Floats, height: int) -> Floats:
    """Means over pixels (height, 2 height, 3) of a small light: its power, dealt to those that parts of it lie in.

    middle : (3,) its brightest direction.
    """
    share = (np.arange(_DISC_PARTS) + 0.5) / _DISC_PARTS
    directions = light.sample(np.stack(np.meshgrid(share, share), axis=-1).reshape(-1, 2))
    row, column = (place.astype(int) for place in latlong_pixels(directions, height))
    place = np.minimum(row, height - 1) * 2 * height + column % (2 * height)
    counts = np.bincount(place, minlength=2 * height**2)
    parts = counts.reshape(height, 2 * height, 1) / len(directions)
    # The same everywhere: both are as dense as they are bright.
    power = light.radiance_from(middle) / light.density(middle)
    return parts * power / latlong_solid_angles(height)[..., None]
