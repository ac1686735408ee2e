"""How many lamps light an object in the dark, whatever its reflectance is.

A lamp can repair the form of the lobe: where the model's base or highlights have another shape than the object's, lamps
near the true one take up the difference. So each lighting begins with one lamp, and a further one must explain what
that lamp explains under no reflectance: shading up to an attached shadow of its own, or a highlight elsewhere.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.form import Angles, LobeForm
from invrender.brdf.lobes import GGX_FORM
from invrender.brdf.microfacet import SIGMA_RANGE
from invrender.estimate.clusters import tiles_of
from invrender.estimate.unknown_light.lighting_design import LightingDesign
from invrender.estimate.unknown_light.near_lamps import with_near_lamps
from invrender.estimate.unknown_light.projection import BlindFit, predicted
from invrender.estimate.unknown_light.rows import source_rows
from invrender.estimate.unknown_light.source_evidence import PER_SOURCE, bright
from invrender.estimate.unknown_light.start import NOTHING, PEAK_WIDTH, Search, first_states
from invrender.estimate.unknown_light.state import BlindState, turns
from recon.sampling.highlights import small_highlights
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Widths, radians, of lobes whose sum is any lobe: each is twice the one before.
_WIDTHS: Floats = 0.0125 * 2.0 ** np.arange(6, dtype=float)
# Half-angles in sigma within which a highlight's form decides: what is there is no evidence for another lamp.
_AROUND = 1.5
# How far to the side of a lamp, radians, other lobes of it are; and iterations by which a start has shown its worth.
_BESIDE, _ITERATIONS = 0.06, 10
# How far off a lamp may be, radians, by its shading on a body that isn't Lambertian.
_FAR_OFF = 0.8
# Deviations from which on a residual may be a highlight's; directions of these that are candidates in each lighting, at
# most; and how often lamps are counted anew.
_OUTSTANDING, _HIGHLIGHTS, _ROUNDS = 6.0, 6, 4
# By how much more a lamp must save than one does whose place isn't sought among many.
_SOUGHT = 2.0
# Of directions, of columns and of widths, what is no difference.
_SAME, _CUT, _SAME_WIDTH = 1e-9, 1e-9, 1e-3


def fewest_sources(search: Search, diffuse: BlindFit, form: LobeForm) -> BlindFit:
    """The best fit of lamps in the dark, with no lamp that another reflectance makes needless.

    search : prepared for light of degree 0. diffuse : lamps as a Lambertian body shows them, which are candidates.
    form : of the lobe, the more general the better.
    """
    start = _best_start(search, _towards_highlights(search, brightest_each(diffuse)).with_form(form))
    fit = with_near_lamps(search, start)
    for _ in range(_ROUNDS):
        needed = needed_sources(search, fit, _at_highlights(search, fit, diffuse.state))
        if _same_lamps(needed, fit.state):
            break
        fit = with_near_lamps(search, bright(search, search.fit(needed, 0, _ITERATIONS)))
    return fit


def brightest_each(fit: BlindFit) -> BlindState:
    """The state of a fit with the brightest source alone in each lighting."""
    state, brightness = fit.state, fit.irradiances.sum(axis=1)
    first = {k: int(np.where(state.owners == k, brightness, -np.inf).argmax()) for k in state.owners.tolist()}
    rest = [k for k in range(len(brightness)) if k not in first.values()]
    return state.without_source(np.array(rest, int))


def _brightest_first(fit: BlindFit, lighting: int) -> Floats:
    """A lighting's lamps, (k, 3) or (k, 4) as a state has them."""
    own = np.flatnonzero(fit.state.owners == lighting)
    return fit.state.sources[own[np.argsort(-fit.irradiances[own].sum(axis=1))]]


def _at_highlights(search: Search, fit: BlindFit, state: BlindState) -> BlindState:
    """A state with lamps beside its own: those that would mirror what a fit leaves of highlights, the brightest few."""
    ways: dict[int, list[Floats]] = {lighting: [] for lighting in search.lightings}
    heights: dict[int, list[Floats]] = {lighting: [] for lighting in search.lightings}
    for design, rows in zip(search.designs, fit.rows, strict=True):
        residuals = design.split((design.radiance - predicted(design, fit, rows)).sum(axis=1))
        for photo, residual in zip(design.photos, residuals, strict=True):
            high = residual > _OUTSTANDING * 1.4826 * np.median(np.abs(residual))
            ways[design.lighting].append(_mirrored(photo, high))
            heights[design.lighting].append(residual[high])
    for lighting in search.lightings:
        order = np.argsort(-np.concatenate(heights[lighting]))
        found = np.concatenate(ways[lighting])[order]
        found = found[search.may_hold(lighting, found)]
        peaks = found[_apart(found, PEAK_WIDTH)]
        # Dust stands out alone.
        several = (peaks @ found.T > np.cos(PEAK_WIDTH)).sum(axis=1) > 1
        for direction in peaks[several][:_HIGHLIGHTS]:
            state = state.with_source(direction, lighting)
    return state


