"""The light that shares and mu imply, as harmonic coefficients up to l* [RH01, section 6.2, eq. 25].

    B = sum of L_lm (Kd Lambda_l rho_l Y_lm(normal) + Ks F Y_lm(R)),   l <= l*

A mesh hides some of the mirrored rays, and some of each harmonic's irradiance [section 6.4]; B stays linear in L_lm.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BarycentricInterpolator

from invrender.estimate.rh01.samples import Samples
from invrender.estimate.rh01.simplex import mu_nodes
from recon.harmonics.latlong import synthesise_latlong

Floats = NDArray[np.float64]

# l* of section 6.4: of the order of 1 / sigma.
DIRECT_DEGREE = 12
# Added to the diagonal, over its mean: a small Ks leaves odd degrees to rounding.
_RIDGE = 1e-9


@dataclass(frozen=True, eq=False)
class DirectLighting:
    """Inverse lighting of samples by the direct method; their rows for the diffuse part go up to l*."""

    samples: Samples
    fresnel: bool

    def judging(self, judged: NDArray[np.bool_]) -> DirectLighting:
        """The same, with the error of the marked samples (n,) only."""
        return replace(self, samples=replace(self.samples, judged=judged))

    def error(self, share: Floats, position: float) -> float:
        """Relative RMS of the judged samples' residuals by the light that fits them, at shares (3,) and log(mu - 1).

        Others, whose highlights no coefficients up to l* can hold, would ring in all of the light.
        """
        products = self._table(position) if self.fresnel else self._fixed
        squares = power = 0.0
        for c in range(3):
            gram, pull, own = _mixed(share[c], products, c)
            squares += own - float(_solved(gram, pull) @ pull)
            power += own
        return float(np.sqrt(max(squares, 0.0) / power))

    def light(self, share: Floats, mu: float | None) -> tuple[Floats, Floats]:
        """Coefficients (k, 3) that fit all samples, and the map (H, 2H, 3) that has them."""
        products = self._products(mu, np.ones_like(self.samples.judged))
        coefficients = np.stack([_solved(*_mixed(share[c], products, c)[:2]) for c in range(3)], axis=1)
        return coefficients, np.asarray(synthesise_latlong(coefficients, self.samples.height), float)

    def _products(self, mu: float | None, which: NDArray[np.bool_]) -> Floats:
        """Products (2k + 3, 2k + 3) of what unit Kd shows of some samples, what unit Ks shows, and their radiance."""
        samples = self.samples
        glossy = samples.fresnel(mu)[:, None] * samples.mirrored_harmonics
        columns = samples.root[:, None] * np.hstack([samples.diffuse, glossy, samples.radiance])
        return np.asarray(columns[which].T @ columns[which])

    @cached_property
    def _table(self) -> BarycentricInterpolator:
        """Products over log(mu - 1): a simplex asks for many."""
        nodes, mus = mu_nodes()
        return BarycentricInterpolator(
            nodes, np.array([self._products(mu, self.samples.judged) for mu in mus])
        )

    @cached_property
    def _fixed(self) -> Floats:
        return self._products(None, self.samples.judged)


def _mixed(share: float, products: Floats, channel: int) -> tuple[Floats, Floats, float]:
    """Normal equations (k, k) and (k,) of a channel's light at a share of Ks, and the channel's squared radiance."""
    k = (len(products) - 3) // 2
    diffuse, glossy, seen = slice(0, k), slice(k, 2 * k), 2 * k + channel
    cross = products[diffuse, glossy]
    gram = (1 - share) ** 2 * products[diffuse, diffuse] + share**2 * products[glossy, glossy]
    gram = gram + share * (1 - share) * (cross + cross.T)
    pull = (1 - share) * products[diffuse, seen] + share * products[glossy, seen]
    return gram, pull, float(products[seen, seen])


def _solved(gram: Floats, pull: Floats) -> Floats:
    return np.asarray(np.linalg.solve(gram + _RIDGE * gram.trace() / len(gram) * np.eye(len(gram)), pull))
