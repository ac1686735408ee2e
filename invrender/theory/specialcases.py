"""Coefficients of special BRDFs and lightings [RH01, section 5.2 and appendix].

Radially symmetric transfer functions rho^(theta) = sum rho_l Y_l0(theta) are given as Lambda_l rho_l, (l_max + 1,), the
factor by which `convolution.filtered` multiplies lighting [eq. 15]; Lambda_l is `convolution.normalisation`. Phong and
microfacet lobes are centred on the reflected view [eq. 17]. Lambertian reflection has `clamped_cosine_transfer` in
`recon.harmonics.basis`.
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial.legendre import leggauss, legvander
from numpy.typing import ArrayLike, NDArray

from invrender.theory.convolution import normalisation
from recon.harmonics.basis import check_degree, degrees, orders

Floats = NDArray[np.float64]

# The lobe exp(-(theta / 2 sigma)^2) is below rounding from so many times 2 sigma on.
_LOBE_END = 7.0


def mirror_coefficients(l_max: int) -> Floats:
    """rho_lpq = (-1)^q delta_lp of a mirror, (l_max + 1, l_max + 1, l_max + 1), q >= 0 [RH01, eq. 14].

    0 where q > l. That of the delta function on whole spheres: unlike a real mirror it reflects from below, too.
    """
    check_degree(l_max)
    l, p, q = np.indices((l_max + 1,) * 3)
    return np.where((l == p) & (q <= l), (-1.0) ** q, 0.0)


def pole_source_coefficients(l_max: int) -> Floats:
    """L_lm = delta_m0 / Lambda_l, ((l_max + 1)^2,), of a source of unit irradiance in direction +Z [RH01, section 5.2].

    Of sources elsewhere: `project_sources` in `harmonics`.
    """
    return np.where(orders(l_max) == 0, 1 / normalisation(l_max)[degrees(l_max)], 0.0)


def phong_transfer(shininess: float, l_max: int) -> Floats:
    """Lambda_l rho_l (l_max + 1,) of the Phong lobe (s + 1) / (2 pi) cos^s theta, theta < pi/2 [RH01, eq. 18].

    shininess : s > 0, any real number. The appendix's products for odd and for even l, to rounding for all s and l.
    Beyond l = s + 2 each parity alternates in sign; of an integer s, its own parity is 0 from there on. Raises
    ValueError for s that isn't above 0 and l_max below 0.
    """
    check_degree(l_max)
    s = _positive(shininess, "shininess")
    # T_l = T_(l-2) (s - l + 2) / (s + l + 1), from T_0 = 1 and T_1 = (s + 1) / (s + 2), which is T_-1 = 1 in it.
    l = np.arange(l_max + 1)
    factors = (s - l + 2) / (s + l + 1)
    factors[0] = 1
    transfer = np.empty(l_max + 1)
    transfer[::2], transfer[1::2] = np.cumprod(factors[::2]), np.cumprod(factors[1::2])
    return transfer


def phong_gaussian(shininess: float, l_max: int) -> Floats:
    """exp(-l^2 / 2s) (l_max + 1,), the approximation of `phong_transfer` for s >> 1 and l << s [RH01, eq. 19].

    Too large by up to 0.30 / sqrt(s), near l = sqrt(s): 0.05 for s = 8, 0.012 for s = 512. The exact logarithm is
    -l (l + 1) / (2s + 3) + O(l^4 / s^3): what eq. 19 neglects is l / 2s. The appendix's next term, +l^2 / 2s^2, makes
    it worse: it comes from a quotient of gamma functions that has already lost l / 2s, and whose own expansion has this
    term with the other sign. Raises ValueError as `phong_transfer`.
    """
    check_degree(l_max)
    return np.exp(-(np.arange(l_max + 1) ** 2) / (2 * _positive(shininess, "shininess")))


def lobe(theta_half: ArrayLike, sigma: ArrayLike) -> Floats:
    """S = exp(-(theta_h / sigma)^2) / (pi sigma^2), 1/sr [RH01, section 5.2]; angles in radians."""
    sigma = np.asarray(sigma, float)
    return np.exp(-((np.asarray(theta_half, float) / sigma) ** 2)) / (np.pi * sigma**2)


def microfacet_transfer(sigma: float, l_max: int) -> Floats:
    """Lambda_l rho_l (l_max + 1,) of the microfacet lobe S / 4 at normal exitance, F = 1 [RH01, eq. 27].

    sigma : radians, > 0. The integral over the hemisphere, by Gauss-Legendre to about 1e-16 l^2; light from below the
    horizon is lost, which shows from sigma = 0.3 on. Raises ValueError for sigma that isn't above 0 and l_max below 0.
    """
    check_degree(l_max)
    end = min(np.pi / 2, 2 * _LOBE_END * _positive(sigma, "sigma"))
    # Waves of l up to l_max within the lobe, and the lobe itself.
    node, weight = leggauss(int(l_max * end / 2) + 80)
    theta = (node + 1) * end / 2
    # The half vector lies at half the incident angle.
    values = 2 * np.pi * lobe(theta / 2, sigma) / 4 * np.sin(theta) * weight * end / 2
    return np.asarray(legvander(np.cos(theta), l_max).T @ values)


def microfacet_gaussian(sigma: float, l_max: int) -> Floats:
    """exp(-(sigma l)^2) (l_max + 1,), the approximation of `microfacet_transfer` [RH01, eq. 20]; sigma in radians.

    Measured against eq. 27 for sigma from 0.02 to 0.7:
    - For sigma l << 1 it is too large by sigma^2 (l + 2/3), not by the O((sigma l)^4) of the appendix, which takes
      l (l + 1) for l^2 and sin theta for theta.
    - The error is largest near l = 0.7 / sigma: 0.43 sigma for small sigma, 0.46 sigma for 0.2 to 0.5. Above that it is
      largest at l = 0, because the horizon cuts off the lobe: 0.29 for sigma = 0.6, 0.39 for 0.7.
    - For sigma l >> 1 the exact one is smaller by a factor of about exp(-sigma^2 l), down to what the cut at the
      horizon leaves, which is no Gaussian: up to 0.002 beyond l = 3 / sigma for sigma = 0.4, 0.006 for 0.5, 0.017 for
      0.7; it doesn't show for sigma <= 0.2.
    exp(-sigma^2 (l (l + 1) + 2/3)) is within 0.13 sigma^2 for sigma <= 0.3. Raises ValueError as `microfacet_transfer`.
    """
    check_degree(l_max)
    return np.exp(-((_positive(sigma, "sigma") * np.arange(l_max + 1)) ** 2))


def microfacet_gaussian_reach(sigma: float, tolerance: float, l_max: int) -> int:
    """The highest degree, at most l_max, up to which eq. 20 is within a tolerance at normal exitance; -1 if none is.

    tolerance : of Lambda_l rho_l, absolute; a mirror's is 1. Eq. 20 is within 0.05 at all degrees for sigma <= 0.11,
    and within 0.02 at all for sigma <= 0.045, up to degree 9 for 0.05, up to 1 for 0.1, at none for 0.2. Raises
    ValueError as `microfacet_transfer`, and for a tolerance that isn't above 0.
    """
    _positive(tolerance, "tolerance")
    off = np.abs(microfacet_gaussian(sigma, l_max) - microfacet_transfer(sigma, l_max)) > tolerance
    return int(off.argmax()) - 1 if off.any() else l_max


def _positive(value: float, name: str) -> float:
    if not 0 < value < np.inf:
        raise ValueError(f"{name} is {value}; it must be a finite number above 0")
    return float(value)
