"""A BRDF measured value by value: each pixel of a curved object under a single source is one sample of it.

After the image-based measurement of [Marschner et al. 1999], which RH01's section 6 takes as reference. Values are
gathered in bins of half and difference angles that start at

    theta_h = pi/2 (i / n_h)^2,   theta_d = pi/2 j / n_d,   phi_d = pi k / n_p

(narrow where highlights are). A bin's value is what was reflected over what was received, summed over its samples.
The table keeps the samples: a lobe is compared with its own mean over them, so that the width of bins costs nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from invrender.estimate.noise import fit_noise
from invrender.inverse_brdf.halfangles import HalfAngles, cosines, half_angles
from invrender.inverse_brdf.samples import LitSamples
from recon.harmonics.basis import finite

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

# Bins of theta_h, theta_d and phi_d of a small table.
SMALL = (24, 18, 12)
# A bin of theta_h at sigma is so many times narrower than sigma, as far as there are no more bins than that.
_IN_SIGMA, _MOST_ROWS = 4.0, 90
# Of theta_d and phi_d there are up to so many times the bins of a small table, if so many samples remain for each: some
# five then share one that holds any.
_TIMES, _SAMPLES_PER_BIN = (0.75, 2.0), 2.0
# The highlight is where theta_h is below so many sigma; of its samples this share at either end makes no gap.
_SHINES, _TRIMMED = 1.0, 0.01


@dataclass(frozen=True, eq=False)
class BRDFTable:
    """Values of the bins (n_h, n_d, n_p), each array of that shape, 3 channels last where there are any.

    values : 1/sr; 0 where a bin holds nothing. std : of the values, from what samples of a bin scatter about them.
    counts : samples in each bin. measured : counts > 0. filled : measured, or taken from the bin in which light and
    viewer are exchanged. possible : bins in whose centre both are above the surface.
    cos_incident, cos_exitant, theta_h : means over the samples that a bin's value comes from, of cos theta_o the
    harmonic one. samples : that it was measured from; bins : (n,), the flat index of each one's bin.
    """

    values: Floats
    std: Floats
    counts: Ints
    filled: Bools
    possible: Bools
    cos_incident: Floats
    cos_exitant: Floats
    theta_h: Floats
    samples: LitSamples
    bins: Ints

    @property
    def measured(self) -> Bools:
        return self.counts > 0

    def coverage(self, of: Bools) -> float:
        """The share of the possible bins that are marked."""
        return float((of & self.possible).sum() / self.possible.sum())

    def bin_means(self, values: Floats) -> Floats:
        """What values (n, 3) of the samples, radiance, amount to in each bin, (n_h, n_d, n_p, 3); 0 without samples."""
        weight, received = self.samples.weight[:, None], self.samples.received[:, None]
        size = self.counts.size
        received = totals(self.bins, weight * received * self.samples.irradiance, size)
        return _over(totals(self.bins, weight * values, size), received).reshape(*self.counts.shape, 3)

    def lobes(self, mu: float | None, sigma: float) -> tuple[Floats, Floats]:
        """What Ks multiplies in each bin, (n_h, n_d, n_p, 3), means over its samples, and their own radiance (n, 3)."""
        own = self.samples.lobes(mu, sigma)[:, None] * self.samples.irradiance
        return self.bin_means(own), own

    def std_beyond(self, radiance: Floats) -> Floats:
        """The values' standard deviations if part of the samples' radiance (n, 3) is known and no noise.

        Samples then scatter about the rest's mean: what varies within a bin as that part does is not scatter.
        """
        left = self.samples.radiance - radiance
        samples, size = self.samples, self.counts.size
        received = samples.received[:, None] * samples.irradiance
        counts = self.counts.ravel()[self.bins]
        shared = counts > 1
        mean = self.bin_means(left).reshape(size, 3)[self.bins] * received
        # A value was fitted to its own samples: of n of them 1 / n is missing from their scatter.
        scatter = (left - mean)[shared] / np.sqrt(1 - 1 / counts[shared])[:, None]
        predicted = self.values.reshape(size, 3)[self.bins] * received
        noise = fit_noise([predicted[shared]], [scatter])
        weight = samples.weight[:, None]
        variance = totals(self.bins, weight**2 * noise.variance(predicted), size)
        norm = totals(self.bins, weight * received, size)
        return np.sqrt(_over(variance, norm**2)).reshape(*self.counts.shape, 3)

    def lookup(self, normals: Floats, incident: Floats, exitant: Floats) -> tuple[Floats, Bools]:
        """Values (n, 3) of the bins of pairs of directions (n, 3), and whether they are filled (n,)."""
        place = np.unravel_index(
            bin_of(half_angles(normals, incident, exitant), self.counts.shape), self.counts.shape
        )
        return self.values[place], self.filled[place]


def bin_centres(shape: tuple[int, ...]) -> HalfAngles:
    """Angles of the bins' centres, each (n_h, n_d, n_p)."""
    h, d, p = np.meshgrid(*((np.arange(n) + 0.5) / n for n in shape), indexing="ij")
    return HalfAngles(np.pi / 2 * h**2, np.pi / 2 * d, np.pi * p)


