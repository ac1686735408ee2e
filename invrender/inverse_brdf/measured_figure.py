"""brdf.png of a BRDF that others measured: what was measured, what the chosen lobe says, and how well others do."""

from __future__ import annotations

from textwrap import fill
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from capture.figures import printable
from capture.radiance import CHANNELS
from invrender.inverse_brdf.measured import MeasuredFit, brdf_values
from invrender.inverse_brdf.slices import plane_of_incidence

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]

# Angles of incidence that are drawn, at most, and forms.
_PROFILES, _FORMS = 6, 8
# Samples this near to the plane of incidence count as in it, degrees.
_IN_PLANE_DEG = 10.0


def measured_figure(name: str, fit: MeasuredFit) -> Figure:
    """Profiles in the plane of incidence, fitted over measured values, and errors by form and by angle."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(15, 9), dpi=100, layout="constrained")
    figure.suptitle(printable(f"{name}: measured BRDF, and {fit.model.estimate.model.name} fitted to it"))
    grid = figure.add_gridspec(2, 3)
    _profiles(figure.add_subplot(grid[0, :2]), fit)
    _forms(figure.add_subplot(grid[0, 2]), fit)
    _scatter(figure.add_subplot(grid[1, 0]), fit)
    _over_half_angle(figure.add_subplot(grid[1, 1]), fit)
    _by_angle(figure.add_subplot(grid[1, 2]), fit)
    return figure


def _profiles(axes: Axes, fit: MeasuredFit) -> None:
    samples = fit.samples
    places = np.unique(np.linspace(0, len(fit.groups) - 1, _PROFILES).round().astype(int))
    for colour, group in enumerate([fit.groups[place] for place in places]):
        wi, wo, green = samples.wi[group], samples.wo[group], samples.rgb[group, 1]
        # The exitant angle in the plane of incidence, positive on the mirrored side, and the angle out of it.
        away = -wi[:, :2] / np.maximum(np.hypot(*wi[:, :2].T), 1e-9)[:, None]
        along, aside = (away * wo[:, :2]).sum(axis=1), away[:, 0] * wo[:, 1] - away[:, 1] * wo[:, 0]
        near = np.abs(np.degrees(np.arcsin(np.clip(aside, -1, 1)))) < _IN_PLANE_DEG
        shown = f"{fit.incidence_deg(group):.0f} degrees"
        axes.plot(
            np.degrees(np.arctan2(along, wo[:, 2]))[near], green[near], ".", color=f"C{colour}", label=shown
        )
        degrees, pairs = plane_of_incidence()
        towards = np.radians(fit.incidence_deg(group))
        light = np.broadcast_to([np.sin(towards), 0.0, np.cos(towards)], pairs.incident.shape)
        # `incident` are directions in the xz plane, negative degrees on the other's side: here those of the sensor.
        axes.plot(degrees, brdf_values(fit.solution.brdf, light, pairs.incident)[:, 1], color=f"C{colour}")
    axes.set_yscale("log")
    axes.set(
        xlabel="angle of the sensor (degrees; positive: on the mirrored side)",
        ylabel="BRDF (1/sr), green",
        title=f"samples within {_IN_PLANE_DEG:.0f} degrees of the plane of incidence (dots), fit (lines)",
    )
    axes.legend(title="light at")


def _forms(axes: Axes, fit: MeasuredFit) -> None:
    best = sorted(fit.solution.candidates, key=lambda candidate: candidate.error)[:_FORMS]
    if fit.model not in best:
        best[-1] = fit.model
    names = [candidate.estimate.model.name for candidate in best]
    axes.barh(
        range(len(best)),
        [100 * candidate.error for candidate in best],
        xerr=[100 * candidate.standard_error for candidate in best],
        color=["C0" if candidate is fit.model else "lightgrey" for candidate in best],
    )
    axes.set_yticks(range(len(best)), [fill(name, 24) for name in names], fontsize=8)
    axes.invert_yaxis()
    axes.set(xlabel="error at unseen angles of incidence (% RMS)", title="models (blue: chosen)")


def _scatter(axes: Axes, fit: MeasuredFit) -> None:
    values = fit.samples.rgb
    low = float(np.quantile(values[values > 0], 0.01))
    for channel, colour in enumerate(CHANNELS):
        axes.plot(values[:, channel], fit.predicted[:, channel], ".", markersize=2, color=colour)
    ends = [low, float(values.max())]
    axes.plot(ends, ends, color="black", linewidth=0.8)
    axes.set(xscale="log", yscale="log", xlim=ends, ylim=ends)
    axes.set(xlabel="measured BRDF (1/sr)", ylabel="fitted BRDF (1/sr)", title="all samples")


def _over_half_angle(axes: Axes, fit: MeasuredFit) -> None:
    half = fit.samples.wi + fit.samples.wo
    theta = np.degrees(np.arctan2(np.hypot(half[:, 0], half[:, 1]), half[:, 2]))
    left = (fit.predicted - fit.samples.rgb) * fit.samples.wi[:, 2:]
    for channel, colour in enumerate(CHANNELS):
        axes.plot(theta, left[:, channel], ".", markersize=2, color=colour)
    axes.axhline(0, color="black", linewidth=0.8)
    axes.set(
        xlabel="angle between half vector and normal (degrees)",
        ylabel="fitted - measured, radiance per irradiance",
        title="what is left",
    )


def _by_angle(axes: Axes, fit: MeasuredFit) -> None:
    angles = [fit.incidence_deg(group) for group in fit.groups]
    axes.plot(angles, 100 * fit.errors, "o-", label="fitted")
    axes.plot(angles, 100 * fit.unseen_errors, "o--", label="by a fit without that angle")
    axes.set(xlabel="angle of incidence (degrees)", ylabel="error (% RMS of radiance)", ylim=(0, None))
    axes.set_title("errors by angle of incidence")
    axes.legend()
