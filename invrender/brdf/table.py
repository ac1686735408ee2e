"""A BRDF measured value by value: each pixel of a curved object under a single source is one sample of it.

After the image-based measurement of [Marschner et al. 1999], which RH01's section 6 takes as reference. Values are
gathered in bins of half and difference angles that start at

    theta_h = pi/2 (i / n_h)^2,   theta_d = pi/2 j / n_d,   phi_d = pi k / n_p

(narrow where highlights are). A bin's value is what was reflected over what was received, summed over its samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.halfangles import HalfAngles, cosines, half_angles
from invrender.solve.noise import fit_noise
from recon.harmonics import finite
from recon.lightfield import LightField, off_terminators

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

BINS = (24, 18, 12)
# Light more grazing than this share of the source's irradiance tells little and divides by almost nothing.
_MIN_COS_INCIDENT = 0.05


@dataclass(frozen=True, eq=False)
class BRDFTable:
    """Values of the bins (n_h, n_d, n_p), each array of that shape, 3 channels last where there are any.

    values : 1/sr; 0 where a bin holds nothing. std : of the values, from what samples of a bin scatter about them.
    counts : samples in each bin. measured : counts > 0. filled : measured, or taken from the bin in which light and
    viewer are exchanged. possible : bins in whose centre both are above the surface.
    cos_incident, cos_exitant, theta_h : means over the samples that a bin's value comes from, of cos theta_o the
    harmonic one. theta_h_spread : standard deviation of their theta_h, within pixels
    as well.
    """

    values: Floats
    std: Floats
    counts: Ints
    filled: Bools
    possible: Bools
    cos_incident: Floats
    cos_exitant: Floats
    theta_h: Floats
    theta_h_spread: Floats

    @property
    def measured(self) -> Bools:
        return self.counts > 0

    def coverage(self, of: Bools) -> float:
        """The share of the possible bins that are marked."""
        return float((of & self.possible).sum() / self.possible.sum())

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


def measure_table(
    fields: Sequence[LightField],
    directions: Sequence[Floats],
    irradiances: Sequence[Floats],
    shape: tuple[int, int, int] = BINS,
) -> BRDFTable:
    """The table of photographs' samples, each photograph under one source and nothing else.

    directions, irradiances : (3,) per photograph, unit, and on a plane that faces the source, > 0. Raises ValueError
    for an irradiance that isn't, and if no sample is lit.
    """
    for irradiance in irradiances:
        if not (np.isfinite(irradiance) & (irradiance > 0)).all():
            raise ValueError(f"the source's irradiance is {irradiance.tolist()}; every channel must be > 0")
    parts = [
        _lit_samples(field, direction, irradiance)
        for field, direction, irradiance in zip(fields, directions, irradiances, strict=True)
    ]
    angles = HalfAngles(*(np.concatenate([part.angles[k] for part in parts]) for k in range(3)))
    radiance, received, geometry = (np.concatenate([part[k] for part in parts]) for k in (1, 2, 3))
    weight = np.concatenate([part.weight for part in parts])[:, None]
    if not len(weight):
        raise ValueError(
            "no sample is lit by its source: directions point from the object to the light; check them"
        )
    finite(radiance, "radiance")
    bins, size = bin_of(angles, shape), int(np.prod(shape))

    def total(values: Floats) -> Floats:
        return np.stack([np.bincount(bins, channel, minlength=size) for channel in values.T], axis=1)

    counts = np.bincount(bins, minlength=size)
    norm = total(weight * received)
    values = _over(total(weight * radiance), norm)
    predicted = values[bins] * received
    # A value was fitted to its own samples: of n of them 1 / n is missing from their scatter.
    shared = counts[bins] > 1
    if not shared.any():
        raise ValueError(f"no bin of the table {shape} holds two samples; take coarser bins or more samples")
    scatter = (radiance - predicted)[shared] / np.sqrt(1 - 1 / counts[bins][shared])[:, None]
    noise = fit_noise([predicted[shared]], [scatter])
    variance = total(weight**2 * noise.variance(predicted))
    mean = _over(total(weight * geometry), total(weight)).reshape(*shape, 4)
    return _filled_by_reciprocity(
        BRDFTable(
            values=values.reshape(*shape, 3),
            std=np.sqrt(_over(variance, norm**2)).reshape(*shape, 3),
            counts=counts.reshape(shape),
            filled=(counts > 0).reshape(shape),
            possible=np.min(cosines(bin_centres(shape)), axis=0) > 0,
            cos_incident=mean[..., 0],
            cos_exitant=_over(np.ones(shape), mean[..., 1]),
            theta_h=mean[..., 2],
            theta_h_spread=np.sqrt(np.maximum(mean[..., 3] - mean[..., 2] ** 2, 0)),
        )
    )


class _Samples(NamedTuple):
    """The lit samples of one photograph. received : (n, 3), irradiance of the surface.

    geometry : (n, 4), means over each pixel of cos theta_i, 1 / cos theta_o, theta_h and its square.
    """

    angles: HalfAngles
    radiance: Floats
    received: Floats
    geometry: Floats
    weight: Floats


def _lit_samples(field: LightField, direction: Floats, irradiance: Floats) -> _Samples:
    lit = np.asarray(field.mean_over_rays(field.normals @ direction)) > _MIN_COS_INCIDENT
    kept = off_terminators(field.where(lit & (field.weight > 0)), direction[None])
    angles = half_angles(kept.normals, np.broadcast_to(direction, kept.normals.shape), kept.views)
    cos_exitant = (kept.normals * kept.views).sum(axis=1)
    # Across a grazing pixel light and view turn; the surface receives the mean, and radiance goes with 1 / cos theta_o.
    rays = np.column_stack([kept.normals @ direction, 1 / cos_exitant, angles.theta_h, angles.theta_h**2])
    geometry = np.asarray(kept.mean_over_rays(rays))
    mean_angles = HalfAngles(*(np.asarray(kept.mean_over_rays(angle)) for angle in angles))
    return _Samples(mean_angles, kept.radiance, geometry[:, :1] * irradiance, geometry, kept.weight)


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
        theta_h_spread=fill(table.theta_h_spread, table.theta_h_spread),
    )


def _over(above: Floats, below: Floats) -> Floats:
    """The quotient; 0 where nothing was counted."""
    return np.divide(above, below, out=np.zeros_like(above), where=below > 0)