def bin_of(angles: HalfAngles, shape: tuple[int, ...]) -> Ints:
    """Flat index (n,) of the bin that angles (n,) lie in."""
    shares = (np.sqrt(angles.theta_h * (2 / np.pi)), angles.theta_d * (2 / np.pi), angles.phi_d / np.pi)
    places = [np.clip((share * n).astype(int), 0, n - 1) for share, n in zip(shares, shape, strict=True)]
    return np.asarray(np.ravel_multi_index(tuple(places), shape))


def fitting_bins(angles: HalfAngles, sigma: float) -> tuple[int, int, int]:
    """Numbers of bins of theta_h, theta_d and phi_d for samples at these angles (n,) of a lobe of width sigma, radians.

    Bins of theta_h are as narrow as the lobe asks for, those of the others as the samples allow. Each photograph shows
    the highlight at nearly one theta_d: no bin is narrower than the widest gap between any.
    """
    # A bin that starts at theta_h is sqrt(2 pi theta_h) / n_h wide.
    rows = int(np.clip(np.ceil(_IN_SIGMA * np.sqrt(2 * np.pi / sigma)), SMALL[0], _MOST_ROWS))
    times = np.clip(np.sqrt(len(angles.theta_h) / (_SAMPLES_PER_BIN * rows * SMALL[1] * SMALL[2])), *_TIMES)
    shown = np.sort(angles.theta_d[angles.theta_h < _SHINES * sigma])
    shown = shown[int(_TRIMMED * len(shown)) : int(np.ceil((1 - _TRIMMED) * len(shown)))]
    gap = max(float(np.diff(shown).max(initial=0)), 1e-6)
    return rows, max(min(round(times * SMALL[1]), int(np.pi / 2 / gap)), 1), round(times * SMALL[2])


def measure_table(samples: LitSamples, shape: tuple[int, int, int] = SMALL) -> BRDFTable:
    """The table of samples, each photograph under one source and nothing else.

    shape : numbers of bins. Raises ValueError for an irradiance that isn't > 0, for radiance
    that isn't finite, and if no two samples share a bin.
    """
    wrong = ~(np.isfinite(samples.irradiance) & (samples.irradiance > 0)).all(axis=1)
    if wrong.any():
        irradiance = samples.irradiance[wrong][0].tolist()
        raise ValueError(f"the source's irradiance is {irradiance}; every channel must be > 0")
    finite(samples.radiance, "radiance")
    bins, size = bin_of(samples.angles, shape), int(np.prod(shape))
    counts = np.bincount(bins, minlength=size)
    if counts.max() < 2:
        raise ValueError(f"no bin of the table {shape} holds two samples; take coarser bins or more samples")
    weight = samples.weight[:, None]
    mean = _over(totals(bins, weight * samples.geometry, size), totals(bins, weight, size)).reshape(*shape, 3)
    empty = np.zeros((*shape, 3))
    table = BRDFTable(
        values=empty,
        std=empty,
        counts=counts.reshape(shape),
        filled=(counts > 0).reshape(shape),
        possible=np.min(cosines(bin_centres(shape)), axis=0) > 0,
        cos_incident=mean[..., 0],
        cos_exitant=_over(np.ones(shape), mean[..., 1]),
        theta_h=mean[..., 2],
        samples=samples,
        bins=bins,
    )
    table = replace(table, values=table.bin_means(samples.radiance))
    return _filled_by_reciprocity(replace(table, std=table.std_beyond(np.zeros_like(samples.radiance))))


def totals(index: Ints, values: Floats, size: int) -> Floats:
    """Sums (size, k) of values (n, k) by their index (n,)."""
    return np.stack([np.bincount(index, channel, minlength=size) for channel in values.T], axis=1)


def _filled_by_reciprocity(table: BRDFTable) -> BRDFTable:
    """The table with empty bins taken from those in which light and viewer are exchanged, phi_d + pi or pi - phi_d."""
    taken = ~table.measured & table.measured[:, :, ::-1]

    def fill(here: Floats, there: Floats) -> Floats:
        mask = taken.reshape(taken.shape + (1,) * (here.ndim - 3))
        return np.where(mask, there[:, :, ::-1], here)

    return replace(
        table,
        values=fill(table.values, table.values),
        std=fill(table.std, table.std),
        filled=table.filled | taken,
        cos_incident=fill(table.cos_incident, table.cos_exitant),
        cos_exitant=fill(table.cos_exitant, table.cos_incident),
        theta_h=fill(table.theta_h, table.theta_h),
    )


def _over(above: Floats, below: Floats) -> Floats:
    """The quotient; 0 where nothing was counted."""
    return np.divide(above, below, out=np.zeros_like(above), where=below > 0)
