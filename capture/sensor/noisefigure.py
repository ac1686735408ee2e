"""The photon transfer curve as a picture: variance against signal, with the line that was fitted."""

from __future__ import annotations

from typing import Any

import numpy as np

from capture.radiance import CHANNELS
from capture.sensor.noiserecovery import NoiseRecovery
from capture.sensor.photontransfer import binned

_COLOURS = {"red": "#c8372d", "green": "#2c8a3d", "blue": "#2b5fb8"}


def noise_figure(recovery: NoiseRecovery) -> Any:
    """A matplotlib Figure: above the curve of each channel, below how far the measurements are off the line."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 5.6), dpi=110, layout="constrained")
    axes = figure.subplots(2, 3, sharex=True, sharey="row", height_ratios=[3, 1.2])
    for column, (name, fit) in enumerate(zip(CHANNELS, recovery.fits, strict=True)):
        curve, rest = axes[0, column], axes[1, column]
        signal, variance, std = binned(fit)
        line = fit.offset + fit.slope * signal
        shown = (variance > 0) & (signal > 0)
        curve.errorbar(
            signal[shown], variance[shown], std[shown], fmt="o", ms=3, color=_COLOURS[name], label="measured"
        )
        span = (
            np.geomspace(max(signal[shown].min() * 0.7, 1e-6), signal.max() * 1.1, 100)
            if shown.any()
            else signal
        )
        model = fit.offset + fit.slope * span
        curve.plot(span[model > 0], model[model > 0], color="black", lw=1, label="read² + shot x signal")
        read = recovery.read_std[column].value
        if read is not None:
            curve.axhline(read**2, color="grey", lw=0.8, ls="--", label="read²")
        rounding = float(np.median(fit.tiles.quantisation))
        if shown.any() and rounding > variance[shown].min() / 100:
            curve.axhline(rounding, color="grey", lw=0.8, ls=":", label="quantisation (taken out)")
        curve.set_xscale("log")
        curve.set_yscale("log")
        curve.set_title(f"{name}\n{_numbers(recovery, column)}", fontsize=8)
        curve.legend(fontsize=7)
        with np.errstate(divide="ignore", invalid="ignore"):
            rest.errorbar(signal, variance / line - 1, std / line, fmt="o", ms=3, color=_COLOURS[name])
        rest.axhline(0, color="black", lw=0.8)
        rest.set_xlabel("signal (1 = white level)", fontsize=8)
        for axis in (curve, rest):
            axis.tick_params(labelsize=7)
            axis.grid(alpha=0.25)
    axes[0, 0].set_ylabel("variance (signal²)", fontsize=8)
    axes[1, 0].set_ylabel("measured / line - 1", fontsize=8)
    iso = "" if recovery.iso is None else f" at ISO {recovery.iso:g}"
    count = sum(map(len, recovery.groups))
    figure.suptitle(f"Photon transfer of {count} photographs{iso}, quantisation taken out", fontsize=10)
    return figure


def _numbers(recovery: NoiseRecovery, column: int) -> str:
    read, well = recovery.read_electrons[column], recovery.full_well[column]
    left = "undetermined" if read.value is None else f"{read.value:.3g} ± {read.std:.2g} e-"
    right = "undetermined" if well.value is None else f"{well.value:.0f} ± {well.std:.0f} e-"
    return f"read noise {left}; white level {right}"
