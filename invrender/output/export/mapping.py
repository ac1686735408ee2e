"""Our BRDF in a target's numbers, by least squares, and what is lost by it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.optimize import least_squares

from invrender.brdf.form import Angles
from invrender.brdf.microfacet import Microfacet
from invrender.output.export.directions import Pairs, direction_pairs
from invrender.output.export.target import Numbers, Target
from invrender.transport.diffuse_base import base_share

Floats = NDArray[np.float64]

# Below this share of the root mean square reflectance roots are straight, so that what is nearly black doesn't weigh.
_FLOOR = 1e-4
# Of the numbers in a row, those before the lobe's strength by channel.
_BEFORE_SPECULAR = 5
# For a BRDF without a lobe, whose pairs may be any.
_NO_LOBE_WIDTH = 0.3


@dataclass(frozen=True, eq=False)
class Mapping:
    """A BRDF in a target's numbers.

    relative_rms : difference over all pairs of directions. base_gain : what a base is multiplied by to look like ours
    with what the target shows of it. view_deg : (v,), angles of view. view_rms : (v,), difference seen from these,
    relative RMS. albedo, albedo_error : (v, 3), share of uniform light that our BRDF reflects to each view, and how
    much more the target does. worst : where the difference is largest.
    """

    target: Target
    numbers: Numbers
    relative_rms: float
    base_gain: float
    view_deg: Floats
    view_rms: Floats
    albedo: Floats
    albedo_error: Floats
    worst: Worst


@dataclass(frozen=True)
class Worst:
    """The pair of directions at which a target differs most: angles to the normal, both reflectances times cosine."""

    light_deg: float
    view_deg: float
    ours: float
    theirs: float


def reflectance_cosine(brdf: Microfacet, angles: Angles) -> Floats:
    """Our reflectance times cos theta_i, (n, 3), 1/sr."""
    total = brdf.kd * (_base_share(brdf, angles) * angles.cos_i)[:, None]
    if brdf.sigma is not None:
        total = total + brdf.ks * brdf.form.reflected(angles, brdf.mu, brdf.sigma)[:, None]
    return np.asarray(total)


def _base_share(brdf: Microfacet, angles: Angles) -> Floats:
    return base_share(brdf.form, brdf.mu, angles.cos_i, angles.cos_o)


def map_brdf(brdf: Microfacet, targets: Sequence[Target], strongest: float = 1.0) -> Mapping:
    """The target of several that differs least from a BRDF, with its numbers.

    strongest : how many times as strong as here the lobe must become in texels, with the same numbers but one.

    Minimised are differences of square roots, near to what differences look like on a screen: radiance itself would let
    the peak of the highlight decide everything else.
    """
    pairs = direction_pairs(brdf.sigma or _NO_LOBE_WIDTH)
    ours = reflectance_cosine(brdf, pairs.angles)
    mappings = [
        _judged(target, _fitted(target, brdf, ours, pairs, strongest), brdf, ours, pairs)
        for target in targets
        if target.takes(brdf)
    ]
    return min(mappings, key=lambda mapping: mapping.relative_rms)


def _fitted(target: Target, brdf: Microfacet, ours: Floats, pairs: Pairs, strongest: float) -> Numbers:
    if brdf.sigma is None or not brdf.ks.any():
        return target.matte(np.pi * brdf.kd)
    root_weights = np.sqrt(pairs.weights)[:, None]
    floor = _FLOOR * np.sqrt(np.average((ours**2).mean(axis=1), weights=pairs.weights))

    low, high = (numbers.vector for numbers in target.bounds(brdf, strongest))
    vector = np.clip(target.start(brdf).vector, low, high)
    # A neutral highlight stays neutral. Besides, what targets take off the base follows from the strongest channel:
    # where all are alike no slope shows how they would change together.
    alike = np.unique(brdf.ks, return_inverse=True)[1]
    spread = block_diag(np.eye(_BEFORE_SPECULAR), alike == np.arange(alike.max() + 1)[:, None])
    spread = spread[spread @ (high > low) > 0]
    free, first = spread.any(axis=0), spread.argmax(axis=1)

    def filled(values: Floats) -> Floats:
        return np.where(free, values @ spread, vector)

    def difference(values: Floats) -> Floats:
        theirs = target.reflected(pairs.angles, Numbers.of(filled(values)))
        return np.asarray((root_weights * (np.sqrt(theirs + floor) - np.sqrt(ours + floor))).ravel())

    found = least_squares(
        difference, vector[first], bounds=(low[first], high[first]), x_scale="jac", max_nfev=60
    )
    return Numbers.of(filled(found.x))


def _judged(target: Target, numbers: Numbers, brdf: Microfacet, ours: Floats, pairs: Pairs) -> Mapping:
    theirs = target.reflected(pairs.angles, numbers)
    difference, square = (theirs - ours) ** 2, ours**2
    weights = pairs.weights[:, None]
    worst, channel = np.unravel_index(np.abs(theirs - ours).argmax(), ours.shape)
    albedo = pairs.per_view(ours)
    matte = target.base_shown(pairs.angles, numbers)
    shown = _base_share(brdf, pairs.angles)[:, None]
    weighted_cos = weights * pairs.angles.cos_i[:, None] ** 2
    degrees = np.degrees(np.arccos(np.array([pairs.angles.cos_i[worst], pairs.angles.cos_o[worst]])))
    return Mapping(
        target,
        numbers,
        float(np.sqrt((weights * difference).sum() / (weights * square).sum())),
        float((weighted_cos * matte * shown).sum() / (weighted_cos * matte * matte).sum()),
        np.degrees(np.arccos(pairs.views)),
        np.sqrt(pairs.per_view(difference).sum(axis=1) / pairs.per_view(square).sum(axis=1)),
        albedo,
        pairs.per_view(theirs) - albedo,
        Worst(
            float(degrees[0]), float(degrees[1]), float(ours[worst, channel]), float(theirs[worst, channel])
        ),
    )
