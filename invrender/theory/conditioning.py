"""How well posed inverse problems are: degree by degree [R02, sec. 2.4.2; RH01, sec. 5.1], and for actual photographs.

In theory every degree is a problem of its own, and its conditioning is a gain. Photographs show some normals and views
only, which mixes degrees: there the operator is a matrix, and its information against a prior shows what it determines.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capture.arrays import frozen_array
from invrender.theory.convolution import normalisation
from invrender.theory.explicit import LightFieldFactors
from recon.harmonics.basis import degree_of, degrees, finite

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

# Gains below this share of the largest are rounding.
_ROUNDING = 1e-12


@dataclass(frozen=True, eq=False)
class Conditioning:
    """How noise passes through an inverse problem, per degree.

    gains : (l_max + 1,), >= 0; noise of standard deviation s in the light field leaves s / gain in each unknown.
    """

    gains: Floats

    def __post_init__(self) -> None:
        object.__setattr__(self, "gains", frozen_array(self.gains))
        if self.gains.ndim != 1 or not len(self.gains):
            raise ValueError(f"gains are {self.gains.shape}; there must be one per degree, (l_max + 1,)")
        if not (np.isfinite(self.gains) & (self.gains >= 0)).all():
            raise ValueError(f"gains are {self.gains}; they must be finite and >= 0")

    @property
    def well_posed(self) -> Bools:
        """Whether a degree comes through at all, (l_max + 1,); 1e-12 of the best is rounding."""
        return self.gains > _ROUNDING * self.gains.max()

    @property
    def condition(self) -> Floats:
        """The largest gain over each degree's, (l_max + 1,), >= 1; inf where the problem is ill-posed."""
        return np.divide(
            self.gains.max(), self.gains, out=np.full(len(self.gains), np.inf), where=self.well_posed
        )

    def determined(self, noise_to_signal: float) -> Bools:
        """Whether an unknown of each degree stands out of its noise, (l_max + 1,).

        noise_to_signal : > 0, the noise over the signal that an unknown of that size leaves in the best degree's.
        """
        if not 0 < noise_to_signal < np.inf:
            raise ValueError(f"noise_to_signal is {noise_to_signal}; it must be finite and > 0")
        return self.condition * noise_to_signal < 1

    def highest_degree(self, noise_to_signal: float) -> int | None:
        """The degree up to which all are `determined`; None if not even degree 0 is."""
        lost = np.flatnonzero(~self.determined(noise_to_signal))
        last = int(lost[0]) - 1 if len(lost) else len(self.gains) - 1
        return last if last >= 0 else None


def inverse_lighting(rho: ArrayLike) -> Conditioning:
    """Of lighting L_lm from B_lmpq where the BRDF is known: Lambda_l sqrt(sum over p, q of rho_lpq^2) [R02, eq. 2.65].

    rho : (l_max + 1, p_max + 1, min(l_max, p_max) + 1), q >= 0, and q < 0 alike.
    """
    return Conditioning(_lighting_gains(_finite(rho, 3, "rho")))


def inverse_filter(transfer: ArrayLike) -> Conditioning:
    """Of lighting L_lm from B_lm where the BRDF depends on one angle: |Lambda_l rho_l| [R02, eq. 2.62].

    transfer : (l_max + 1,), Lambda_l rho_l.
    """
    return Conditioning(np.abs(_finite(transfer, 1, "transfer")))


def inverse_brdf(lighting: ArrayLike) -> Conditioning:
    """Of rho_lpq from B_lmpq where the lighting is known: Lambda_l sqrt(sum over m of |L_lm|^2) [R02, eq. 2.64].

    lighting : ((l_max + 1)^2,), of complex harmonics or real ones. Of q > 0 the gain is sqrt(2) larger, q and -q being
    one unknown.
    """
    power = np.abs(np.asarray(lighting)) ** 2
    l_max = degree_of(len(_finite(power, 1, "lighting")))
    return Conditioning(normalisation(l_max) * np.sqrt(np.bincount(degrees(l_max), power)))


def factorization(factors: LightFieldFactors, noise_std: float) -> Conditioning:
    """Of lighting from B~_lmpq where the BRDF is unknown too [R02, eq. 2.68]; never better than `inverse_lighting`.

    noise_std : that of B~ with which `factors` were found, > 0, the same for all. Where the lighting isn't determined
    the gain is 0; degree 0, which the gauge fixes, has that of inverse lighting.
    """
    if not 0 < noise_std < np.inf:
        raise ValueError(f"noise_std is {noise_std}; it must be finite and > 0")
    l = degrees(len(factors.rho) - 1)
    variance = np.bincount(l, factors.lighting_std**2) / np.bincount(l)
    # NaN where the lighting isn't determined.
    gains = np.sqrt(np.divide(noise_std**2, variance, out=np.zeros(len(variance)), where=variance > 0))
    gains[0] = _lighting_gains(factors.rho[:1])[0]
    return Conditioning(gains)


