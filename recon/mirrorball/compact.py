"""Compact bright sources in a photograph of a mirror ball, separated from the extended light around them.

A lamp is a few pixels that hold much of the light. In a lat-long map it would be smeared over whole map
pixels, so it is taken out and handed on as a direction and an irradiance.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from capture.arrays import frozen_array
from capture.source_region import SourceRegion

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Light from within this angle of its centroid is a source; anything larger is an area that a map resolves.
MAX_RADIUS = np.radians(10.0)
# Directions this far from a peak are its surroundings.
_RING = np.cos(np.radians([20.0, 12.0]))
# How often brighter than the upper quartile of its surroundings a peak must be: walls and skies are not.
_CONTRAST = 3.0
# How many robust standard deviations of its surroundings a peak must stand above them.
_SIGNIFICANCE = 6.0
# A source is worth its name with this share of the light on the ball, and of the brightest source. A clipped
# one may hold any share of the light (the sun reads no brighter than a white wall), so the first is waived.
_MIN_SHARE_OF_LIGHT = 0.01
_MIN_SHARE_OF_BRIGHTEST = 0.02
# Of a clipped brightest one, which may be many times brighter than it reads, it takes more.
_MIN_SHARE_OF_CLIPPED = 0.1
_MAX_SOURCES = 8
# Peaks that are looked at, in descending order of brightness. Only a bound on time: each one that is
# rejected takes everything down to half of its height with it.
_MAX_PEAKS = 60
# Narrowest skirt in pixels: an unclipped point has all its light within three pixels of its half-maximum
# core if the lens blurs it by up to about one pixel.
_MIN_SKIRT_PX = 3.0
# Doubt of the share of a pixel that an edge lights, since pixels are not quite squares.
_EDGE_SHARE = 0.05
# Parts of the ring around a source that say something of the background under it independently: its octants.
_INDEPENDENT = 8


@dataclass(frozen=True, eq=False)
class Pixels:
    """The ball's pixels with what they mirror, as images of one size (h, w).

    radiance, variance : (h, w, 3). saturated : (h, w). usable : (h, w), wholly on the ball and not at its rim.
    directions : (h, w, 3) unit, towards the mirrored light. solid_angles : (h, w) steradians that each
    pixel mirrors. stretch : (h, w), the largest turn of the direction in radians per pixel. All three are
    meaningful where `usable`.
    """

    radiance: Floats
    variance: Floats
    saturated: Mask
    usable: Mask
    directions: Floats
    solid_angles: Floats
    stretch: Floats


@dataclass(frozen=True, eq=False)
class Spot:
    """A compact source on the ball.

    direction : (3,) unit, towards the source. irradiance, irradiance_std : (3,), on a plane that faces the
    source, and what noise, the pixel grid and the background under it leave in doubt of it.
    angular_radius : radians, of the disc with the core's solid angle. centroid_std : radians, of the
    direction, from the pixel grid alone. clipped : has saturated pixels; the irradiance is then a lower
    bound and the radius, with the sensor's bloom in it, an upper one.
    """

    direction: Floats
    irradiance: Floats
    irradiance_std: Floats
    angular_radius: float
    centroid_std: float
    clipped: bool

    def __post_init__(self) -> None:
        object.__setattr__(self, "direction", frozen_array(self.direction))
        object.__setattr__(self, "irradiance", frozen_array(self.irradiance))
        object.__setattr__(self, "irradiance_std", frozen_array(self.irradiance_std))

    @property
    def mean_irradiance(self) -> float:
        return float(self.irradiance.mean())


def find_spots(
    pixels: Pixels, source_region: SourceRegion | None = None
) -> tuple[tuple[Spot, ...], Floats, Mask]:
    """Compact sources, brightest first; the radiance (h, w, 3) with them replaced by what surrounds them; and
    the pixels (h, w) that were replaced. source_region : where sources may be; None for anywhere."""
    luminance = np.where(pixels.usable, pixels.radiance.mean(axis=2), 0.0)
    light = float((luminance * pixels.solid_angles).sum())
    cores = _cores(pixels, luminance, light)
    claimed = np.zeros(luminance.shape, bool)
    for core in cores:
        claimed |= core
    found = []
    for core in cores:
        region, surroundings = _skirt(core, claimed & ~core, pixels.usable)
        claimed |= region
        ring = pixels.radiance[surroundings] if surroundings.any() else np.zeros((1, 3))
        spot = _measure(pixels, luminance, core, region, ring)
        found.append((spot, region, np.median(ring, axis=0)))
    if source_region is not None:
        found = [entry for entry in found if source_region.holds(entry[0].direction)]
    found.sort(key=lambda entry: -entry[0].mean_irradiance)
    filled, in_spot = pixels.radiance.copy(), np.zeros(luminance.shape, bool)
    spots = []
    for spot, region, background in found[:_MAX_SOURCES]:
        if _matters(spot, found[0][0], light):
            spots.append(spot)
            filled[region] = background
            in_spot |= region
    return tuple(spots), filled, in_spot


def _matters(spot: Spot, brightest: Spot, light: float) -> bool:
    if spot.clipped:
        least = _MIN_SHARE_OF_BRIGHTEST * brightest.mean_irradiance
    else:
        share = _MIN_SHARE_OF_CLIPPED if brightest.clipped else _MIN_SHARE_OF_BRIGHTEST
        least = max(share * brightest.mean_irradiance, _MIN_SHARE_OF_LIGHT * light)
    return spot.mean_irradiance >= least


def _cores(pixels: Pixels, luminance: Floats, light: float) -> list[Mask]:
    """The half-maximum regions of all peaks that are compact and stand clear of what is around them.

    From the brightest peak downwards. The region above half of a peak's height must hold nothing brighter:
    so glare, streaks and the slopes of larger lights, which join something brighter, are not sources.
    """
    cores: list[Mask] = []
    seen = ~pixels.usable
    rim = cv2.dilate((~pixels.usable).astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)
    # A peak below this could not reach the share of light even if it filled the largest compact source.
    floor = _MIN_SHARE_OF_LIGHT * light / (2 * np.pi * (1 - np.cos(MAX_RADIUS)))
    for _ in range(_MAX_PEAKS):
        candidates = np.where(seen, -np.inf, luminance)
        row, column = np.unravel_index(int(np.argmax(candidates)), luminance.shape)
        peak = candidates[row, column]
        if not (peak > floor or (peak > 0 and pixels.saturated[row, column])):
            break
        around = _surroundings(pixels, luminance, pixels.directions[row, column])
        background = float(np.median(around))
        above = pixels.usable & (luminance >= background + 0.5 * (peak - background))
        # The peak itself is always above, but for a background brighter than it.
        above[row, column] = True
        _, labels = cv2.connectedComponents(above.astype(np.uint8), connectivity=8)
        region = labels == labels[row, column]
        stands_alone = not (region & seen).any()
        # What touches the rim goes on where the ball doesn't show it; its irradiance would be a guess.
        whole = not (region & rim).any()
        spread = 1.4826 * float(np.median(np.abs(around - background)))
        clear = peak > _CONTRAST * np.percentile(around, 75) and peak - background > _SIGNIFICANCE * spread
        if stands_alone and whole and clear and _extent(pixels, region) <= MAX_RADIUS:
            cores.append(region)
        seen |= region
    return cores


def _surroundings(pixels: Pixels, luminance: Floats, direction: Floats) -> Floats:
    """Luminances (n,) of the pixels that mirror the ring around a direction; of all where hardly any do."""
    cosine = pixels.directions @ direction
    ring = pixels.usable & (cosine > _RING[0]) & (cosine < _RING[1])
    return luminance[ring] if ring.sum() >= 20 else luminance[pixels.usable]


def _extent(pixels: Pixels, region: Mask) -> float:
    """Largest angle in radians between a region's pixels and its mean direction."""
    directions = pixels.directions[region]
    mean = (directions * pixels.solid_angles[region][:, None]).sum(axis=0)
    cosine = directions @ (mean / np.linalg.norm(mean))
    return float(np.arccos(np.clip(cosine.min(), -1, 1)))


