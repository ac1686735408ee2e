"""Lobes as filters: RH01's fig. 4 and 5, and by how much its equations 19 and 20 are off."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from scipy.special import eval_legendre

from benchmarks.ink import COLOURS, GREY, MARKS
from benchmarks.papers.entry import Outcome, Workplace
from invrender.prefilter.energy import energy_fraction, symmetric_power
from invrender.theory.specialcases import (
    microfacet_gaussian,
    microfacet_transfer,
    phong_gaussian,
    phong_transfer,
)
from recon.harmonics.basis import clamped_cosine_transfer

_EXPONENTS, _SIGMAS = (8, 32, 128, 512), (0.05, 0.1, 0.2, 0.4)


def clamped_cosine(place: Workplace) -> Outcome:
    """RH01's fig. 4: the clamped cosine, its sums of degrees, and its coefficients."""
    figure = Figure(figsize=(10, 3.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    theta = np.linspace(0, np.pi, 400)
    cosine = np.cos(theta).clip(0)
    left.plot(np.degrees(theta), cosine, color="#BBBBBB", linewidth=5, label="max(cos θ, 0)")
    l = np.arange(11)
    transfer = clamped_cosine_transfer(10)
    # max(cos, 0) = sum (2 l + 1) / 4 pi A_l P_l(cos).
    terms = ((2 * l + 1) / (4 * np.pi) * transfer)[:, None] * eval_legendre(l[:, None], np.cos(theta))
    sums = np.cumsum(terms, axis=0)
    for degree, colour, style in zip((0, 1, 2, 4), COLOURS, ("--", "-.", "-", ":"), strict=False):
        label = f"l ≤ {degree}" if degree else "l = 0"
        left.plot(np.degrees(theta), sums[degree], style, color=colour, label=label)
    left.set(xlabel="angle from the normal θ [degrees]", ylabel="transfer function", xticks=range(0, 181, 30))
    left.set_title("The clamped cosine and its first degrees")
    left.legend()

    right.axhline(0, color=GREY, linewidth=0.8)
    right.plot(l, transfer, "-o", color=COLOURS[0], label="$A_l$ [sr]")
    right.set(xlabel="degree l", ylabel="$A_l$ [sr]", ylim=(-0.5, 3.6), xticks=range(11))
    right.set_title("Its coefficients, and the energy they hold")
    shares = right.twinx()
    fraction = energy_fraction(symmetric_power(transfer), 2 * np.pi / 3)
    shares.plot(l, 100 * fraction, "--s", color=COLOURS[1], label="energy in degrees up to l [%]")
    shares.set(ylabel="energy in degrees up to l [%]", ylim=(0, 110))
    shares.annotate(f"{fraction[2]:.2%}", (2, 100 * fraction[2]), (2.4, 84), arrowprops={"arrowstyle": "-"})
    lines = [*right.get_lines()[1:], *shares.get_lines()]
    right.legend(lines, [str(line.get_label()) for line in lines], loc="center right")
    # A share of the energy by a second way: the sum itself, squared and integrated over the sphere.
    off = (sums[2] - cosine) ** 2 * np.sin(theta)
    left_out = np.trapezoid(off, theta) / np.trapezoid(cosine**2 * np.sin(theta), theta)
    return Outcome(
        "degree 2 gives a very good approximation",
        f"degrees 0 to 2 hold {fraction[2]:.2%} of the energy",
        f"Odd degrees above 1 vanish; the rest falls off as l^(-5/2). Summed over angles, degrees up to 2 leave"
        f" {left_out:.2%} of the squared cosine, as their coefficients say.",
        place.save(figure, "rh01-fig4"),
    )


def phong_lobe(place: Workplace) -> Outcome:
    """RH01's fig. 5: transfer of Phong's lobe, exact and by equation 19."""
    figure = Figure(figsize=(7, 4.2), layout="constrained")
    axes = figure.subplots()
    worst = {}
    for shininess, colour, mark in zip(_EXPONENTS, COLOURS, MARKS, strict=False):
        # The Gaussian between the degrees, too: ten times as wide, at every tenth of a degree.
        axes.plot(np.arange(401) / 10, phong_gaussian(100 * shininess, 400), color=colour)
        exact = phong_transfer(shininess, 40)
        axes.plot(exact, mark, color=colour, markersize=4, label=f"s = {shininess}")
        worst[shininess] = float((phong_gaussian(shininess, 40) - exact).max())
    axes.axhline(0, color=GREY, linewidth=0.8)
    axes.plot([], [], color="black", label="exp(−l² / 2s)")
    axes.set(xlabel="degree l", ylabel="$Λ_l\\hat{ρ}_l$", xlim=(-0.5, 40.5))
    axes.set_title("Phong's lobe as a filter: exact (marks) and RH01 eq. 19 (lines)")
    axes.legend()
    found = ", ".join(f"{value:.3f} (s = {s})" for s, value in worst.items())
    return Outcome(
        "eq. 19 follows the coefficients",
        f"eq. 19 is too large by up to {max(worst.values()):.3f}, at s = {max(worst, key=worst.__getitem__)}",
        f"The lines lie above the marks: {found}. Times sqrt(s) that is"
        f" {min(v * np.sqrt(s) for s, v in worst.items()):.2f} to {max(v * np.sqrt(s) for s, v in worst.items()):.2f}.",
        place.save(figure, "rh01-fig5"),
    )


def equation_19(place: Workplace) -> Outcome:
    """By how much exp(-l^2 / 2 s) is off, and a form that is off by less."""
    rows = [["s", "largest error of exp(-l² / 2s)", "of exp(-l (l + 1) / (2s + 3))"]]
    better = {}
    for s in _EXPONENTS:
        l = np.arange(6 * int(np.sqrt(s)) + 1)
        exact = phong_transfer(s, l[-1])
        printed = np.abs(phong_gaussian(s, l[-1]) - exact).max()
        better[s] = float(np.abs(np.exp(-l * (l + 1) / (2 * s + 3)) - exact).max())
        rows.append([str(s), f"{printed:.4f}", f"{better[s]:.4f}"])
    return Outcome(
        "Λ_l ρ_l ≈ exp(-l² / 2s)",
        f"off by up to {rows[1][1]} (s = 8); with l (l + 1) / (2s + 3) by up to {better[8]:.4f}",
        "The exact coefficients are products of (s - l + 2) / (s + l + 1). Their logarithm is -l (l + 1) / (2s + 3) for"
        " small l, so the printed exponent decays too slowly.",
        table=rows,
    )


def equation_20(place: Workplace) -> Outcome:
    """The microfacet lobe at normal exitance against equation 20, and its error."""
    figure = Figure(figsize=(10, 4), layout="constrained")
    left, right = figure.subplots(1, 2)
    l = np.arange(51)
    worst = []
    for sigma, colour, mark in zip(_SIGMAS, COLOURS, MARKS, strict=False):
        exact, gaussian = microfacet_transfer(sigma, 50), microfacet_gaussian(sigma, 50)
        worst.append(float((gaussian - exact).max()) / sigma)
        left.plot(np.arange(501) / 10, microfacet_gaussian(sigma / 10, 500), color=colour)
        left.plot(l, exact, mark, color=colour, markersize=4, label=f"σ = {sigma} rad")
        right.plot(sigma * l, gaussian - exact, f"-{mark}", color=colour, markersize=4)
    left.plot([], [], color="black", label="exp(−(σl)²)")
    left.set(xlabel="degree l", ylabel="$Λ_l\\hat{ρ}_l$")
    left.set_title("The lobe as a filter: exact (marks), RH01 eq. 20 (lines)")
    left.legend()
    right.set(xlabel="σ l  [rad]", ylabel="eq. 20 − exact", xlim=(-0.1, 2.6))
    right.set_title("By how much RH01 eq. 20 is too large")
    for axes in (left, right):
        axes.axhline(0, color=GREY, linewidth=0.8)
    return Outcome(
        "Λ_l ρ_l ≈ exp(-(σl)²)",
        f"too large by up to {min(worst):.2f} σ to {max(worst):.2f} σ",
        "What decays is σ² l (l + 1); the hemisphere's edge and the sine take a little more from wide lobes. The"
        " printed form is the limit of small σ.",
        place.save(figure, "rh01-eq20"),
    )
