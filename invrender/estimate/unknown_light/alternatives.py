"""Other forms of the lobe that explain the photographs nearly as well, and what they put elsewhere.

As under known light, what models say that the photographs don't speak against belongs into the error bars, as far as
they are plausible. The forms are those that were tried before the ladder, and the chosen one's with light and viewer
hidden apart, or together. All are fitted to the same samples, whose noise is in each alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from capture.selection import plausibility
from invrender.brdf.lobes import UNCORRELATED
from invrender.brdf.richer import core_width
from invrender.estimate.evidence import of_rival
from invrender.estimate.unknown_light.cross_validation import BlindCandidate, cross_validate
from invrender.estimate.unknown_light.projection import BlindFit
from invrender.estimate.unknown_light.start import Search
from invrender.estimate.unknown_light.state import BlindState
from invrender.estimate.unknown_light.uncertainty import BlindUncertainty
from recon.mesh.tangents import tangents

Floats = NDArray[np.float64]

# Error on samples that a form has not seen, over the chosen one's, up to which it may be a rival once it is fitted: it
# was left two iterations after RH01's best.
_PROMISING = 1.1
_ITERATIONS = 4


@dataclass(frozen=True, eq=False)
class Rival:
    """A fit with another form of the lobe, without its rows.

    weight : how plausible it is beside the best, from 1 (as good) to 0.
    """

    fit: BlindFit
    weight: float


def alternatives_of(
    search: Search, chosen: BlindCandidate, tried: Sequence[BlindCandidate], error: float
) -> tuple[Rival, ...]:
    """Fits with lobes of other forms, and how plausible each is.

    chosen : fitted to all samples of the search. tried : the ladder, from whose fits of other forms they start. error :
    of the chosen one on the samples of the ladder.
    """
    own = chosen.fit.state
    if own.sigma is None:
        return ()
    # The same with what hides light and viewer hidden together or apart starts at the chosen one itself.
    like = {**UNCORRELATED, **{apart: form for form, apart in UNCORRELATED.items()}}.get(own.form)
    starts = [
        _instead(own, candidate.fit.state)
        for candidate in tried
        if candidate.fit.state.sigma is not None
        and candidate.fit.state.form.family is not own.form.family
        and candidate.fit.state.form is not like
        and candidate.error < _PROMISING * error
    ]
    starts += [] if like is None else [own.with_form(like)]
    candidates = [chosen]
    for start in starts:
        fit = search.fit(start, chosen.fit.l_max, _ITERATIONS)
        candidate = cross_validate(fit.state.form.name, search, fit)
        candidates.append(replace(candidate, fit=replace(fit, rows=())))
    best = min(candidates, key=lambda candidate: candidate.deviance.mean())
    return tuple(Rival(each.fit, plausibility(each.deviance, best.deviance)) for each in candidates[1:])


def _instead(own: BlindState, other: BlindState) -> BlindState:
    """Another form's BRDF under the sources of one's own, without Fresnel factor where this has none."""
    other = other.without_fresnel() if own.mu is None else other
    return other.with_sources_of(own)


def with_alternatives(
    certainty: BlindUncertainty, fit: BlindFit, rivals: Sequence[Rival]
) -> BlindUncertainty:
    """Standard deviations that hold by how much rivals put each number and the light elsewhere."""
    std = dict(zip(fit.state.names, np.sqrt(np.diag(certainty.covariance)), strict=True))
    other_mu = {
        rival.fit.state.form.name: rival.fit.state.mu
        for rival in rivals
        if rival.fit.state.mu is not None
        and of_rival(rival.weight) * abs(_moved(fit.state, rival.fit.state).get("mu", 0.0))
        > std.get("mu", np.inf)
    }
    others, weights = [rival.fit for rival in rivals], [of_rival(rival.weight) for rival in rivals]
    return replace(widened(certainty, fit, others, weights, "forms"), other_mu=other_mu)


def widened(
    certainty: BlindUncertainty,
    fit: BlindFit,
    others: Sequence[BlindFit],
    parts: Sequence[float],
    cause: str,
) -> BlindUncertainty:
    """Standard deviations that hold by how much other fits put each number and the light elsewhere.

    parts : of those differences, one for each fit. cause : that they differ for, a name among `quantities.CAUSES`.
    """
    names = fit.state.names
    apart, light_apart = (
        np.zeros(len(names)),
        {k: np.zeros_like(own) for k, own in certainty.light_std.items()},
    )
    for other, part in zip(others, parts, strict=True):
        moved = _moved(fit.state, other.state)
        apart = np.maximum(apart, [part * abs(moved.get(name, 0.0)) for name in names])
        for k, own in light_apart.items():
            light_apart[k] = np.maximum(own, part * np.abs(other.light[k] - fit.light[k]))
    return replace(
        certainty,
        covariance=certainty.covariance + np.diag(apart**2),
        light_std={k: np.hypot(own, light_apart[k]) for k, own in certainty.light_std.items()},
        causes={**certainty.causes, cause: apart**2},
    )


def _moved(own: BlindState, rival: BlindState) -> dict[str, float]:
    """By how much another state has the numbers elsewhere that both have, by the names of `BlindState.names`.

    Widths are compared by cores, as under known light.
    """
    moved = {
        f"share {c}": float(there - here)
        for c, here, there in zip("rgb", own.specular_share, rival.specular_share, strict=True)
    }
    if own.sigma is not None and rival.sigma is not None:
        lobe = own.form.lobe
        alike = core_width(rival.form, rival.sigma, lobe) / core_width(own.form, own.sigma, lobe)
        moved["sigma"] = rival.sigma * alike - own.sigma
    numbers = own.form.numbers
    moved |= {name: value - numbers[name] for name, value in rival.form.numbers.items() if name in numbers}
    if own.mu is not None and rival.mu is not None:
        moved["mu"] = rival.mu - own.mu
    turned = np.einsum("kaj,kj->ka", tangents(own.directions), rival.directions)
    for k, ways in enumerate(turned.tolist()):
        moved |= {f"source {k + 1} {way}": turn for way, turn in zip("ab", ways, strict=True)}
    for k in own.near:
        there = 0.0 if rival.closeness is None else rival.closeness[k]
        moved[f"closeness {k + 1}"] = float(there - own.sources[k, 3])
    return moved