def _towards_highlights(search: Search, lamps: BlindState) -> BlindState:
    """Lamps turned to where the small highlight nearest to what they would mirror has them: shading is less precise."""
    directions = lamps.directions.copy()
    for k, (direction, lighting) in enumerate(zip(lamps.directions, lamps.owners.tolist(), strict=True)):
        photos = [photo for design in search.only(lighting).designs for photo in design.photos]
        found = [(photo, small_highlights(photo.rows, photo.columns, photo.radiance)) for photo in photos]
        ways = np.concatenate([_mirrored(photo, bright) for photo, bright in found])
        brightness = np.concatenate([photo.radiance[bright].sum(axis=1) for photo, bright in found])
        near = (ways @ direction > np.cos(_FAR_OFF)) & search.may_hold(lighting, ways)
        if near.any():
            peak = ways[np.where(near, brightness, 0).argmax()]
            mean = brightness[near] @ (ways[near] * (ways[near] @ peak > np.cos(PEAK_WIDTH))[:, None])
            directions[k] = mean / np.linalg.norm(mean)
    return replace(lamps, directions=directions)


def _mirrored(photo: LightField, chosen: NDArray[np.bool_]) -> Floats:
    """Unit directions (k, 3) that chosen samples (n,) mirror."""
    ways = np.asarray(photo.mean_over_rays(photo.mirrored))[chosen]
    return np.asarray(ways / np.linalg.norm(ways, axis=1, keepdims=True))


def _best_start(search: Search, lamps: BlindState) -> BlindFit:
    """The best fit near given lamps, from a narrow lobe and from a wide one that stays a lobe."""
    fits = [search.fit(start, 0, _ITERATIONS) for start in first_states(search, lamps)]
    return min(fits, key=lambda fit: (is_endless(fit.state), fit.cost))


def is_endless(state: BlindState) -> bool:
    """Whether a lobe has become as wide as it can, and so a part of the base that shows as no highlight."""
    return state.sigma is not None and state.sigma >= (1 - _SAME_WIDTH) * SIGMA_RANGE[1]


def _same_lamps(one: BlindState, other: BlindState) -> bool:
    """Whether all lamps of two states are the same, in any order."""
    if len(one.directions) != len(other.directions):
        return False
    if one.near != other.near:
        return False
    ways = one.directions @ other.directions.T - 3 * (one.owners[:, None] != other.owners)
    return bool((ways.max(axis=1, initial=-1) > 1 - _SAME).all())


def needed_sources(search: Search, fit: BlindFit, proposed: BlindState = NOTHING) -> BlindState:
    """A fit's state with the brightest lamp of each lighting, and those others that no reflectance makes needless.

    candidates : lamps beside the fit's own that may be needed.
    """
    state = fit.state
    result = state.without_source(np.arange(len(state.directions)))
    for lighting in search.lightings:
        lamps, others = _brightest_first(fit, lighting), proposed.under(lighting).directions
        lamps = np.vstack([lamps, np.pad(others, ((0, 0), (0, lamps.shape[1] - 3)))])
        if len(lamps):
            # Of two that share a highlight one may repair the other's: half-angles are half of directions' angles.
            lamps = lamps[_apart(lamps[:, :3], 2 * _highlight_width(state))]
            for lamp in lamps[_needed(search.only(lighting), state, lamps)]:
                result = result.with_source(lamp, lighting)
    return result


def _apart(directions: Floats, width: float) -> list[int]:
    """Which of directions (k, 3) are no nearer to one before them than a width, radians."""
    kept: list[int] = []
    for k, along in enumerate(directions @ directions.T):
        if (along[kept] < np.cos(width)).all():
            kept.append(k)
    return kept


def _needed(search: Search, state: BlindState, lamps: Floats) -> list[int]:
    """Which of one lighting's lamps are needed: the first, and others as long as one saves what its numbers cost."""
    kept, rest = [0], list(range(1, len(lamps)))
    known = _any_reflectance(search, lamps[0])
    plain = _plain(search, state, lamps)
    width = _highlight_width(state)
    while rest:
        away = _off_highlights(search, lamps[kept], width)
        left = _left(away, known, plain[:, :, :0])
        source_penalty = _price(away, *_left(away, known, plain[:, :, rest]))
        saved = [left[0] - _left(away, known, plain[:, :, [k]])[0] for k in rest]
        best = int(np.argmax(saved))
        if saved[best] < source_penalty:
            break
        kept.append(rest.pop(best))
        known = np.hstack([known, _any_reflectance(search, lamps[kept[-1]])])
    return kept


