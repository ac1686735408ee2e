"""Equations of R02 that don't hold as printed, or not always: 2.68, 5.27 and 5.31. Eq. 5.19 is in `accuracy`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmarks.papers.entry import Outcome, Workplace
from benchmarks.papers.probes import probe
from invrender.prefilter.complexity import phong_order, phong_width
from invrender.theory.brdfcoefficients import isotropic_coefficients
from invrender.theory.convolution import isotropic_light_field
from invrender.theory.explicit import factor_light_field, printed_factors
from invrender.theory.specialcases import phong_gaussian, phong_transfer
from recon.harmonics.basis import degrees, orders
from recon.harmonics.complex import to_complex
from recon.harmonics.latlong import integrate_latlong

Floats = NDArray[np.float64]

_DEGREE, _SIGMA, _NOISE = 8, 0.3, 1e-3
_EXPONENTS, _EPSILONS = (8, 32, 128, 512), (0.1, 0.05, 0.01)


def equation_2_68(place: Workplace) -> Outcome:
    """Lighting by the printed factorization and by all ties together, from a light field with a little noise."""
    degree = 4 if place.quick else _DEGREE
    light = integrate_latlong(probe(place, "Uffizi", 12 if place.quick else 60), degree)[:, 1]
    lighting = to_complex(light / (light[0] * np.sqrt(4 * np.pi)))
    rho = isotropic_coefficients(_rough, degree, degree, reciprocal=True, tolerance=1e-7)
    field = isotropic_light_field(lighting, rho)
    exact = _errors(printed_factors(field)[0], lighting)
    std = _NOISE * float(np.abs(field).max())
    draws = 2 if place.quick else 8
    rng = np.random.default_rng(3)
    noisy = [field + std * _white_noise(rng, degree) for _ in range(draws)]
    printed = np.median([_errors(printed_factors(each)[0], lighting) for each in noisy], axis=0)
    ours = np.median([_errors(factor_light_field(each, std).lighting, lighting) for each in noisy], axis=0)
    table = [["degree", "as printed, no noise", "as printed", "all p and q, least squares"]]
    table += [[str(l), f"{exact[l]:.0e}", _share(printed[l]), _share(ours[l])] for l in range(1, degree + 1)]
    return Outcome(
        "explicit formula for lighting and BRDF, from p = q = 0",
        f"exact without noise; with noise of {_NOISE:.1%} off by more than 10% {_beyond(printed)}, by all p and q"
        f" together {_beyond(ours)}",
        f"The formula holds where nothing that it divides by vanishes, and gives nothing where B~_00l0 does. It"
        f" divides by two small coefficients, and takes no account of the others. Here the BRDF is a microfacet lobe"
        f" of σ = {_SIGMA} on a diffuse base, the light is the Uffizi's, noise is {_NOISE:.1%} of the largest"
        f" coefficient; errors of a degree's lighting are relative, medians of {draws} draws. A dash: nothing is"
        " stated, since the light field doesn't determine it.",
        table=table,
    )


def equation_5_27(place: Workplace) -> Outcome:
    """Phong's coefficients and the orders made of them, beside those of the exact coefficients."""
    table = [
        ["s", "largest error of exp(-l² / 2s)", *(f"F for ε = {e:g}: exact, eq. 5.28" for e in _EPSILONS)]
    ]
    worst = 0.0
    for s in _EXPONENTS:
        l = np.arange(20 * int(np.sqrt(s)) + 1)
        transfer = phong_transfer(float(s), l[-1])
        off = float(np.abs(phong_gaussian(float(s), l[-1]) - transfer).max())
        worst = max(worst, off)
        energy = np.cumsum((2 * l + 1) * transfer**2)
        cells = []
        for epsilon in _EPSILONS:
            exact = int(np.argmax(energy >= (1 - epsilon) * energy[-1]))
            cells.append(f"{exact}, {float(phong_order(s, epsilon)):.1f}")
        table.append([str(s), f"{off:.3f}", *cells])
    return Outcome(
        "ρ_l ≈ Λ_l^-1 exp(-l² / 2s), F ≈ sqrt(-s log ε)",
        f"coefficients are off by up to {worst:.3f}; orders by 1 at most",
        "As RH01's eq. 19 (rh01-eq19), the coefficients decay faster. The order that follows from them, eq. 5.28, is"
        " a little too high, which is the safe side.",
        table=table,
    )


def equation_5_31(place: Workplace) -> Outcome:
    """The width of Phong's lobe for large exponents, with and without the factor that is dropped."""
    table = [["s", "ε", "W by eq. 5.30", "eq. 5.31 as printed, over that", "half of it, over that"]]
    ratios = []
    for s in _EXPONENTS:
        width, printed = float(phong_width(s, 0.05)), -np.log(0.05) / s
        ratios.append(printed / width)
        table.append([str(s), "0.05", f"{width:.4f}", f"{ratios[-1]:.3f}", f"{ratios[-1] / 2:.3f}"])
    return Outcome(
        "W ≈ -log ε / s",
        f"{ratios[-1]:.2f} times eq. 5.30's width at s = {_EXPONENTS[-1]}; W ≈ -log ε / (2s) is the limit",
        "Eq. 5.31 writes W ∼ (1 − ε^(1/(s+1))), without the 1/2 of eq. 5.30. The growth with s, which eq. 5.32 is"
        " about, is not touched, nor is s* of eq. 5.33, which leaves all constants out.",
        table=table,
    )


def _rough(wi: Floats, wo: Floats) -> Floats:
    """Microfacets on a diffuse base, 1/sr, of local directions; bounded, and reciprocal."""
    half = wi + wo
    cos_h = half[..., 2] / np.maximum(np.linalg.norm(half, axis=-1), 1e-12)
    theta_h = np.arccos(np.clip(cos_h, -1, 1))
    return np.asarray(0.1 + np.exp(-((theta_h / _SIGMA) ** 2)))


def _errors(found: NDArray[np.complex128], lighting: NDArray[np.complex128]) -> Floats:
    """Relative RMS error of each degree; NaN where it isn't stated."""
    l_max = int(np.sqrt(len(lighting))) - 1
    bands = [slice(l * l, (l + 1) ** 2) for l in range(l_max + 1)]
    return np.array([np.linalg.norm(found[b] - lighting[b]) / np.linalg.norm(lighting[b]) for b in bands])


def _beyond(errors: Floats) -> str:
    """From which degree on lighting is off by more than 10%, or not stated."""
    far = np.flatnonzero(~(errors <= 0.1))
    return f"from degree {far[0]} on" if len(far) else f"at no degree up to {len(errors) - 1}"


def _share(error: float) -> str:
    return "–" if np.isnan(error) else f"{error:.1%}"


def _white_noise(rng: np.random.Generator, degree: int) -> NDArray[np.complex128]:
    """Of coefficients of a real field, E|n|^2 = 1, n_l-mp-q = (-1)^m conj(n_lmpq)."""
    shape = (degree + 1) ** 2, (degree + 1) ** 2
    real, imaginary = rng.normal(size=(2, *shape), scale=0.5)
    noise = real + 1j * imaginary
    m = orders(degree)
    mirrored = noise[np.arange(shape[0]) - 2 * m][:, np.arange(shape[1]) - 2 * m]
    noise = noise + (-1.0) ** m[:, None] * mirrored.conj()
    noise[np.abs(m) > degrees(degree)[:, None]] = 0
    return noise