def _lighting_gains(rho: Floats) -> Floats:
    both_signs = np.where(np.arange(rho.shape[2]) > 0, 2, 1)
    return normalisation(len(rho) - 1) * np.sqrt((both_signs * rho**2).sum(axis=(1, 2)))


@dataclass(frozen=True, eq=False)
class Information:
    """What samples say of k unknowns that they depend on linearly; that of independent samples adds up.

    matrix : (k, k), A^T W A of the samples' rows A (n, k) and inverse variances W.
    """

    matrix: Floats

    def __post_init__(self) -> None:
        object.__setattr__(self, "matrix", frozen_array(self.matrix))
        if self.matrix.ndim != 2 or self.matrix.shape[0] != self.matrix.shape[1]:
            raise ValueError(f"information is {self.matrix.shape}; it must be (k, k)")
        finite(self.matrix, "information")

    def __add__(self, other: Information) -> Information:
        if self.matrix.shape != other.matrix.shape:
            raise ValueError(
                f"information of {len(self.matrix)} unknowns can't be added to that of {len(other.matrix)};"
                " they must be the same"
            )
        return Information(self.matrix + other.matrix)

    def against(self, prior_std: ArrayLike) -> Determination:
        """What the samples determine of unknowns that had these standard deviations before, (k,) or one for all."""
        prior = _deviations(prior_std, len(self.matrix), "prior_std")
        # In units of the prior, where without any data each direction has variance 1.
        squares, directions = np.linalg.eigh(prior[:, None] * self.matrix * prior)
        squares = np.maximum(squares[::-1], 0)
        left = (directions[:, ::-1] ** 2 / (1 + squares)).sum(axis=1)
        return Determination(np.sqrt(squares), prior * np.sqrt(left), prior)


def information(rows: ArrayLike, noise_std: ArrayLike) -> Information:
    """Information of samples, one photograph's say, whose values are rows (n, k) times the unknowns, plus noise.

    noise_std : (n,), or one for all. Raises ValueError for numbers that aren't finite and noise that isn't > 0.
    """
    rows = _finite(rows, 2, "rows")
    whitened = rows / _deviations(noise_std, len(rows), "noise_std")[:, None]
    return Information(whitened.T @ whitened)


@dataclass(frozen=True, eq=False)
class Determination:
    """How much better than before k unknowns are known.

    singular_values : (k,), falling, of the operator in units of noise and prior; a combination of unknowns with value s
        keeps 1 / (1 + s^2) of its prior variance. Those below 1e-8 of the first are rounding.
    posterior_std, prior_std : (k,).
    """

    singular_values: Floats
    posterior_std: Floats
    prior_std: Floats

    @property
    def effective_rank(self) -> float:
        """How many combinations of unknowns the samples determine: the sum of s^2 / (1 + s^2)."""
        squares = self.singular_values**2
        return float(np.sum(squares / (1 + squares)))

    @property
    def rank_beyond_prior(self) -> int:
        """How many combinations of unknowns the samples know better than the prior does: those with s > 1."""
        return int(np.sum(self.singular_values > 1))

    @property
    def shares(self) -> Floats:
        """How much of what is known of each unknown comes from the samples, (k,), 0 to 1; they add up to the rank."""
        return 1 - (self.posterior_std / self.prior_std) ** 2

    def share_per_degree(self) -> Floats:
        """Mean share of each degree, (l_max + 1,), where the unknowns are harmonic coefficients, (l_max + 1)^2."""
        l = degrees(degree_of(len(self.prior_std)))
        return np.bincount(l, self.shares) / np.bincount(l)


def _finite(values: ArrayLike, dimensions: int, name: str) -> Floats:
    values = np.asarray(values, float)
    if values.ndim != dimensions:
        raise ValueError(f"{name} has {values.ndim} axes; it must have {dimensions}")
    return finite(values, name)


def _deviations(values: ArrayLike, count: int, name: str) -> Floats:
    values = np.asarray(values, float)
    if values.shape not in ((), (count,)):
        raise ValueError(f"{name} is {values.shape}; it must be one number or ({count},)")
    if not (np.isfinite(values) & (values > 0)).all():
        raise ValueError(
            f"{name} holds {values.min():.3g} to {values.max():.3g}; standard deviations are finite and > 0"
        )
    return np.broadcast_to(values, count)
