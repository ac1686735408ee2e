"""Lat-long maps of recovered lighting, of their uncertainty, and of a true light to hold them against."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture.lighting import Lighting, latlong_directions, latlong_pixels, latlong_solid_angles
from invrender.inverse_lighting.coefficients import LightCoefficients
from recon.harmonics.basis import evaluate_harmonics
from recon.harmonics.complex import project_sources
from recon.harmonics.latlong import map_coefficients, synthesise_latlong

Floats = NDArray[np.float64]

# Carries degree 30 and its pixels are no coarser than the light's finest waves.
MAP_HEIGHT = 64
_TRUTH_DEGREE = 30


def coefficient_map(coefficients: Floats) -> Floats:
    """Lat-long map (64, 128, 3) of lighting coefficients of degree up to 30."""
    return synthesise_latlong(coefficients, MAP_HEIGHT)


def coefficient_std_map(light: LightCoefficients) -> Floats:
    """Standard deviation (64, 128, 3) of the radiance that `coefficient_map` shows."""
    harmonics = evaluate_harmonics(latlong_directions(MAP_HEIGHT).reshape(-1, 3), light.degree)
    variance = [((harmonics @ covariance) * harmonics).sum(axis=1) for covariance in light.covariance]
    return np.sqrt(np.stack(variance, axis=-1)).reshape(MAP_HEIGHT, 2 * MAP_HEIGHT, 3)


@dataclass(frozen=True, eq=False)
class TrueLight:
    """A known light. coefficients : (961, 3), up to degree 30. radiance_map : (H, 2H, 3), sources in single pixels."""

    coefficients: Floats
    radiance_map: Floats


def true_light(lighting: Lighting) -> TrueLight:
    """A known lighting as coefficients and as one map; ValueError if any part of it is to be recovered."""
    if lighting.recovers:
        raise ValueError(
            f"lighting {lighting.name!r}: {', '.join(lighting.recovers)} isn't known; it is no truth"
        )
    radiance = lighting.radiance_map
    shown = np.zeros((MAP_HEIGHT, 2 * MAP_HEIGHT, 3)) if radiance is None else radiance.astype(float)
    coefficients = map_coefficients(shown, _TRUTH_DEGREE)
    coefficients += project_sources(lighting.directions, lighting.irradiances, _TRUTH_DEGREE)
    height = len(shown)
    row, column = (place.astype(int) for place in latlong_pixels(lighting.directions, height))
    np.add.at(
        shown,
        (np.minimum(row, height - 1), column % (2 * height)),
        lighting.irradiances / latlong_solid_angles(height)[np.minimum(row, height - 1)],
    )
    return TrueLight(coefficients, shown)
