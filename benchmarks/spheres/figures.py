"""Figures: errors of every material and method beside the budgets and RH01's own; the recovered lights of Fig. 12."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from benchmarks.ink import save
from benchmarks.kept import Kept
from benchmarks.spheres.bench import LIGHT_DEGREE, MATERIALS, true_coefficients
from benchmarks.spheres.table import BUDGETS, RH01_FORM, Case, errors
from invrender.inverse_lighting.figure import draw_map, white_level
from invrender.inverse_lighting.maps import coefficient_map
from invrender.theory.specialcases import microfacet_gaussian
from recon.harmonics.basis import degrees

Rows = Sequence[tuple[Case, Mapping[str, Any]]]

_MARKS = {
    "exact": ("o", "#0b6bcb"),
    "exact, one model": (".", "#0b6bcb"),
    "filtered": ("s", "#1a7f37"),
    "mirror": ("D", "#c2410c"),
    "published": ("x", "#24292f"),
    "published, direct": ("*", "#24292f"),
    "published, mirror": ("v", "#c2410c"),
    "published, filtered": ("^", "#1a7f37"),
    "published, exact": ("+", "#24292f"),
}
# A lobe this wide, radians, leaves a tenth of degree 6.
_SHOWN_SIGMA = 0.25
_LEAST = {"share": 1e-5, "mu": 1e-4, "sigma": 1e-6}


def draw_errors(rows: Rows, kept: Kept, path: Path) -> None:
    """Errors of share, mu and sigma by material, a row of panels per light and number of views."""
    groups = list(dict.fromkeys((case.light, case.views) for case, _ in rows))
    figure = Figure(figsize=(13, 3.3 * len(groups) + 0.7), layout="constrained")
    names = list(MATERIALS)
    for panels, (light, views) in zip(figure.subplots(len(groups), 3, squeeze=False), groups, strict=True):
        own = [(c, e) for c, e in rows if (c.light, c.views) == (light, views)]
        for axes, quantity in zip(panels, ("share", "mu", "sigma"), strict=True):
            for method in dict.fromkeys(c.method for c, _ in own):
                points = [
                    (names.index(c.material), _error(c, e, quantity)) for c, e in own if c.method == method
                ]
                drawn = [(x, max(y, _LEAST[quantity])) for x, y in points if y is not None and np.isfinite(y)]
                marker, colour = _MARKS[method]
                if drawn:
                    axes.semilogy(*zip(*drawn, strict=True), marker, color=colour, label=method)
            if light == "unknown":
                # Their known light stands for the truth.
                paper = [_paper(name, quantity) for name in names]
                axes.semilogy(
                    range(6), paper, "*", color="#9a6700", label="RH01 printed, against its known light"
                )
            limit = BUDGETS[light, views].get(quantity)
            if limit is not None:
                axes.axhline(limit, color="#57606a", ls="--", lw=1)
                axes.annotate(
                    "budget",
                    (1.0, limit),
                    xycoords=("axes fraction", "data"),
                    ha="right",
                    va="bottom",
                    fontsize=7,
                )
            axes.set(
                title=f"{light} light, {views} views: error of {quantity}",
                xlim=(-0.5, 5.5),
                ylabel="absolute error [rad]" if quantity == "sigma" else "absolute error",
            )
            axes.set_xticks(range(6), names, fontsize=8)
            axes.grid(axis="y", color="#eaeef2")
    # One for all panels, where it hides nothing.
    shown = {
        label: line
        for axes in figure.axes
        for line, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    figure.legend(shown.values(), shown, loc="outside upper center", ncols=5, frameon=False)
    save(figure, path, kept.caption)


def _error(case: Case, entry: Mapping[str, Any], quantity: str) -> float | None:
    if quantity == "share":
        truth = MATERIALS[case.material]
        return float(np.abs(np.array(entry["found share"]) - truth.ks / (truth.kd + truth.ks)).max())
    return errors(case, entry)[quantity]


def _paper(name: str, quantity: str) -> float:
    column = ("share", "mu", "sigma").index(quantity)
    pair = [RH01_FORM[light][name][column] for light in ("known", "unknown")]
    # To the two digits that are printed.
    return float("nan") if pair[0] is None or pair[1] is None else max(abs(pair[1] - pair[0]), 0.005)


def draw_lights(rows: Rows, kept: Kept, path: Path) -> None:
    """Fig. 12: the light that each sphere tells, over its mean, blurred so that degree 6 is the last to show."""
    recovered = [(c, e) for c, e in rows if "coefficients" in e]
    groups = list(dict.fromkeys((c.views, c.method) for c, _ in recovered))
    if not groups:
        return
    figure = Figure(figsize=(17, 1.75 * len(groups) + 0.5), layout="constrained")
    blur = microfacet_gaussian(_SHOWN_SIGMA, LIGHT_DEGREE)[degrees(LIGHT_DEGREE), None]
    truth = coefficient_map(blur * true_coefficients())
    white = white_level(truth)
    for panels, (views, method) in zip(figure.subplots(len(groups), 7, squeeze=False), groups, strict=True):
        draw_map(panels[0], truth, white, "true light")
        panels[0].set_ylabel(f"{method},\n{views} views", fontsize=8)
        own = {c.material: e for c, e in recovered if (c.views, c.method) == (views, method)}
        for axes, name in zip(panels[1:], MATERIALS, strict=True):
            if name in own:
                draw_map(
                    axes, coefficient_map(blur * np.array(own[name]["coefficients"], float)), white, name
                )
            else:
                axes.set_axis_off()
        for axes in panels:
            axes.tick_params(labelsize=6)
    save(figure, path, kept.caption)
