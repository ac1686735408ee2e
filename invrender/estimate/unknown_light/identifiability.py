"""What blind factorization determined, and where it did not: why, and what photograph would settle it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from invrender.estimate.identifiability import Scalar, assess_linear, assess_mu, assess_number, assess_sigma
from invrender.estimate.quantities import Quantity
from invrender.estimate.reached import reached_share
from invrender.estimate.unknown_light.lighting_design import LightingDesign
from invrender.estimate.unknown_light.projection import BlindFit
from invrender.estimate.unknown_light.uncertainty import BlindUncertainty
from recon.harmonics.basis import degrees
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]

# A degree is the photographs' when they hold at least this share of what is known of it.
_DETERMINED = 0.5
_POWER = 0.99
# Of what a state lists, the numbers of which a reported one is made.
_NUMBERS = dict.fromkeys(("kd_normalised", "ks_normalised"), ("share r", "share g", "share b"))
# Directions of which reflections show less than this share leave light above the degrees of shading to guesswork.
_REACHED, _DIFFUSE_DEGREE = 0.75, 2


def determined_degree(shares: Floats) -> int:
    """The degree up to which all are determined by the photographs; -1 if not even degree 0 is."""
    lost = np.flatnonzero(shares < _DETERMINED)
    return int(lost[0]) - 1 if len(lost) else len(shares) - 1


def varying_degree(fit: BlindFit) -> int | None:
    """The degree up to which lies 99% of the varying power of the best-suited light; None where one has sources."""
    if len(fit.state.directions):
        return None
    l = degrees(fit.l_max)
    found = []
    for light in fit.light.values():
        power = np.bincount(l, (light**2).sum(axis=1))[1:]
        found.append(1 + int(np.searchsorted(np.cumsum(power) / max(power.sum(), 1e-300), _POWER)))
    return max(found)


def quantities_of(
    fit: BlindFit, certainty: BlindUncertainty, designs: Sequence[LightingDesign]
) -> dict[str, Quantity]:
    """The reported numbers with their statuses."""
    state, names = fit.state, fit.state.names
    std = dict(zip(names, np.sqrt(np.diag(certainty.covariance)), strict=True))
    fragility = dict(zip(names, certainty.fragility, strict=True))
    share = float(state.specular_share.mean())
    share_std = np.array([std.get(f"share {c}", 0.0) for c in "rgb"])
    found = {
        "kd_normalised": assess_linear(1 - state.specular_share, share_std, np.ones(3), "Kd"),
        "ks_normalised": assess_linear(state.specular_share, share_std, np.ones(3), "Ks"),
    }
    if state.mu is not None:
        scalar = Scalar(state.mu, std["mu"], fragility["mu"])
        found["mu"] = assess_mu(scalar, [design.field for design in designs], share)
    if state.sigma is not None:
        scalar = Scalar(state.sigma, std["sigma"], fragility["sigma"])
        found["sigma"] = assess_sigma(scalar, varying_degree(fit), share)
        for name, value in state.form.numbers.items():
            found[name] = assess_number(np.array([value]), np.array([std[name]]))
    variances = certainty.variances

    def shared(name: str, quantity: Quantity) -> Quantity:
        places = [names.index(own) for own in _NUMBERS.get(name, (name,)) if own in names]
        return quantity.with_shares({cause: own[places] for cause, own in variances.items()})

    return {name: shared(name, quantity) for name, quantity in found.items()}


def doubt_of(fit: BlindFit, shares: Floats, fields: Sequence[LightField]) -> tuple[int, Quantity | None]:
    """The degree up to which a lighting is determined, and why not all of it is; None if all is.

    shares : (l_max + 1,), of the photographs in what is known. fields : the photographs under it.
    """
    degree, reached = determined_degree(shares), reached_share(fields)
    if fit.state.sigma is not None and reached < _REACHED and min(degree, fit.l_max) > _DIFFUSE_DEGREE:
        return _DIFFUSE_DEGREE, Quantity(
            None,
            None,
            "undetermined",
            f"mirrored rays look at {reached:.0%} of all directions; light from elsewhere shows in diffuse reflection"
            f" only, which passes little above degree {_DIFFUSE_DEGREE} (RH01, section 5.1): more of it is continued"
            " from what is seen",
            "add photographs from more sides",
        )
    if degree >= fit.l_max:
        return degree, None
    if fit.state.sigma is None:
        why = (
            "a Lambertian object passes no odd degrees above 1 and little of the even ones above 2: it is a low-pass"
            " filter (RH01, section 5.1)"
        )
        remedy = "photograph a glossier object, or a mirror ball, under the same light"
    elif degree * fit.state.sigma >= 1:
        why = (
            f"a lobe of width {fit.state.sigma:.3f} rad passes degrees up to about {1 / fit.state.sigma:.0f} (RH01, eq."
            " 20)"
        )
        remedy = "photograph a glossier object, or a mirror ball, under the same light"
    else:
        why = "the reflections seen come from part of the sphere of directions only"
        remedy = "add photographs from more sides"
    return degree, Quantity(
        None,
        None,
        "undetermined",
        f"degrees above {degree} of the lighting owe less than half of what is known of them to the photographs (degree"
        f" {degree + 1}: {shares[degree + 1]:.0%}): {why}",
        remedy,
    )
