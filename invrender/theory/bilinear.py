"""The light field as a product of lighting and reciprocal BRDF [R02, eq. 2.59], in independent real unknowns.

A real field has B_l-mp-q = (-1)^m conj(B_lmpq), and that of an isotropic BRDF is even in q. Orders q and -q are folded
into one, orders m turned into those of real harmonics: both steps are unitary, so noise stays what it is.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csr_array

from recon.harmonics.basis import degree_of, degrees, orders
from recon.harmonics.complex import to_real

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Bools = NDArray[np.bool_]

# Rounding of coefficients, relative to the largest.
ROUNDING = 1e-13
# What chi-square may still fall by when the fit ends: nothing in any standard deviation.
_STEPS, _CONVERGED = 20, 1e-3


class RealField(NamedTuple):
    """A reflected light field's even part in q.

    values, std : ((l_max + 1)^2, p_max + 1, min + 1), q >= 0, of q > 0 sqrt(2) times the mean of q and -q; 0 and 1
        where there is no such coefficient. valid : (l_max + 1, p_max + 1, min + 1), where there is: q <= min(l, p).
    odd_chi2, odd_count : chi-square and number of what is odd in q, zero for isotropic BRDFs but for noise.
    """

    values: Floats
    std: Floats
    valid: Bools
    odd_chi2: float
    odd_count: int


def checked_field(coefficients: ArrayLike) -> Complexes:
    """B_lmpq, ((l_max + 1)^2, (p_max + 1)^2), as an array; ValueError for what isn't a light field or has no light."""
    field = np.asarray(coefficients, complex)
    if field.ndim != 2:
        raise ValueError(f"the light field's coefficients are {field.shape}; they must be lm by pq, two axes")
    l_max, p_max = (degree_of(count) for count in field.shape)
    if not np.isfinite(field).all():
        raise ValueError(
            f"{np.sum(~np.isfinite(field))} of {field.size} coefficients of the light field are not finite"
        )
    beyond = np.abs(orders(p_max)) > degrees(l_max)[:, None]
    if field[beyond].any():
        raise ValueError(
            f"{np.count_nonzero(field[beyond])} coefficients with |q| > l are not zero; there are no such waves"
        )
    if field[0, 0] == 0:
        raise ValueError("B_0000 is 0: there is no light to fix the scale by")
    return field


def real_field(coefficients: ArrayLike, noise_std: ArrayLike) -> RealField:
    """The light field B_lmpq in real unknowns; noise_std is the root mean square of |error|, one for all or of each.

    Raises ValueError as `checked_field`, for coefficients that are not those of a real field, and for noise that isn't
    finite and >= 0 and the same for m and -m, q and -q.
    """
    field = checked_field(coefficients)
    l_max, p_max = (degree_of(count) for count in field.shape)
    std = np.asarray(noise_std, float)
    if std.shape not in ((), field.shape):
        raise ValueError(
            f"noise_std is {std.shape}; it must be one number, or one per coefficient, {field.shape}"
        )
    std = np.broadcast_to(std, field.shape)
    if not (np.isfinite(std) & (std >= 0)).all():
        raise ValueError(
            f"noise_std holds {std.min():.3g} to {std.max():.3g}; standard deviations are finite and >= 0"
        )
    lm, pq = np.arange(len(field)), np.arange(field.shape[1])
    if (std != std[lm - 2 * orders(l_max)]).any() or (std != std[:, pq - 2 * orders(p_max)]).any():
        raise ValueError("noise_std differs between m and -m or q and -q; it must be the same for both")
    l, p, q = np.ogrid[: l_max + 1, : p_max + 1, : min(l_max, p_max) + 1]
    valid = q <= np.minimum(l, p)
    plus, minus = (p * p + p + np.minimum(q, p))[0], (p * p + p - np.minimum(q, p))[0]
    half = np.sqrt(0.5)
    even = np.where(q > 0, half * (field[:, plus] + field[:, minus]), field[:, plus])
    # Both at once: what is not real is judged against the largest of either.
    parts = to_real(np.stack([even, half * 1j * (field[:, plus] - field[:, minus])], axis=1))
    there = valid[degrees(l_max)]
    std = np.where(there, np.maximum(std, ROUNDING * np.abs(field).max())[:, plus], 1)
    odd = there & (q > 0)
    return RealField(
        values=np.where(there, parts[:, 0], 0),
        std=std,
        valid=valid,
        odd_chi2=float(np.sum((parts[:, 1] / std)[odd] ** 2)),
        odd_count=int(odd.sum()),
    )


