"""RH01's parametric BRDF fitted to a measured table: the right column of its Fig. 7."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import OptimizeResult, least_squares, nnls

from invrender.brdf.fresnel import MU_RANGE
from invrender.brdf.microfacet import SIGMA_RANGE, Microfacet
from invrender.inverse_brdf.covariance import larger_covariance
from invrender.inverse_brdf.table import BRDFTable

Floats = NDArray[np.float64]

_COARSE_SIGMAS = np.geomspace(0.03, 0.5, 12)
_COARSE_MUS = (1.2, 1.5, 2.0, 3.0)
# Kd and Ks of three channels, mu, sigma.
_UNKNOWNS = 8
# A search that begins on a bound stays there.
_INSIDE = 1e-9
# Share of mu or sigma that derivatives are taken over.
_STEP = 1e-5


@dataclass(frozen=True, eq=False)
class TableFit:
    """brdf : the best parameters. covariance : (8, 8), of Kd red to blue, Ks red to blue, mu, sigma.

    misfit : relative RMS of what is left of the radiance under unit irradiance. chi2 : per degree of freedom; standard
    deviations are larger by its root where it exceeds 1.
    """

    brdf: Microfacet
    covariance: Floats
    misfit: float
    chi2: float

    @property
    def parameters(self) -> Floats:
        """Kd and Ks per channel, mu, sigma, (8,)."""
        return np.array([*self.brdf.kd, *self.brdf.ks, self.brdf.mu, self.brdf.sigma], float)

    @property
    def std(self) -> Floats:
        """Standard deviations (8,)."""
        return np.sqrt(np.diag(self.covariance))


def fit_table(table: BRDFTable, start: Floats | None = None) -> TableFit:
    """Kd, Ks >= 0 per channel, mu and sigma by weighted least squares on the measured bins.

    The model's value in a bin is its mean over the bin's samples, so that nothing hangs on the bins' width; nor does
    their noise, since of the samples' scatter what the model varies by within a bin is taken off. Errors are the larger
    of what the bins' noise implies and of a jackknife over bins of theta_d, which shows what correlated misfits
    do. start : (8,), parameters as of `TableFit` to begin from, which saves the coarse search. Raises ValueError for a
    table of fewer measured bins than unknowns.
    """
    x = _fit(table, start).x
    _, lobes = table.lobes(x[6], x[7])
    table = replace(table, std=table.std_beyond(x[3:6] * lobes))
    found = _fit(table, x)
    x, jac = found.x, found.jac
    chi2 = float(2 * found.cost / (len(jac) - _UNKNOWNS))
    of_noise = np.linalg.pinv(jac.T @ jac) * max(chi2, 1.0)
    covariance = larger_covariance([of_noise, _jackknife(table, jac, found.fun)])
    brdf = Microfacet(x[:3], x[3:6], float(x[6]), float(x[7]))
    return TableFit(brdf, covariance, table_misfit(table, brdf), chi2)


def _jackknife(table: BRDFTable, jac: Floats, left: Floats) -> Floats:
    """Covariance (8, 8) from a step of Gauss-Newton without one bin of theta_d, for each of these.

    jac : (3 n, 8), left : (3 n,), of the fit to all n measured bins.
    """
    column = np.repeat(np.nonzero(table.measured)[1], 3)
    outliers = []
    for held in np.unique(column):
        rows, rest = jac[column != held], left[column != held]
        outliers.append(-np.linalg.pinv(rows.T @ rows) @ (rows.T @ rest))
    apart = np.array(outliers) - np.mean(outliers, axis=0)
    return np.asarray((len(outliers) - 1) / len(outliers) * apart.T @ apart)


def _fit(table: BRDFTable, start: Floats | None = None) -> OptimizeResult:
    """The eight parameters that fit the measured bins best. start : (8,), saves the coarse search."""
    used = table.measured
    if 3 * int(used.sum()) <= _UNKNOWNS:
        raise ValueError(
            f"the table has {int(used.sum())} measured bins; {_UNKNOWNS} parameters can't be fitted to so few"
        )
    values, std = table.values[used], table.std[used]
    low = np.array([0.0] * 6 + [MU_RANGE[0], SIGMA_RANGE[0]])
    high = np.array([np.inf] * 6 + [MU_RANGE[1], SIGMA_RANGE[1]])

    def residual(x: Floats) -> Floats:
        model = x[:3] + x[3:6] * table.lobes(x[6], x[7])[0][used]
        return np.asarray(((model - values) / std).ravel())

    def jacobian(x: Floats) -> Floats:
        lobes = table.lobes(x[6], x[7])[0][used]
        result = np.zeros((len(values), 3, _UNKNOWNS))
        for channel in range(3):
            result[:, channel, channel], result[:, channel, 3 + channel] = 1, lobes[:, channel]
        for k in (6, 7):
            # Forwards, as far as rounding asks for; at the end of a range backwards.
            step = np.zeros(_UNKNOWNS)
            step[k] = _STEP * x[k] * (1 if x[k] * (1 + _STEP) < high[k] else -1)
            moved = table.lobes(*(x + step)[6:])[0][used]
            result[:, :, k] = x[3:6] * (moved - lobes) / step[k]
        return np.asarray((result / std[:, :, None]).reshape(-1, _UNKNOWNS))

    def linear(mu: float, sigma: float) -> tuple[float, Floats]:
        """Cost and all parameters, Kd and Ks being the best for given mu and sigma."""
        one = np.ones(len(values))
        pairs = np.array(
            [
                nnls(np.column_stack([one / s, lobes / s]), v / s)[0]
                for lobes, v, s in zip(table.lobes(mu, sigma)[0][used].T, values.T, std.T, strict=True)
            ]
        )
        x = np.concatenate([pairs[:, 0], pairs[:, 1], [mu, sigma]])
        return float(np.sum(residual(x) ** 2)), x

    if start is None:
        starts = [linear(mu, sigma) for mu, sigma in product(_COARSE_MUS, _COARSE_SIGMAS)]
        _, start = min(starts, key=lambda entry: entry[0])
    inside = np.clip(start, low + _INSIDE, high - _INSIDE)
    return least_squares(residual, inside, jacobian, bounds=(low, high), x_scale="jac")


def table_misfit(table: BRDFTable, brdf: Microfacet) -> float:
    """Relative RMS difference of a BRDF from the measured bins, in radiance under unit irradiance, samples alike."""
    used = table.measured
    cos = table.cos_incident[used]
    model = np.broadcast_to(brdf.kd, (int(used.sum()), 3))
    if brdf.sigma is not None:
        model = model + brdf.ks * table.lobes(brdf.mu, brdf.sigma)[0][used]
    weight = table.counts[used] * cos**2
    left = weight @ (model - table.values[used]) ** 2
    return float(np.sqrt(left.sum() / (weight @ table.values[used] ** 2).sum()))
