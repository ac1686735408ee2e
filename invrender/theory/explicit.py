"""Lighting and BRDF from the coefficients of the reflected light field alone [R02, eq. 2.68; RH01, sec. 5.1].

Of a reciprocal BRDF, B~_lmpq = Lambda_l L_lm rho~_lpq [R02, eq. 2.59] of rho~ = rho cos theta_i cos theta_o: per
degree l the outer product of the lighting with the BRDF, which yields both up to a scale of that degree. Reciprocity,
rho~_lpq = rho~_plq, ties the scales of l and p together where neither vanishes. One is a gauge: L_00 = 1 / Lambda_0.

Lighting is complex, ((l_max + 1)^2,); rho~ is (l_max + 1, p_max + 1, min(l_max, p_max) + 1), q >= 0, zero where
q > min(l, p); B~ is ((l_max + 1)^2, (p_max + 1)^2), lm by pq, zero where |q| > l.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from invrender.theory.bilinear import ROUNDING, RealField, checked_field, fit_products, real_field
from invrender.theory.convolution import normalisation
from recon.harmonics.basis import degree_of, degrees
from recon.harmonics.complex import to_complex

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Bools = NDArray[np.bool_]

# How many standard deviations an amplitude stands out of the noise before anything is divided by it: from there on
# standard deviations to first order hold.
_SIGNIFICANT = 5.0
# A tie that much weaker than the rest of its degree is lost in the rounding of normal equations.
_LOST = 1e-7


@dataclass(frozen=True, eq=False)
class LightFieldFactors:
    """Lighting and BRDF of a reflected light field, in the gauge L_00 = 1 / Lambda_0; NaN where they aren't determined.

    lighting : complex, ((l_max + 1)^2,). rho : rho~_lpq.
    lighting_std : standard deviations of the real coefficients `to_real(lighting)`, 0 for L_00. rho_std : those of rho.
    lighting_determined, brdf_determined : (l_max + 1,), whether all of a degree's coefficients are. Where the lighting
        of a degree vanishes, rho holds what reciprocity takes from other degrees.
    reasons : l_max + 1 of them, why a degree isn't determined, in words; empty where it is.
    misfit : chi-square per degree of freedom, about 1 if the BRDF is isotropic and reciprocal and the noise as stated;
        NaN where there is no more data than unknowns.
    """

    lighting: Complexes
    rho: Floats
    lighting_std: Floats
    rho_std: Floats
    lighting_determined: Bools
    brdf_determined: Bools
    reasons: tuple[str, ...]
    misfit: float


def printed_factors(coefficients: ArrayLike) -> tuple[Complexes, Floats]:
    """Lighting and rho~ of B~ by the formula as printed, m that of the largest |B~_lm00| [R02, eq. 2.68].

    NaN in the degrees in which B~_00l0 or all of B~_lm00 vanish. Raises ValueError as `checked_field`.
    """
    field = checked_field(coefficients)
    l_max, p_max = (degree_of(count) for count in field.shape)
    p, q = np.meshgrid(np.arange(p_max + 1), np.arange(min(l_max, p_max) + 1), indexing="ij")
    lighting, rho = np.full(len(field), np.nan, complex), np.full((l_max + 1, *p.shape), np.nan)
    tiny = ROUNDING * np.abs(field).max()
    for l, scale in enumerate(normalisation(l_max)[: p_max + 1]):
        band, mirrored = field[l * l : (l + 1) ** 2], field[0, l * l + l].real
        strongest = band[np.argmax(np.abs(band[:, 0]))]
        if abs(mirrored) > tiny:
            lighting[l * l : (l + 1) ** 2] = band[:, 0] / (scale * mirrored)
            if abs(strongest[0]) > tiny:
                ratio = strongest[p * p + p + np.minimum(p, q)] / strongest[0]
                rho[l] = np.where(q <= p, ratio.real * mirrored, 0)
    return lighting, rho


def factor_light_field(coefficients: ArrayLike, noise_std: ArrayLike = 0.0) -> LightFieldFactors:
    """Lighting and BRDF of B~ by weighted least squares over all of it, with standard deviations to first order.

    Starts from an explicit solution: each degree's outer product, scaled along those ties to degree 0 that noise harms
    least. noise_std : root mean square of |error| of all coefficients or of each (the same for m and -m, q and -q),
    independent but for the pairs that make the field real. White noise on the field has a single number: the basis
    is orthonormal. Less than rounding counts as rounding, 1e-13 of the largest; ties below 5e-7 of their degree count
    as none. Raises ValueError as `real_field`, and where B~_0000 doesn't stand out of the noise: no light.
    """
    field = real_field(coefficients, noise_std)
    if not abs(field.values[0, 0, 0]) > _SIGNIFICANT * field.std[0, 0, 0]:
        raise ValueError(
            f"B_0000 is {field.values[0, 0, 0]:.3g} with a standard deviation of {field.std[0, 0, 0]:.2g}: there is no"
            " light to fix the scale by"
        )
    l_max, p_max = (count - 1 for count in field.valid.shape[:2])
    products = _outer_products(field)
    fit = fit_products(field, *_explicit(field, products))
    seen = ~np.isnan(fit.lighting[np.arange(l_max + 1) ** 2])
    whole = np.array([not np.isnan(row).any() for row in fit.rho])
    scale = normalisation(l_max)[degrees(l_max)]
    # Folded: of q > 0 there are two.
    fold = np.where(np.arange(field.valid.shape[2]) > 0, np.sqrt(2), 1)
    return LightFieldFactors(
        lighting=to_complex(fit.lighting / scale),
        rho=fit.rho / fold,
        lighting_std=fit.lighting_std / scale,
        rho_std=fit.rho_std / fold,
        lighting_determined=seen,
        brdf_determined=whole,
        reasons=tuple(_reason(l, p_max, products.lit[l], seen[l], whole[l]) for l in range(l_max + 1)),
        misfit=fit.misfit,
    )


def _reason(l: int, p_max: int, lit: bool, seen: bool, whole: bool) -> str:
    if whole:
        return ""
    if seen:
        return (
            f"the lighting of degree {l} doesn't stand out of the noise: of the BRDF of that degree only what"
            " reciprocity takes from others is known"
        )
    if not lit:
        return (
            f"the light field of degree {l} doesn't stand out of the noise, nor does the BRDF of that degree where"
            " other degrees show it: the lighting could be anything there"
        )
    untied = f"lighting and BRDF of degree {l} are known up to a common scale only:"
    if l > p_max:
        return f"{untied} the light field ends at degree {p_max} in the exitant direction, so reciprocity says nothing"
    return f"{untied} no BRDF between it and determined degrees stands out of the noise"


class _OuterProducts(NamedTuple):
    """Per degree the lighting ((l_max + 1)^2,), of length 1, the BRDF at that scale, its noise, if they stand out."""

    lighting: Floats
    rho: Floats
    rho_std: Floats
    lit: Bools


def _outer_products(field: RealField) -> _OuterProducts:
    lighting, lit = np.zeros(len(field.values)), np.zeros(len(field.valid), bool)
    rho, rho_std = np.zeros(field.valid.shape), np.ones(field.valid.shape)
    for l, valid in enumerate(field.valid):
        band = slice(l * l, (l + 1) ** 2)
        values, std = field.values[band, valid], field.std[band, valid]
        # Noise taken as rows times columns makes the rank-one approximation a weighted one.
        log = np.log(std)
        rows, columns = np.exp(log.mean(axis=1)), np.exp(log.mean(axis=0) - log.mean())
        left, strengths, _ = np.linalg.svd(values / np.outer(rows, columns), full_matrices=False)
        pattern = left[:, 0] * rows / np.linalg.norm(left[:, 0] * rows)
        information = pattern**2 @ std**-2
        lighting[band], rho[l, valid] = pattern, pattern @ (values / std**2) / information
        rho_std[l, valid] = information**-0.5
        # Of noise alone the largest singular value exceeds the roots' sum by t in less than exp(-t^2 / 2) of cases
        # [Davidson and Szarek 2001].
        lit[l] = strengths[0] > np.sqrt(values.shape).sum() + _SIGNIFICANT
    return _OuterProducts(lighting, rho, rho_std, lit)


def _explicit(field: RealField, products: _OuterProducts) -> tuple[Floats, Floats]:
    """Lambda_l L_lm and the folded rho~ where they are determined, NaN elsewhere."""
    count = min(field.valid.shape[:2])
    noise = np.hypot(products.rho_std, _LOST * np.linalg.norm(products.rho, axis=(1, 2))[:, None, None])
    power = np.sum((products.rho / noise) ** 2 - field.valid, axis=2)[:count, :count]
    i, j = np.nonzero((np.minimum(power, power.T) > 0) & np.outer(products.lit, products.lit)[:count, :count])
    # The relative variance of a degree's scale is the sum of those along its ties to degree 0.
    costs = csr_array((1 / power[i, j] + 1 / power[j, i], (i, j)), shape=power.shape)
    variances, before = dijkstra(costs, indices=0, limit=_SIGNIFICANT**-2, return_predecessors=True)

    lighting, scales = np.full(len(field.values), np.nan), np.full(count, products.lighting[0])
    known = np.where(field.valid, np.nan, np.zeros((2, 1, 1, 1)))  # rho~, and its noise
    for l in np.argsort(variances)[: np.isfinite(variances).sum()].tolist():
        if l > 0:
            here, there = products.rho[l, before[l]], products.rho[before[l], l]
            ratio = np.sign(here @ there) * np.linalg.norm(here) / np.linalg.norm(there)
            scales[l] = ratio * scales[before[l]]
        lighting[l * l : (l + 1) ** 2] = scales[l] * products.lighting[l * l : (l + 1) ** 2]
        found = np.stack([products.rho[l] / scales[l], noise[l] / abs(scales[l])])
        for row, new in ((known[:, l], found), (known[:, :count, l], found[:, :count])):
            row[...] = np.where(np.isnan(row), new, row)

    # Of other degrees reciprocity may yield the BRDF: then their lighting is seen, if only to be about zero.
    for l in np.flatnonzero(np.isnan(lighting[np.arange(count) ** 2])).tolist():
        band, there = slice(l * l, (l + 1) ** 2), field.valid[l] & ~np.isnan(known[0, l])
        row, its_noise = known[:, l, there]
        if np.sum((row / its_noise) ** 2 - 1) > _SIGNIFICANT**2:
            weights = field.std[band, there] ** -2
            lighting[band] = (weights * field.values[band, there]) @ row / (weights @ row**2)
    return lighting, known[0]
