"""A recovered response as a picture: the curves, how certain they are, and what the pictures say of the exposures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from capture.bracket.responserecovery import Recovery
from capture.figures import short_name
from capture.radiance import CHANNELS

COLOURS = {"red": "#c8372d", "green": "#2c8a3d", "blue": "#2b5fb8"}


def response_figure(recovery: Recovery, names: Sequence[str]) -> Any:
    """A matplotlib Figure: curves with their band, standard deviations, prediction errors, believed exposures."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 8.2), dpi=110, layout="constrained")
    (curves, deviations), (residuals, exposures) = figure.subplots(2, 2)
    _draw_curves(curves, recovery)
    _draw_deviations(deviations, recovery)
    order = np.argsort(recovery.nominal_stops, kind="stable")
    _draw_residuals(residuals, recovery, order)
    _draw_exposures(exposures, recovery, order)
    labels = [short_name(names[index]) for index in order]
    for axis in (residuals, exposures):
        axis.set_xticks(range(len(order)), labels, rotation=60, ha="right", fontsize=7)
        axis.set_xlabel("photograph, least exposed first", fontsize=8)
    for axis in (curves, deviations, residuals, exposures):
        axis.tick_params(axis="y", which="both", labelsize=7)
        axis.grid(alpha=0.25)
    for axis in (curves, deviations):
        axis.tick_params(axis="x", labelsize=7)
        axis.set_xlabel("value (of 255)", fontsize=8)
        axis.set_xlim(-4, 259)
    chosen = recovery.methods[0]
    others = "".join(f"; {one.name}: {one.residual:.3f}" for one in recovery.methods[1:])
    figure.suptitle(
        f"Camera response by {chosen.name} ({chosen.detail}), which predicts values to {chosen.residual:.3f}/255"
        f"{others}",
        fontsize=10,
    )
    return figure


def _draw_curves(axis: Any, recovery: Recovery) -> None:
    values = 255 * recovery.response.values
    for index, name in enumerate(CHANNELS):
        curve = recovery.response.log_exposure[index] / np.log(2)
        band = 2 * recovery.response.log_std[index] / np.log(2)
        axis.plot(values, curve, color=COLOURS[name], lw=1.3, label=name)
        axis.fill_between(values, curve - band, curve + band, color=COLOURS[name], alpha=0.25, lw=0)
        low, high = recovery.response.determined(index)
        axis.axvspan(
            -4, 255 * low, ymin=index / 3, ymax=(index + 1) / 3, color=COLOURS[name], alpha=0.12, lw=0
        )
        axis.axvspan(
            255 * high, 259, ymin=index / 3, ymax=(index + 1) / 3, color=COLOURS[name], alpha=0.12, lw=0
        )
    axis.set_ylabel("log2 exposure (stops; the middle as in sRGB)", fontsize=8)
    axis.set_title("curve ± 2 standard deviations; shaded at the ends: undetermined", fontsize=9)
    axis.legend(fontsize=8, loc="lower right")


def _draw_deviations(axis: Any, recovery: Recovery) -> None:
    values = 255 * recovery.response.values
    for index, name in enumerate(CHANNELS):
        axis.plot(values, 100 * recovery.response.log_std[index], color=COLOURS[name], lw=1.2)
    axis.set_yscale("log")
    axis.set_ylabel("standard deviation of the exposure (%)", fontsize=8)
    axis.set_title("how certain the curve is", fontsize=9)


def _draw_residuals(axis: Any, recovery: Recovery, order: Any) -> None:
    for index, name in enumerate(CHANNELS):
        axis.plot(recovery.residual[index, order], "o-", ms=4, lw=0.8, color=COLOURS[name])
    axis.set_ylim(bottom=0)
    axis.set_ylabel("mean |observed - predicted value| (of 255)", fontsize=8)
    axis.set_title("values predicted from the other photographs", fontsize=9)


def _draw_exposures(axis: Any, recovery: Recovery, order: Any) -> None:
    off = (recovery.stops - recovery.nominal_stops)[order]
    axis.axhline(0, color="black", lw=0.8)
    axis.errorbar(
        range(len(order)), off, 1.96 * recovery.stops_std[order], fmt="o", ms=4, color="#444444", capsize=3
    )
    limit = max(1.2 * float(np.abs(off).max(initial=0) + 1.96 * recovery.stops_std.max(initial=0)), 0.05)
    axis.set_ylim(-limit, limit)
    axis.set_ylabel("believed - given exposure (stops)", fontsize=8)
    axis.set_title("exposures, 95% intervals; they widen with the span's uncertainty", fontsize=9)
