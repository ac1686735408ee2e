"""R02's fig. 5.5 and eq. 5.19: how accurate an order is, and what says so beforehand."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.special import eval_legendre

from benchmarks.ink import COLOURS
from benchmarks.papers.entry import Outcome, Workplace
from benchmarks.papers.probes import probe
from invrender.prefilter.energy import (
    energy_fraction,
    lighting_energy,
    power_per_degree,
    residual_bound,
    symmetric_power,
)
from invrender.theory.convolution import normalisation
from invrender.theory.specialcases import phong_transfer
from recon.harmonics.latlong import integrate_latlong

Floats = NDArray[np.float64]

_EXPONENT, _SHOWN, _WHOLE = 32.0, 30, 100
_GREY = np.array([0.2126, 0.7152, 0.0722])


def accuracy_of_orders(place: Workplace) -> Outcome:
    """R02's fig. 5.5: accuracy of the reflected field against its order, Grace Cathedral and Phong s = 32."""
    grey = np.repeat(
        (probe(place, "Grace Cathedral", 60 if place.quick else None) @ _GREY)[..., None], 3, axis=2
    )
    light = power_per_degree(integrate_latlong(grey, _WHOLE))[:, :1]
    lobe = symmetric_power(phong_transfer(_EXPONENT, _WHOLE))
    light_total, lobe_total = (
        lighting_energy(grey)[:1],
        (_EXPONENT + 1) ** 2 / (2 * np.pi * (2 * _EXPONENT + 1)),
    )
    reflected = normalisation(_WHOLE) ** 2 * light[:, 0] * lobe
    exact = energy_fraction(reflected, reflected.sum())
    of_light = energy_fraction(light[:, 0], light_total[0])
    of_lobe = energy_fraction(lobe, lobe_total)
    least = np.maximum(of_light, of_lobe)  # 1 - min(eps_L, eps_rho)
    corrected = 1 - residual_bound(light, lobe, light_total, lobe_total)[:, 0]
    printed = 1 - printed_bound(reflected, light_total[0] * (1 - of_light), lobe_total * (1 - of_lobe))
    short = light[: _SHOWN + 1]
    band = 1 - residual_bound(short, lobe[: _SHOWN + 1], short.sum(axis=0), lobe_total)[:, 0]
    figure = Figure(figsize=(8.5, 4.8), layout="constrained")
    axes = figure.subplots()
    curves = {
        "reflected field, exact": (exact, "-"),
        "estimate: the better of light and lobe": (least, "--"),
        "estimate: residual bound with Λ²": (corrected, "-."),
        "estimate: residual bound as printed": (printed, ":"),
        "light alone": (of_light, "-"),
    }
    for (label, (values, style)), colour in zip(curves.items(), COLOURS, strict=False):
        axes.plot(100 * values[: _SHOWN + 1], style, color=colour, label=label, linewidth=1.8)
    axes.set(xlabel="order F (highest degree)", ylabel="accuracy: share of the energy [%]", xlim=(0, _SHOWN))
    axes.set(ylim=(0, 102), title="Grace Cathedral (luminance), Phong's lobe of exponent 32")
    axes.legend(loc=(0.585, 0.48))
    axes.grid(alpha=0.3)
    first = [int(np.argmax(values >= 0.97)) for values in (exact, least, corrected)]
    above = [
        int(np.sum(values[: _SHOWN + 1] > exact[: _SHOWN + 1] + 1e-12))
        for values in (least, corrected, printed)
    ]
    same = float(np.abs(least - of_lobe)[1 : _SHOWN + 1].max())
    return Outcome(
        "both estimates are conservative and fairly tight; the minimum is the BRDF's error",
        f"conservative, the minimum tight, the bound not: 97% at F = {first[0]}; they say F = {first[1]} and"
        f" {first[2]}",
        f"Of orders 0 to {_SHOWN} the minimum is above the truth at {above[0]}, the bound with Λ² at {above[1]}, the"
        f" bound as printed at {above[2]}. The minimum and the lobe's own accuracy differ by {same:.1%} at most from"
        " F = 1 on, so that the lobe alone does, as R02 says. The bound is loose because most of the cathedral's"
        f" energy is in its lamps, above degree {_SHOWN} ({1 - of_light[_SHOWN]:.0%}). With light cut off there it"
        f" says F = {int(np.argmax(band >= 0.97))}. The minimum is no proven bound; eq. 5.19 is one with Λ² alone"
        " (r02-eq5.19).",
        place.save(figure, "r02-fig5.5"),
    )


