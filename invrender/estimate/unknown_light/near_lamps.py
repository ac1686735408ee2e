"""Lamps that are near: one over the distance is sought where photographs ask for it [RMB07, section 5.1].

A near lamp's light falls off and turns across the object. A lamp is taken for distant until its closeness, one number
more, saves what it costs.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from invrender.estimate.linear import symmetric_pinv
from invrender.estimate.unknown_light.projection import BlindFit, shared_equations
from invrender.estimate.unknown_light.source_evidence import design_effect, source_penalty
from invrender.estimate.unknown_light.start import Search
from invrender.estimate.unknown_light.state import CLOSENESS_RANGE, BlindState
from invrender.estimate.unknown_light.uncertainty import blind_uncertainty

Floats = NDArray[np.float64]

# Where a search for the closeness begins, and iterations until it has shown its worth.
_FIRST, _FEW = 0.1, 8
# Standard deviations beyond which a lamp is near.
_SURE = 3.0


def with_near_lamps(search: Search, fit: BlindFit, start: BlindState | None = None) -> BlindFit:
    """The fit with the lamps of those lightings near that photographs show to be so; the fit itself if none are.

    Lamps that are near already stay so. None are sought on textured bodies, whose paint takes up what falls off.
    start : where the fit began. It may have lost lamps that explain nothing as distant ones.
    """
    if any(design.frame.radius == 0 or design.field.place is not None for design in search.designs):
        return fit
    lost = start is not None and len(start.directions) > len(fit.state.directions)
    state = start if start is not None and lost else fit.state
    sought = ~np.isin(np.arange(len(state.directions)), state.near)
    if not sought.any():
        return fit
    known = np.zeros(len(sought)) if state.closeness is None else state.closeness
    if not lost and not _may_be_near(search, fit, np.where(sought, CLOSENESS_RANGE[0], known)):
        return fit
    tried = search.fit(state.with_closeness(np.where(sought, _FIRST, known)), fit.l_max, _FEW)
    lightings = set(state.owners[sought].tolist())
    near = {k for k in lightings if _worth_it(search, tried, fit, k, int(sought[state.owners == k].sum()))}
    better = tried.state
    for lighting in lightings - near:
        better = better.with_sources_of(fit.state, lighting)
    return _surely_near(search, search.fit(better, fit.l_max)) if near else fit


def _may_be_near(search: Search, fit: BlindFit, closeness: Floats) -> bool:
    """Whether one Gauss-Newton step from a fit brings a lamp nearer than noise would.

    closeness : (k,), where the step begins.
    """
    begun = search.at(fit.state.with_closeness(closeness), fit.l_max)
    equations = shared_equations(search.designs, search.weights, begun)
    noise = begun.cost / search.numbers * design_effect(search, begun, search.lightings)
    inverse = symmetric_pinv(equations.corner)
    asked = [k for k, name in enumerate(begun.state.names) if name.startswith("closeness")]
    step = inverse[asked] @ equations.right
    return bool((step > np.sqrt(noise * np.diag(inverse)[asked])).any())


def _surely_near(search: Search, fit: BlindFit) -> BlindFit:
    """The fit with those lamps far away whose closeness may be nothing: what a model lacks looks like it, too."""
    closeness = fit.state.closeness
    if closeness is None:
        return fit
    std = blind_uncertainty(search, fit).closeness_std(fit.state)
    sure = closeness > _SURE * std
    if (sure | (closeness == 0)).all():
        return fit
    return search.fit(fit.state.with_closeness(np.where(sure, closeness, 0)), fit.l_max)


def _worth_it(search: Search, near: BlindFit, distant: BlindFit, lighting: int, count: int) -> bool:
    """Whether so many more near lamps of a lighting save what a source costs, each; all stand outside the object."""
    own, closeness = near.state.owners == lighting, near.state.closeness
    saved = distant.costs[lighting] - near.costs[lighting]
    outside = closeness is not None and (closeness[own] < CLOSENESS_RANGE[1]).all()
    lit = (near.irradiances[own].sum(axis=1) > 0).all()
    return bool(outside and lit and saved > count * source_penalty(search, near, lighting))
