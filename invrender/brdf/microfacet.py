"""The fitted BRDF, and the interpolation of RH01's lobe in sigma.

rho = Kd + Ks F(mu, theta_o) S(theta_h; sigma) / (4 cos theta_i cos theta_o)      [RH01, section 5.2]

where the form is RH01's own; `lobes` has the others.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from capture.arrays import frozen_array
from invrender.brdf.form import LobeForm
from invrender.brdf.lobes import RH01_FORM

Floats = NDArray[np.float64]

# Roughnesses between which the search looks: below, a highlight is narrower than the pixels of an
# ordinary photograph; above, the lobe is no longer distinguishable from diffuse reflection.
SIGMA_RANGE = (0.005, 0.7)
_NODES = 27


@dataclass(frozen=True, eq=False)
class Microfacet:
    """A fitted BRDF: a Lambertian base under a lobe.

    kd, ks : (3,), 1/sr and dimensionless, RGB. mu, sigma : None where the model lacks them. form : of the lobe.
    """

    kd: Floats
    ks: Floats
    mu: float | None
    sigma: float | None
    form: LobeForm = RH01_FORM

    def __post_init__(self) -> None:
        object.__setattr__(self, "kd", frozen_array(self.kd))
        object.__setattr__(self, "ks", frozen_array(self.ks))

    def moved_to(self, name: str, value: float) -> Microfacet:
        """The same with another mu, sigma or number of the form."""
        if name in self.form.numbers:
            return replace(self, form=self.form.with_numbers({name: value}))
        return replace(self, mu=value) if name == "mu" else replace(self, sigma=value)


def sigma_nodes() -> Floats:
    """The roughnesses at which transfers are tabulated: Chebyshev points in log sigma."""
    return chebyshev_nodes(SIGMA_RANGE, _NODES)


def sigma_weights(sigma: float | Floats) -> Floats:
    """Weights (nodes,) with which transfers at the nodes add up to the transfer at sigma; of several (f,), (f, nodes).

    What is interpolated is sigma^2 S, whose peak is the same for all sigma; the error is 1e-4 of it.
    """
    weights = chebyshev_weights(SIGMA_RANGE, _NODES, sigma) * sigma_nodes() ** 2
    return np.asarray(weights / np.asarray(sigma)[..., None] ** 2)


def chebyshev_nodes(ends: tuple[float, float], count: int) -> Floats:
    """Chebyshev points (count,) in the logarithm between two numbers above 0."""
    low, high = np.log(ends)
    return np.exp(low + (_points(count) + 1) / 2 * (high - low))


def chebyshev_weights(ends: tuple[float, float], count: int, at: float | Floats) -> Floats:
    """Weights (..., count) with which values at `chebyshev_nodes` are interpolated at numbers (...,)."""
    low, high = np.log(ends)
    position = np.clip(2 * (np.log(at) - low) / (high - low) - 1, -1, 1)
    polynomials = np.cos(np.arange(count) * np.arccos(position)[..., None])
    return np.asarray(polynomials @ _cardinal(count).T)


@lru_cache(maxsize=4)
def _cardinal(count: int) -> Floats:
    """What Chebyshev polynomials (columns) contribute to the weight of each node."""
    degrees = np.arange(count)
    at_nodes = np.cos(np.outer(np.arccos(_points(count)), degrees))
    return at_nodes * np.where(degrees == 0, 1, 2) / count


def _points(count: int) -> Floats:
    return np.cos((np.arange(count) + 0.5) * np.pi / count)