def _skirt(core: Mask, others: Mask, usable: Mask) -> tuple[Mask, Mask]:
    """A core with its blur and glare around it, and the ring around both, as masks (h, w)."""
    radius = float(np.sqrt(core.sum() / np.pi))
    away = cv2.distanceTransform((~core).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    width = max(_MIN_SKIRT_PX, radius)
    free = usable & ~others
    region = free & (away <= width)
    surroundings = free & ~region & (away <= width + max(_MIN_SKIRT_PX, radius / 2))
    return region, surroundings


def _measure(pixels: Pixels, luminance: Floats, core: Mask, region: Mask, ring: Floats) -> Spot:
    background = np.median(ring, axis=0)
    spread = 1.4826 * np.median(np.abs(ring - background), axis=0)
    clipped = core & pixels.saturated
    solid_angle = float(pixels.solid_angles[core].sum())
    excess = (pixels.radiance[region] - background) * pixels.solid_angles[region][:, None]
    # Saturated pixels all read the same whatever the light: equal radiance, and none of the skirt.
    centre = clipped if clipped.any() else core
    weight = pixels.solid_angles[centre] * (1.0 if clipped.any() else luminance[centre])
    mean = (pixels.directions[centre] * weight[:, None]).sum(axis=0)
    # One pixel places a point to 1/sqrt(12) of its width. Of n pixels only those at the edge, about sqrt(n),
    # are in doubt, which leaves n^(-1/4) of that.
    count = int(centre.sum())
    pixel = float(np.sqrt(pixels.solid_angles[centre].mean()))
    irradiance = np.maximum(excess.sum(axis=0), 0.0)
    # The same doubt of place, where solid angles change from pixel to pixel.
    areas = pixels.solid_angles[region]
    change = float(np.ptp(areas) / areas.mean() / max(np.sqrt(region.sum()), 1.0))
    # What the ring varies by shows the noise as well, if the file states less of it.
    noise = np.maximum(pixels.variance[region], spread**2)
    # Of the pixels at the core's edge, each is lit by a share that is known to a few percent.
    grid = _EDGE_SHARE * np.sqrt(2 * np.sqrt(np.pi * count)) / count
    variance = (
        (noise * areas[:, None] ** 2).sum(axis=0)
        + (spread * areas.sum()) ** 2 / _INDEPENDENT
        + (irradiance * change / np.sqrt(12) * count**-0.25) ** 2
        + (irradiance * grid) ** 2
    )
    return Spot(
        direction=mean / np.linalg.norm(mean),
        irradiance=irradiance,
        irradiance_std=np.sqrt(variance),
        angular_radius=float(np.arccos(np.clip(1 - solid_angle / (2 * np.pi), -1, 1))),
        centroid_std=pixel / np.sqrt(12) * count**-0.25,
        clipped=bool(clipped.any()),
    )
