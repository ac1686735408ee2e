"""Other forms of the lobe that explain the photographs as well, and what they put elsewhere.

As under known light, what models say that the photographs don't speak against belongs into the error bars. The forms
are those that were tried before the ladder, and the chosen one's with light and viewer hidden apart, or together. All
are fitted to the same samples, whose noise is in each alike: what they differ by counts whole.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.lobes import UNCORRELATED
from invrender.estimate.unknown_light.cross_validation import BlindCandidate, as_good, cross_validate
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


def alternatives_of(
    search: Search, chosen: BlindCandidate, tried: Sequence[BlindCandidate]
) -> tuple[BlindFit, ...]:
    """Fits with lobes of other forms that predict samples as well, as on the ladder; without their rows.

    chosen : fitted to all samples of the search. tried : the ladder, from whose fits of other forms they start.
    """
    own, error = chosen.fit.state, chosen.error
    if own.sigma is None:
        return ()
    # The same with what hides light and viewer hidden together or apart starts at the chosen one itself.
    like = {**UNCORRELATED, **{apart: form for form, apart in UNCORRELATED.items()}}.get(own.form)
    starts = [
        _instead(own, candidate.fit.state)
        for candidate in tried
        if candidate.fit.state.sigma is not None
        # One with more numbers is as good by these alone.
        and candidate.parameters <= chosen.parameters
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
    return tuple(candidate.fit for candidate in candidates[1:] if as_good(candidate, best))


def _instead(own: BlindState, other: BlindState) -> BlindState:
    """Another form's BRDF under the sources of one's own, without Fresnel factor where this has none."""
    other = other.without_fresnel() if own.mu is None else other
    return replace(other, directions=own.directions, owners=own.owners)


def with_alternatives(
    certainty: BlindUncertainty, fit: BlindFit, rivals: Sequence[BlindFit]
) -> BlindUncertainty:
    """Standard deviations that hold by how much rivals put each number and the light elsewhere."""
    std = dict(zip(fit.state.names, np.sqrt(np.diag(certainty.covariance)), strict=True))
    other_mu = {
        rival.state.form.name: rival.state.mu
        for rival in rivals
        if rival.state.mu is not None
        and abs(_moved(fit.state, rival.state).get("mu", 0.0)) > std.get("mu", np.inf)
    }
    return replace(widened(certainty, fit, rivals), other_mu=other_mu)


def widened(certainty: BlindUncertainty, fit: BlindFit, others: Sequence[BlindFit]) -> BlindUncertainty:
    """Standard deviations that hold by how much other fits put each number and the light elsewhere."""
    names = fit.state.names
    apart, light_std = np.zeros(len(names)), dict(certainty.light_std)
    for other in others:
        moved = _moved(fit.state, other.state)
        apart = np.maximum(apart, [abs(moved.get(name, 0.0)) for name in names])
        for k, own in certainty.light_std.items():
            light_std[k] = np.maximum(light_std[k], np.hypot(own, other.light[k] - fit.light[k]))
    return replace(certainty, covariance=certainty.covariance + np.diag(apart**2), light_std=light_std)


def _moved(own: BlindState, rival: BlindState) -> dict[str, float]:
    """By how much another state has the numbers elsewhere that both have, by the names of `BlindState.names`."""
    moved = {
        f"share {c}": float(there - here)
        for c, here, there in zip("rgb", own.specular_share, rival.specular_share, strict=True)
    }
    if own.sigma is not None and rival.sigma is not None:
        moved["sigma"] = rival.sigma - own.sigma
    numbers = own.form.numbers
    moved |= {name: value - numbers[name] for name, value in rival.form.numbers.items() if name in numbers}
    if own.mu is not None and rival.mu is not None:
        moved["mu"] = rival.mu - own.mu
    turned = np.einsum("kaj,kj->ka", tangents(own.directions), rival.directions)
    for k, ways in enumerate(turned.tolist()):
        moved |= {f"source {k + 1} {way}": turn for way, turn in zip("ab", ways, strict=True)}
    return moved
