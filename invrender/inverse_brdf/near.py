"""How near a single source is, from how its light turns and falls off across the object."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from invrender.brdf.fresnel import MU_RANGE
from invrender.brdf.microfacet import SIGMA_RANGE
from invrender.estimate.noise import fit_noise
from invrender.inverse_brdf.fit import TableFit, fit_table
from invrender.inverse_brdf.samples import LitSamples, Source, lit_fields, lit_samples
from invrender.inverse_brdf.table import BRDFTable, fitting_bins, measure_table
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]

# Samples that determine the distance; it is one number, and more would only take longer.
_SAMPLES = 10_000
# A source nearer than so many of the object's radii is not looked for; the search begins at so many.
_NEAREST, _FIRST = 2.0, 40.0
# A source counts as near where this much of chi-square stays at most, and its closeness is so many deviations from 0.
_STAYS, _CLEARLY = 2 / 3, 5.0
_PASSES = 2


@dataclass(frozen=True, eq=False)
class Measured:
    """A table, its fit, and the source that it was measured under.

    closeness : 1/m, inverse distance of the source from the object's centre, 0 where it counts as far; std : of it, 0
    where it is not fitted. far_chi2 : of the fit to the table under a source that is far.
    """

    table: BRDFTable
    fit: TableFit
    closeness: float
    closeness_std: float
    far_chi2: float

    @property
    def distance(self) -> tuple[float, float] | None:
        """Of the source from the object's centre and its standard deviation, metres; None where it counts as far."""
        if self.closeness == 0:
            return None
        return 1 / self.closeness, self.closeness_std / self.closeness**2


def measure_under(fields: Sequence[LightField], sources: Sequence[Source], centre: Floats) -> Measured:
    """The table of photographs (one LightField and one source each), and the parametric BRDF fitted to it.

    Its bins are chosen by the number of samples and by the lobe's width in a first, small table.
    centre : (3,) of the object, where irradiances are stated. The sources count as far unless samples say clearly that
    they are all at one finite distance. ValueError as of `measure_table` and `fit_table`.
    """
    lit = lit_fields(fields, sources, centre)
    samples = lit_samples(lit, sources, centre)
    first = fit_table(measure_table(samples)).parameters
    shape = fitting_bins(samples.angles, first[7])
    table = measure_table(samples, shape)
    fit = fit_table(table, first)
    far = Measured(table, fit, 0.0, 0.0, fit.chi2)
    closeness, std = _closeness(lit, sources, centre, fit)
    if closeness < _CLEARLY * std:
        return far
    # What a source that is far would light may be dark.
    lit = lit_fields(lit, sources, centre, closeness)
    table = measure_table(lit_samples(lit, sources, centre, closeness), shape)
    near = Measured(table, fit_table(table, fit.parameters), closeness, std, fit.chi2)
    return near if near.fit.chi2 < _STAYS * fit.chi2 else far


def _closeness(
    lit: Sequence[LightField], sources: Sequence[Source], centre: Floats, fit: TableFit
) -> tuple[float, float]:
    """The closeness that fits the samples best together with mu, sigma, Kd and Ks, and its standard deviation."""
    share = max(1, sum(map(len, lit)) // _SAMPLES)
    fields = [field.where(np.arange(len(field)) % share == 0) for field in lit]
    radius = max(
        float(np.linalg.norm(field.positions - centre, axis=1).max()) for field in fields if len(field)
    )
    samples = lit_samples(fields, sources, centre)
    weights = np.sqrt(_trust(samples, _predicted(samples, *fit.parameters[6:])))

    def residual(x: Floats) -> Floats:
        samples = lit_samples(fields, sources, centre, x[2])
        return np.asarray((weights * (samples.radiance - _predicted(samples, x[0], x[1], weights))).ravel())

    low = np.array([MU_RANGE[0], SIGMA_RANGE[0], 0.0])
    high = np.array([MU_RANGE[1], SIGMA_RANGE[1], 1 / (_NEAREST * radius)])
    x = np.clip([*fit.parameters[6:], 1 / (_FIRST * radius)], low + 1e-6, high - 1e-6)
    for _ in range(_PASSES):
        found = least_squares(residual, x, bounds=(low, high), x_scale="jac")
        x = found.x
        near = lit_samples(fields, sources, centre, x[2])
        weights = np.sqrt(_trust(near, _predicted(near, x[0], x[1], weights)))
    variance = 2 * found.cost / max(found.fun.size - len(x), 1)
    covariance = np.linalg.pinv(found.jac.T @ found.jac) * max(variance, 1.0)
    return float(x[2]), float(np.sqrt(covariance[2, 2]))


def _predicted(samples: LitSamples, mu: float, sigma: float, weights: Floats | None = None) -> Floats:
    """Radiance (n, 3) of the samples by the Kd and Ks that fit them best, given mu and sigma."""
    columns = np.stack([samples.received, samples.lobes(mu, sigma)], axis=1)
    result = np.empty_like(samples.radiance)
    for channel in range(3):
        rows = columns * samples.irradiance[:, channel, None]
        weight = np.sqrt(samples.weight) if weights is None else weights[:, channel]
        best = np.linalg.lstsq(rows * weight[:, None], samples.radiance[:, channel] * weight, rcond=None)[0]
        result[:, channel] = rows @ best
    return result


def _trust(samples: LitSamples, predicted: Floats) -> Floats:
    """Inverse variances (n, 3) of the samples."""
    noise = fit_noise([predicted], [samples.radiance - predicted])
    return np.asarray(samples.weight[:, None] / noise.variance(predicted))