def _highlight_width(state: BlindState) -> float:
    """Half-angle, radians, within which a highlight's form decides what is seen."""
    return max(_AROUND * state.roughness, PEAK_WIDTH)


def _off_highlights(search: Search, lamps: Floats, width: float) -> Search:
    """The same without samples whose normal is nearer than a width, radians, to the one that mirrors a lamp."""
    weights = []
    for design, weight in zip(search.designs, search.weights, strict=True):
        towards, _ = design.towards(lamps)
        angles = Angles.between(design.field.normals[:, None], towards, design.field.views[:, None])
        near = design.field.mean_over_rays((angles.theta_h < width).any(axis=1).astype(float))
        weights.append(weight * (near == 0)[:, None])
    return replace(search, weights=weights)


def _any_reflectance(search: Search, lamp: Floats) -> Floats:
    """Columns (n, q) of a lamp under any reflectance: light from all sides, then smooth bases and lobes of all widths.

    These there and to all sides of it, so that no highlight drawn out or lopsided takes another lamp, either.
    """
    beside = [turns(lamp[None, :3], angle)[0] for angle in (_BESIDE, -_BESIDE)]
    ways = np.column_stack([np.vstack([lamp[:3], *beside]), np.tile(lamp[3:], (5, 1))])
    found = []
    for design in search.designs:
        columns = np.hstack([_columns(design, way) for way in ways])
        found.append(np.hstack([design.within(design.diffuse[:, :1]), design.within(columns)]))
    return np.vstack(found)


def _plain(search: Search, state: BlindState, lamps: Floats) -> Floats:
    """Columns (3, n, k) of lamps as a state's BRDF reflects them, channel by channel."""
    lit = state.without_source(np.arange(len(state.directions)))
    for lamp in lamps:
        lit = lit.with_source(lamp)
    rows = [source_rows(design, lit) for design in search.designs]
    return np.array(
        [
            np.vstack([own.of_channel(specular_share) for own in rows])
            for specular_share in state.specular_share
        ]
    )


def _columns(design: LightingDesign, lamp: Floats) -> Floats:
    """Columns (n, q) of a lamp: reciprocal polynomials in both cosines, times that of incidence; and lobes."""
    towards, factors = design.towards(lamp[None])
    angles = Angles.between(design.field.normals, towards[..., 0, :], design.field.views)
    cos_i, cos_o = (np.clip(cos, 0, 1) for cos in (angles.cos_i, angles.cos_o))
    base = [cos_i, cos_i * (cos_i + cos_o), cos_i * cos_i * cos_o, cos_i * (cos_i**2 + cos_o**2)]
    lobes = [GGX_FORM.shape(angles, float(width)) for width in _WIDTHS]
    lit = design.free(lamp[None])[:, 0] * factors[..., 0]
    return np.asarray(design.field.mean_over_rays(np.stack([*base, *lobes], axis=-1) * lit[:, None]))


def _left(search: Search, shared: Floats, own: Floats) -> tuple[float, float, int]:
    """Squared residuals that columns (n, q) and each channel's own (3, n, k) leave.

    Also how many of the residuals count as one witness, and how many numbers were fitted.
    """
    radiance = np.vstack([design.radiance for design in search.designs])
    root = np.sqrt(np.vstack(search.weights))
    left = np.empty_like(radiance)
    for c in range(3):
        whitened = np.hstack([shared, own[c]]) * root[:, c, None]
        target = radiance[:, c] * root[:, c]
        left[:, c] = target - whitened @ np.linalg.lstsq(whitened, target, rcond=_CUT)[0]
    total = float((left**2).sum())
    tiles = tiles_of([photo for design in search.designs for photo in design.photos])
    together = float((np.bincount(tiles, left.sum(axis=1)) ** 2).sum()) / max(total, 1e-300)
    return total, max(together, 1.0), 3 * (shared.shape[1] + own.shape[2])


def _price(search: Search, left: float, together: float, fitted: int) -> float:
    """Squared residuals that a lamp must save where so many are left and are correlated."""
    numbers = sum(np.count_nonzero(weight) for weight in search.weights)
    return float(_SOUGHT * PER_SOURCE * np.log(numbers) * left / max(numbers - fitted, 1) * together)
