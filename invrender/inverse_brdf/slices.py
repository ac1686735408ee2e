"""Slices of a BRDF at a fixed exitant angle, as RH01's Fig. 6 shows them, and how much of it rings below zero."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.fresnel import normalised_fresnel
from invrender.brdf.microfacet import Microfacet
from invrender.inverse_brdf.harmonic import HarmonicBRDF
from invrender.inverse_brdf.table import BRDFTable
from invrender.theory.specialcases import lobe

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

# The exitant angle of [RH01, Fig. 6].
EXITANT_DEG = 63.0
# Exitant angles, polar and azimuth angles of incidence of the pairs that ringing is looked for at.
_PAIRS = (12, 24, 48)
# Views as grazing as the samples that count.
_GRAZING = np.radians(81.0)


class Directions(NamedTuple):
    """Pairs (n, 3) in the local frame: z along the normal, the view in the xz plane with x > 0."""

    incident: Floats
    exitant: Floats


def slice_directions(
    theta_incident: Floats, azimuth: Floats, exitant: float = np.radians(EXITANT_DEG)
) -> Directions:
    """Pairs for angles of incidence (n,) and azimuths (n,) from the view's, radians."""
    sin = np.sin(theta_incident)
    incident = np.stack([sin * np.cos(azimuth), sin * np.sin(azimuth), np.cos(theta_incident)], axis=1)
    view = np.array([np.sin(exitant), 0.0, np.cos(exitant)])
    return Directions(incident, np.broadcast_to(view, incident.shape))


def slice_grid(rows: int = 90, columns: int = 180) -> Directions:
    """Pairs (rows * columns, 3) of Fig. 6's pictures: angle of incidence 0 to 90 degrees down, azimuth 0 to 360."""
    theta, phi = np.meshgrid(
        (np.arange(rows) + 0.5) / rows * np.pi / 2,
        (np.arange(columns) + 0.5) / columns * 2 * np.pi,
        indexing="ij",
    )
    return slice_directions(theta.ravel(), phi.ravel())


def plane_of_incidence(count: int = 181) -> tuple[Floats, Directions]:
    """Angles of incidence (count,), degrees, negative on the viewer's side, and pairs in that plane."""
    degrees = np.linspace(-89.0, 89.0, count)
    return degrees, slice_directions(np.radians(np.abs(degrees)), np.where(degrees < 0, 0.0, np.pi))


def harmonic_transfer(brdf: HarmonicBRDF, pairs: Directions) -> Floats:
    """rho cos theta_i, (n, 3), of harmonic coefficients."""
    cos = pairs.exitant[:, 2]
    return brdf.reciprocal_values(pairs.incident, cos) / cos[:, None]


def table_transfer(table: BRDFTable, pairs: Directions) -> tuple[Floats, Bools]:
    """rho cos theta_i, (n, 3), of the bins that pairs lie in, and whether these are filled (n,)."""
    normals = np.broadcast_to([0.0, 0.0, 1.0], pairs.incident.shape)
    values, filled = table.lookup(normals, pairs.incident, pairs.exitant)
    return values * pairs.incident[:, 2:], filled


def parametric_transfer(brdf: Microfacet, pairs: Directions) -> Floats:
    """rho cos theta_i, (n, 3), of RH01's parametric model [RH01, section 5.2]."""
    cos_incident, cos_exitant = pairs.incident[:, 2], pairs.exitant[:, 2]
    result = cos_incident[:, None] * brdf.kd
    if brdf.sigma is not None:
        half = pairs.incident + pairs.exitant
        theta = np.arctan2(np.hypot(half[:, 0], half[:, 1]), half[:, 2])
        facing = normalised_fresnel(brdf.mu, cos_exitant) * lobe(theta, brdf.sigma) / (4 * cos_exitant)
        result = result + facing[:, None] * brdf.ks
    return np.asarray(result)


class Ringing(NamedTuple):
    """negative_share : of all pairs of directions, 0 to 1. depth : the lowest rho cos theta_i below 0 over the highest.

    Both of the channel in which it is worst.
    """

    negative_share: float
    depth: float


def ringing(brdf: HarmonicBRDF) -> Ringing:
    """How much of a harmonic BRDF lies below zero, where no BRDF does; pairs count alike per solid angle."""
    views, rows, columns = _PAIRS
    exitant = np.arccos(1 - (np.arange(views) + 0.5) / views * (1 - np.cos(_GRAZING)))
    theta, phi = np.meshgrid(
        np.arccos(1 - (np.arange(rows) + 0.5) / rows),
        (np.arange(columns) + 0.5) / columns * 2 * np.pi,
        indexing="ij",
    )
    values = np.concatenate(
        [harmonic_transfer(brdf, slice_directions(theta.ravel(), phi.ravel(), angle)) for angle in exitant]
    )
    depth = -values.min(axis=0) / values.max(axis=0)
    return Ringing(float((values < 0).mean(axis=0).max()), float(max(depth.max(), 0.0)))