def printed_bound(reflected: Floats, left_of_light: Floats, left_of_lobe: Floats) -> Floats:
    """eps_B (l_max + 1,) by eq. 5.19 as printed, with Lambda and no square."""
    scale = normalisation(len(reflected))[1:]
    residual = scale * left_of_light.clip(0) * left_of_lobe.clip(0)
    return residual / (np.cumsum(reflected) + residual)


def equation_5_19(place: Workplace) -> Outcome:
    """Light and lobe of the degrees 0 and F + 1, reflected by quadrature, against the bound either way."""
    rows = [["F", "Λ_(F+1)", "energy left out, over the bound as printed", "over the bound with Λ²"]]
    broken = []
    for order in range(8):
        true, printed, squared = _worst_case(order + 1, 24 if place.quick else 64)
        scale = normalisation(order + 1)[-1]
        rows.append([str(order), f"{scale:.3f}", f"{true / printed:.3f}", f"{true / squared:.6f}"])
        broken.append(true > printed * (1 + 1e-9))
        assert true <= squared * (1 + 1e-9)
    failing = [str(order) for order, is_broken in enumerate(broken) if is_broken]
    return Outcome(
        "ε_B ≤ Λ_(F+1) (ε_L L_tot) (ε_ρ ρ_tot) / (...)",
        f"no bound for F = {failing[0]} to {failing[-1]}; with Λ² it holds, as an equality",
        "Since B_lm = Λ_l ρ_l L_lm, energies have Λ². Λ_(F+1) = sqrt(4π / (2F + 3)) is above 1 for F < 5, where the"
        " printed right side is too small. Beyond, it is a bound, but wider than it need be. Light and lobe here have"
        " the degrees 0 and F + 1 alone, which is the worst case that R02 names; the reflected field is integrated over"
        " angles.",
        table=rows,
    )


def _worst_case(degree: int, nodes: int) -> tuple[float, float, float]:
    """Share of the reflected energy above `degree` - 1: as it is, by eq. 5.19 as printed, and with Lambda squared."""
    z, weight = np.polynomial.legendre.leggauss(nodes)
    phi = (np.arange(2 * nodes) + 0.5) * np.pi / nodes
    # A zonal light and a lobe, each of mean 1 and a wave of one degree.
    light, lobe = (
        (lambda t: 1 + 0.5 * eval_legendre(degree, t)),
        (lambda t: 1 + 0.8 * eval_legendre(degree, t)),
    )
    # Directions at angle arccos z about a centre at arccos a: their height.
    heights = z[:, None, None] * z[None, :, None]
    heights = heights + np.sqrt((1 - z[:, None, None] ** 2) * (1 - z[None, :, None] ** 2)) * np.cos(phi)
    reflected = (light(heights) * lobe(z)[None, :, None]).mean(axis=2) @ weight * 2 * np.pi

    def energies(values: Floats) -> tuple[float, float]:
        # All, and of the mean alone.
        mean = weight @ values / 2
        return float(2 * np.pi * weight @ values**2), float(4 * np.pi * mean**2)

    (all_light, low_light), (all_lobe, low_lobe) = energies(light(z)), energies(lobe(z))
    whole, held = energies(reflected)
    left = (all_light - low_light) * (all_lobe - low_lobe)
    scale = float(normalisation(degree)[degree])
    printed, squared = scale * left, scale**2 * left
    return (whole - held) / whole, printed / (held + printed), squared / (held + squared)