class BilinearFit(NamedTuple):
    """Lambda_l L_lm in real harmonics and rho~ folded as in `RealField`, with their standard deviations.

    misfit : chi-square per degree of freedom; NaN where there is no more data than unknowns.
    """

    lighting: Floats
    lighting_std: Floats
    rho: Floats
    rho_std: Floats
    misfit: float


def fit_products(field: RealField, lighting: Floats, rho: Floats) -> BilinearFit:
    """Least squares of Lambda_l L_lm rho~_lpq by Gauss-Newton, with rho~_lpq = rho~_plq and Lambda_0 L_00 = 1.

    lighting, rho : where to start, shapes of `BilinearFit`, NaN what is undetermined, which it stays.
    """
    free = ~np.isnan(lighting)
    free[0] = False
    # Of each pair rho~_lpq = rho~_plq one is an unknown, whose place both have. Places are -1 where nothing is unknown.
    count = min(rho.shape[:2])
    unknown = field.valid & ~np.isnan(rho)
    unknown[:count, :count] &= np.triu(np.ones((count, count), bool))[..., None]
    light_place = np.where(free, np.cumsum(free) - 1, -1)
    rho_place = np.where(unknown, free.sum() + np.cumsum(unknown).reshape(unknown.shape) - 1, -1)
    square = rho_place[:count, :count]
    square[...] = np.maximum(square, square.transpose(1, 0, 2))
    vector = np.concatenate([lighting[free], rho[unknown]])

    l_of = degrees(len(rho) - 1)
    used = ~np.isnan(lighting)[:, None, None] & (rho_place[l_of] >= 0)
    lm, p, q = np.nonzero(used)
    l, moving, values, std = l_of[lm], free[lm], field.values[used], field.std[used]
    rows = np.concatenate([np.flatnonzero(moving), np.arange(len(lm))])
    columns = np.concatenate([light_place[lm[moving]], rho_place[l, p, q]])

    def spread(numbers: Floats, fixed: float) -> tuple[Floats, Floats]:
        """Numbers of the unknowns where lighting and rho~ have theirs; `fixed` for the gauge."""
        at_light = np.where(free, numbers[light_place], np.nan)
        at_light[0] = fixed
        at_rho = np.where(rho_place >= 0, numbers[rho_place], np.where(field.valid, np.nan, 0))
        return at_light, at_rho

    # Undamped, not `capture.gaussnewton`: it starts at the explicit solution.
    for _ in range(_STEPS):
        lighting, rho = spread(vector, 1.0)
        residual = (values - lighting[lm] * rho[l, p, q]) / std
        slopes = np.concatenate([(rho[l, p, q] / std)[moving], lighting[lm] / std])
        jacobian = csr_array((slopes, (rows, columns)), shape=(len(lm), len(vector)))
        normal, gradient = (jacobian.T @ jacobian).toarray(), jacobian.T @ residual
        unit = 1 / np.sqrt(np.diag(normal))
        factor = cho_factor(unit[:, None] * normal * unit)
        step = unit * cho_solve(factor, unit * gradient)
        if step @ gradient < _CONVERGED:
            break
        vector = vector + step
    deviations = unit * np.sqrt(np.diag(cho_solve(factor, np.eye(len(unit)))))
    lighting_std, rho_std = spread(deviations, 0.0)
    freedom = len(lm) - len(vector) + field.odd_count
    misfit = (residual @ residual + field.odd_chi2) / freedom if freedom else np.nan
    return BilinearFit(lighting, lighting_std, rho, rho_std, float(misfit))
