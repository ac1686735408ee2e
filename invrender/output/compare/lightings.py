"""Lightings side by side: their first nine coefficients, and the sources by their nearest counterparts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from capture.lighting import Lighting
from invrender.result.side import Side, SideLighting
from recon.harmonics.complex import project_sources
from recon.harmonics.latlong import map_coefficients

Floats = NDArray[np.float64]

# The nine coefficients that a diffuse surface sees.
_L_MAX = 2


@dataclass(frozen=True)
class SourcePair:
    """A source of A and its counterpart in B.

    numbers : in their lightings, counted from 1. angle_deg : between them. ratio : of irradiances, B to A, per channel,
    NaN where A's is 0. z : the largest difference of irradiances over the combined standard deviation; None where both
    are given, or a factor per channel is free. distances : of both from the object's centre, metres, None far away.
    """

    numbers: tuple[int, int]
    angle_deg: float
    ratio: tuple[float, float, float]
    z: float | None
    distances: tuple[float | None, float | None] = (None, None)


@dataclass(frozen=True, eq=False)
class LightPair:
    """A lighting of A and its counterpart in B.

    factor : (3,), what B was multiplied by for the comparison; 1 where both gauges are absolute.
    difference : of the first nine coefficients, of all channels together, relative to their mean.
    lone : how many sources of A, and of B, have no counterpart.
    """

    first: SideLighting
    second: SideLighting
    factor: Floats
    difference: float
    sources: tuple[SourcePair, ...]
    lone: tuple[int, int]

    @property
    def name(self) -> str:
        one, other = self.first.lighting.name, self.second.lighting.name
        return one if one == other else f"{one} / {other}"


def light_pairs(first: Side, second: Side) -> tuple[LightPair, ...]:
    """Lightings of the same name, or the only one of either side."""
    free = not (first.is_absolute and second.is_absolute)
    if len(first.lightings) == len(second.lightings) == 1:
        return (_pair(first.lightings[0], second.lightings[0], free),)
    named = {entry.lighting.name: entry for entry in second.lightings}
    matched = [entry for entry in first.lightings if entry.lighting.name in named]
    return tuple(_pair(entry, named[entry.lighting.name], free) for entry in matched)


def first_coefficients(lighting: Lighting) -> Floats:
    """The first nine coefficients (9, 3) of a lighting, map and sources."""
    total = project_sources(lighting.directions, lighting.irradiances, _L_MAX)
    if lighting.radiance_map is not None:
        total = total + map_coefficients(lighting.radiance_map, _L_MAX)
    return np.asarray(total, float).reshape(-1, 3)


def _pair(first: SideLighting, second: SideLighting, free: bool) -> LightPair:
    one, other = first_coefficients(first.lighting), first_coefficients(second.lighting)
    factor = np.ones(3)
    if free:
        power = (other**2).sum(axis=0)
        factor = np.where(power > 0, (one * other).sum(axis=0) / np.where(power > 0, power, 1), 1.0)
    other = other * factor
    mean = float(np.linalg.norm((one + other) / 2))
    difference = float(np.linalg.norm(one - other)) / mean if mean > 0 else 0.0
    sources = _source_pairs(first, second, factor, free)
    counts = len(first.lighting.directions), len(second.lighting.directions)
    lone = counts[0] - len(sources), counts[1] - len(sources)
    return LightPair(first, second, factor, difference, sources, lone)


def _source_pairs(
    first: SideLighting, second: SideLighting, factor: Floats, free: bool
) -> tuple[SourcePair, ...]:
    """Sources matched so that the angles between them add up to the least."""
    one, other = first.lighting, second.lighting
    across = np.linalg.norm(np.cross(one.directions[:, None], other.directions[None]), axis=2)
    angles = np.degrees(np.arctan2(across, one.directions @ other.directions.T))
    pairs = []
    for i, j in zip(*linear_sum_assignment(angles), strict=True):
        mine, theirs = one.irradiances[i], other.irradiances[j] * factor
        ratio = np.where(mine > 0, theirs / np.where(mine > 0, mine, 1), np.nan)
        std = np.hypot(first.irradiance_std[i], second.irradiance_std[j])
        z = None
        if not free and (std > 0).all():
            z = float(np.abs((theirs - mine) / std).max())
        pairs.append(
            SourcePair(
                (int(i) + 1, int(j) + 1),
                float(angles[i, j]),
                tuple(float(r) for r in ratio),  # type: ignore[arg-type]
                z,
                (_distance(one, i), _distance(other, j)),
            )
        )
    return tuple(pairs)


def _distance(lighting: Lighting, source: int) -> float | None:
    """Metres from the object's centre to a near source; None of one far away."""
    place = lighting.places[source]
    return None if place is None else float(np.linalg.norm(place[0] - lighting.centre))
