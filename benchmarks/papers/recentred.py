"""R02's fig. 2.4: BRDFs about the surface normal and about the mirrored view."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from benchmarks.ink import COLOURS
from benchmarks.papers.entry import Outcome, Workplace
from invrender.brdf.form import Lobe
from invrender.brdf.phong import mirrored_phong
from invrender.brdf.rh01 import simplified_microfacet
from invrender.prefilter.energy import degrees_reaching, isotropic_fraction
from invrender.prefilter.reflectionmap import axial_lobe_coefficients, lobe_coefficients

Floats = NDArray[np.float64]

_EPSILON = 0.03
_LOBES = {"Phong, s = 32": mirrored_phong(32.0), "microfacets (N·H), σ = 0.2": simplified_microfacet(0.2)}
_VIEWS_DEG = (0, 15, 30, 45, 60)


def recentred_lobes(place: Workplace) -> Outcome:
    """R02's fig. 2.4: slices of two lobes either way, and how many coefficients they take."""
    figure = Figure(figsize=(10, 7), layout="constrained")
    panels = figure.subplots(2, 2, sharey="row")
    rows = [["lobe", "about", "97% of the energy", "coefficients", "in functions of the first angle alone"]]
    counts = []
    for row, (name, lobe) in zip(panels, _LOBES.items(), strict=True):
        _slices(row, lobe)
        for axes, about in zip(row, ("the normal", "the mirrored view"), strict=True):
            (f, p), count, alone = _compactness(lobe, about == "the normal", place.quick)
            counts.append(count)
            axes.set_title(f"{name}, about {about}\n97% of the energy: F = {f}, P = {p}: {count} numbers")
            rows.append([name, about, f"F = {f}, P = {p}", str(count), f"{alone:.1%}"])
    panels[0, 0].legend(title="view from the normal")
    kinds = panels[1, 1].get_lines()[-2:]
    panels[1, 1].legend(kinds, [str(line.get_label()) for line in kinds], loc="upper left", fontsize="small")
    return Outcome(
        "more compact about the reflection vector; Phong becomes one-dimensional",
        f"97% of the energy in {counts[1]} numbers instead of {counts[0]} (Phong), {counts[3]} instead of {counts[2]}"
        " (microfacets)",
        f"Phong's curves coincide about the mirrored view, and functions of the first angle alone hold {rows[2][4]}"
        f" of its energy (mean square) instead of {rows[1][4]}. Of microfacets they hold {rows[4][4]} instead of"
        f" {rows[3][4]}. In the plane of the view their curves coincide, too; across it (dashed) they become narrower"
        " towards grazing views. That is what is left of the view.",
        place.save(figure, "r02-fig2.4"),
        rows,
    )


def _slices(row, lobe: Lobe) -> None:
    angle = np.radians(np.linspace(-90, 90, 361))
    normal = np.array([0.0, 0, 1])
    for view_deg, colour in zip(_VIEWS_DEG, COLOURS, strict=False):
        view = np.radians(view_deg)
        # The view is on the left, the mirrored view on the right.
        wo = np.array([-np.sin(view), 0, np.cos(view)])
        for axes, centre in zip(row, (0.0, view), strict=True):
            theta = angle + centre
            wi = np.stack([np.sin(theta), 0 * theta, np.cos(theta)], axis=-1)
            values = np.where(np.abs(theta) <= np.pi / 2, lobe(normal, wi, wo), np.nan)
            axes.plot(np.degrees(angle), values, color=colour, label=f"{view_deg}°")
        sin, cos = np.sin(angle), np.cos(angle)
        across = np.stack([cos * np.sin(view), sin, cos * np.cos(view)], axis=-1)
        row[1].plot(np.degrees(angle), lobe(normal, across, wo), "--", color=colour)
    row[1].plot([], [], "-", color="black", label="in the plane of the view")
    row[1].plot([], [], "--", color="black", label="across it")
    row[0].set(xlabel="light from the normal θ' [degrees]", ylabel="BRDF times cosine [1/sr]")
    row[1].set(xlabel="light from the mirrored view θ' [degrees]")
    for axes in row:
        axes.set(xlim=(-90, 90), xticks=range(-90, 91, 30))


def _compactness(lobe: Lobe, about_normal: bool, quick: bool) -> tuple[tuple[int, int], int, float]:
    """Orders (F, P) of 97% of the energy, how many rho_lpq these are, and the share of p = q = 0."""
    degree = 30 if quick else 40
    if about_normal:
        rho, energy = axial_lobe_coefficients(lobe, degree, degree, 0.5 if quick else 1)
    else:
        rho, energy = lobe_coefficients(lobe, degree, 8, 0.5 if quick else 1)
    fraction = isotropic_fraction(rho, energy)
    f, p = degrees_reaching(fraction, _EPSILON)
    l, orders = np.indices((f + 1, p + 1))
    return (f, p), int((np.minimum(l, orders) + 1).sum()), float(fraction[-1, 0])
