"""sigma from a directional source in recovered light [RH01, section 6.3, fig. 10, eq. 26]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture.lighting import latlong_directions, latlong_solid_angles
from capture.source_region import SourceRegion
from invrender.brdf.microfacet import SIGMA_RANGE
from invrender.estimate.rh01.samples import Samples
from invrender.estimate.unknown_light.start import light_peaks
from recon.harmonics.latlong import map_coefficients

Floats = NDArray[np.float64]

# Degrees in which the sharpest peak is looked for; width of the rings around it, pixels.
_DEGREE, _RING = 12, 1.5
# Power of the exitant angle's cosine by which samples count in the map that sigma is read off: at 40 degrees from the
# normal a tenth of head-on.
_NEAR_NORMAL = 8
# That map has fewer samples per node, of which the brightest is taken: it is smoother than the one of all samples.
_SMOOTH = 1e-2


@dataclass(frozen=True, eq=False)
class Peak:
    """A source, as the lobe has blurred it: the centre of its light (3,), its irradiance (3,), and sigma, radians.

    region : (H, 2H), what encloses it in the map.
    """

    direction: Floats
    irradiance: Floats
    sigma: float
    region: NDArray[np.bool_]


def highlights_near_normal(samples: Samples, specular: Floats, mu: float | None) -> tuple[Floats, Floats]:
    """The light (H, 2H, 3) that highlights nearest normal exitance show, and the mean (H, 2H) of 1 / cos theta_o there.

    specular : (n, 3), the samples' radiance less the diffuse part, over Ks. Equation 26 is of normal exitance; where no
    photograph shows a direction head-on, those that come nearest count.
    """
    nearest = np.full(2 * samples.height**2, 1e-3)
    rows = samples.mirrored.tocoo()
    np.maximum.at(nearest, rows.col, np.where(rows.data > 0, samples.cos[rows.row], 0))
    likeness = (samples.cos / np.maximum(samples.mirrored @ nearest, 1e-3)) ** _NEAR_NORMAL
    light = samples.mirror_map(specular, mu, likeness, _SMOOTH)
    weight = samples.root**2 * likeness * samples.fresnel(mu) ** 2
    counts = samples.mirrored.T @ weight
    exitance = (samples.mirrored.T @ (weight / samples.cos)) / np.where(counts > 0, counts, 1)
    shape = (samples.height, 2 * samples.height)
    return light.reshape(*shape, 3), np.where(counts > 0, exitance, 1).reshape(shape)


def find_peak(
    light: Floats, region: SourceRegion | None = None, exitance: Floats | None = None
) -> Peak | None:
    """The source in a lat-long map (H, 2H, 3), and the roughness that has blurred it [RH01, eq. 22, 23 and 26].

    L_cen = L_tot / (4 pi sigma^2 cos theta_o). region : what encloses the source; None takes the sharpest peak as far
    out as rings about it get darker. exitance : (H, 2H), 1 / cos theta_o at which the map's nodes are seen; None for
    normal exitance, as in eq. 26. None is returned for light without a peak.
    """
    height = len(light)
    grid = latlong_directions(height).reshape(-1, 3)
    radiance, solid_angles = light.reshape(-1, 3), np.repeat(latlong_solid_angles(height)[:, 0], 2 * height)
    if region is None:
        peaks = light_peaks(map_coefficients(light, min(_DEGREE, (height - 1) // 2)), None)
        if not len(peaks):
            return None
        inside = _as_far_as_darker(grid, radiance.sum(axis=1) * solid_angles, solid_angles, peaks[0])
    else:
        inside = region.holds(grid)
    if not inside.any():
        return None
    brightest = np.flatnonzero(inside)[radiance[inside].sum(axis=1).argmax()]
    total = (radiance * solid_angles[:, None])[inside].sum(axis=0)
    centre = float(radiance[brightest].sum())
    if centre <= 0 or total.sum() <= 0:
        return None
    stretch = 1.0 if exitance is None else float(exitance.ravel()[brightest])
    sigma = float(np.sqrt(total.sum() * stretch / (4 * np.pi * centre)))
    # "Located at its center" [section 5.3]: of its light, which no pixel's size limits.
    flux = radiance[inside].sum(axis=1) * solid_angles[inside]
    direction = flux @ grid[inside]
    return Peak(
        direction / np.linalg.norm(direction),
        np.maximum(total, 0),
        float(np.clip(sigma, *SIGMA_RANGE)),
        inside.reshape(height, 2 * height),
    )


def without_source(light: Floats, peak: Peak) -> tuple[Floats, Floats]:
    """A map (H, 2H, 3) levelled within a source's region to what its rim shows, and the irradiance (3,) taken off."""
    rim = peak.region & ~np.all(
        [np.roll(peak.region, step, axis) for axis in (0, 1) for step in (-1, 1)], axis=0
    )
    level = light[rim if rim.any() else peak.region].mean(axis=0)
    solid_angle = float((peak.region * latlong_solid_angles(len(light))).sum())
    slow = np.where(peak.region[..., None], level, light)
    return slow, np.maximum(peak.irradiance - level * solid_angle, 0)


def _as_far_as_darker(grid: Floats, light: Floats, solid_angles: Floats, peak: Floats) -> NDArray[np.bool_]:
    """The directions (P,) around a peak within the first ring that is brighter than the one inside it."""
    pixel = np.pi / np.sqrt(len(grid) / 2)
    ring = (np.arccos(np.clip(grid @ peak, -1, 1)) / (_RING * pixel)).astype(int)
    means = np.bincount(ring, light) / np.maximum(np.bincount(ring, solid_angles), 1e-300)
    brighter = np.flatnonzero(np.diff(means) > 0)
    return np.asarray(ring <= (brighter[0] if len(brighter) else len(means)))
