"""RH01's parametric BRDF fitted to a measured table: the right column of its Fig. 7."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, nnls

from invrender.brdf.covariance import larger_covariance
from invrender.brdf.table import BRDFTable
from invrender.model.fresnel import MU_RANGE, normalised_fresnel
from invrender.model.microfacet import SIGMA_RANGE, Microfacet
from invrender.theory.specialcases import lobe

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

_COARSE_SIGMAS = np.geomspace(0.03, 0.5, 12)
_COARSE_MUS = (1.2, 1.5, 2.0, 3.0)
# Kd and Ks of three channels, mu, sigma.
_UNKNOWNS = 8
# A search that begins on a bound stays there.
_INSIDE = 1e-9


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


def bin_lobes(table: BRDFTable, used: Bools, mu: float | None, sigma: float) -> Floats:
    """What Ks multiplies in each used bin, F(mu, theta_o) S(theta_h) / (4 cos theta_i cos theta_o), (n,).

    [RH01, section 5.2]. S is the mean of two points as far apart as the bin's samples are, so that it is right to
    fourth order in the bin's width.
    """
    theta, spread = table.theta_h[used], table.theta_h_spread[used]
    highlight = (lobe(theta + spread, sigma) + lobe(theta - spread, sigma)) / 2
    cos_exitant = table.cos_exitant[used]
    return np.asarray(
        normalised_fresnel(mu, cos_exitant) * highlight / (4 * table.cos_incident[used] * cos_exitant)
    )


def fit_table(table: BRDFTable) -> TableFit:
    """Kd, Ks >= 0 per channel, mu and sigma by weighted least squares on the measured bins.

    Its errors are the larger of what the bins' noise implies and of a jackknife over bins of theta_d, which tells what
    misfits that hang together do. What the width of bins and pixels does to the highlight is corrected, and the
    correction counts as uncertain. Raises ValueError for a table of fewer measured bins than unknowns.
    """
    found, covariance, chi2 = _fit(table, table.measured)
    of_points, _, _ = _fit(
        replace(table, theta_h_spread=np.zeros_like(table.theta_h_spread)), table.measured, found
    )
    shift = found - of_points
    covariance = larger_covariance([covariance, _jackknife(table, found)])
    brdf = Microfacet(found[:3], found[3:6], float(found[6]), float(found[7]))
    return TableFit(brdf, covariance + np.outer(shift, shift), table_misfit(table, brdf), chi2)


def _jackknife(table: BRDFTable, start: Floats) -> Floats:
    """Covariance (8, 8) from fits that leave out one bin of theta_d each."""
    held = np.flatnonzero(table.measured.any(axis=(0, 2)))
    if len(held) < 2:
        return np.zeros((_UNKNOWNS, _UNKNOWNS))
    found = []
    for column in held:
        used = table.measured.copy()
        used[:, column] = False
        found.append(_fit(table, used, start)[0])
    strays = np.array(found) - np.mean(found, axis=0)
    return np.asarray((len(held) - 1) / len(held) * strays.T @ strays)


def _fit(table: BRDFTable, used: Bools, start: Floats | None = None) -> tuple[Floats, Floats, float]:
    """The eight parameters, their covariance from the bins' noise, and chi-square per degree of freedom.

    used : (n_h, n_d, n_p), which of the measured bins count. start : (8,), saves the coarse search.
    """
    if 3 * int(used.sum()) <= _UNKNOWNS:
        raise ValueError(
            f"the table has {int(used.sum())} measured bins; {_UNKNOWNS} parameters can't be fitted to so few"
        )
    values, std = table.values[used], table.std[used]

    def residual(x: Floats) -> Floats:
        model = x[:3] + x[3:6] * bin_lobes(table, used, x[6], x[7])[:, None]
        return np.asarray(((model - values) / std).ravel())

    def linear(mu: float, sigma: float) -> tuple[float, Floats]:
        """Cost and all parameters, Kd and Ks being the best for given mu and sigma."""
        columns = np.column_stack([np.ones(len(values)), bin_lobes(table, used, mu, sigma)])
        pairs = np.array([nnls(columns / s[:, None], v / s)[0] for v, s in zip(values.T, std.T, strict=True)])
        x = np.concatenate([pairs[:, 0], pairs[:, 1], [mu, sigma]])
        return float(np.sum(residual(x) ** 2)), x

    if start is None:
        starts = [linear(mu, sigma) for mu, sigma in product(_COARSE_MUS, _COARSE_SIGMAS)]
        _, start = min(starts, key=lambda entry: entry[0])
    low = np.array([0.0] * 6 + [MU_RANGE[0], SIGMA_RANGE[0]])
    high = np.array([np.inf] * 6 + [MU_RANGE[1], SIGMA_RANGE[1]])
    found = least_squares(
        residual, np.clip(start, low + _INSIDE, high - _INSIDE), bounds=(low, high), x_scale="jac"
    )
    chi2 = 2 * found.cost / (values.size - _UNKNOWNS)
    covariance = np.linalg.pinv(found.jac.T @ found.jac) * max(chi2, 1.0)
    return found.x, covariance, float(chi2)


def table_misfit(table: BRDFTable, brdf: Microfacet) -> float:
    """Relative RMS difference of a BRDF from the measured bins, in radiance under unit irradiance, samples alike."""
    used = table.measured
    cos = table.cos_incident[used]
    model = np.broadcast_to(brdf.kd, (int(used.sum()), 3))
    if brdf.sigma is not None:
        model = model + brdf.ks * bin_lobes(table, used, brdf.mu, brdf.sigma)[:, None]
    weight = table.counts[used] * cos**2
    left = weight @ (model - table.values[used]) ** 2
    return float(np.sqrt(left.sum() / (weight @ table.values[used] ** 2).sum()))
