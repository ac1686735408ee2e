"""brdf.png: what RH01's Fig. 6 shows: slices of the BRDF, and pictures that a harmonic one makes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from capture.figures import printable
from capture.srgb import linear_to_srgb
from invrender.inverse_brdf.fit import TableFit
from invrender.inverse_brdf.harmonic import HarmonicBRDF
from invrender.inverse_brdf.slices import (
    EXITANT_DEG,
    harmonic_transfer,
    parametric_transfer,
    plane_of_incidence,
    slice_grid,
    table_transfer,
)
from invrender.inverse_brdf.table import BRDFTable

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]

_ROWS, _COLUMNS = 90, 180
_EMPTY = "lightsteelblue"


def harmonic_figure(name: str, brdf: HarmonicBRDF, pictures: Mapping[str, NDArray[np.floating]]) -> Figure:
    """The slice at 63 degrees, its profile with error bars, how the light shows it; and pictures (h, w, 3)."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(14, 8), dpi=110, layout="constrained")
    figure.suptitle(printable(f"{name}: harmonic coefficients of the BRDF up to degree {brdf.order}"))
    grid = figure.add_gridspec(2, 3)
    values = harmonic_transfer(brdf, slice_grid(_ROWS, _COLUMNS))
    draw_slice(figure.add_subplot(grid[0, 0]), values, None, f"order {brdf.order}")
    axes = figure.add_subplot(grid[0, 1])
    degrees, pairs = plane_of_incidence()
    profile = harmonic_transfer(brdf, pairs)[:, 1]
    cos = pairs.exitant[:, 2]
    std = brdf.reciprocal_std(pairs.incident, cos)[:, 1] / cos
    axes.plot(degrees, profile, label=f"order {brdf.order}")
    axes.fill_between(degrees, profile - std, profile + std, alpha=0.3, label="± 1 std")
    dress_profile(axes)
    draw_gains(figure.add_subplot(grid[0, 2]), brdf)
    for column, (title, radiance) in enumerate(pictures.items()):
        draw_picture(figure.add_subplot(grid[1, column]), title, radiance)
    return figure


def brushed_figure(name: str, brdf: HarmonicBRDF, pictures: Mapping[str, NDArray[np.floating]]) -> Figure:
    """How the light shows a brushed surface's BRDF; and pictures (h, w, 3)."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(14, 4), dpi=110, layout="constrained")
    figure.suptitle(printable(f"{name}: harmonic coefficients of a brushed BRDF up to degree {brdf.order}"))
    gains, *panels = figure.subplots(1, 1 + len(pictures))
    draw_gains(gains, brdf)
    for axes, (title, radiance) in zip(panels, pictures.items(), strict=True):
        draw_picture(axes, title, radiance)
    return figure


def draw_gains(axes: Axes, brdf: HarmonicBRDF) -> None:
    """How the light passes each degree of the BRDF on."""
    axes.bar(np.arange(brdf.order + 1), brdf.gains[:, 1], color="C2")
    axes.set(yscale="log", xlabel="degree l", ylabel="gain", title="how the light passes each degree on")
    # Gains often span less than a decade, of which powers of ten say nothing.
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter("{x:g}")


def table_figure(name: str, table: BRDFTable, fit: TableFit) -> Figure:
    """Measured and fitted slices at 63 degrees, their profile, all values over theta_h, and where samples lie."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(14, 8), dpi=110, layout="constrained")
    figure.suptitle(printable(f"{name}: BRDF measured under a single source, and RH01's model fitted to it"))
    grid = figure.add_gridspec(2, 3)
    pairs = slice_grid(_ROWS, _COLUMNS)
    draw_slice(figure.add_subplot(grid[0, 0]), *table_transfer(table, pairs), "measured; blue: no sample")
    draw_slice(figure.add_subplot(grid[0, 1]), parametric_transfer(fit.brdf, pairs), None, "parametric fit")
    axes = figure.add_subplot(grid[0, 2])
    degrees, along = plane_of_incidence()
    values, filled = table_transfer(table, along)
    axes.plot(degrees[filled], values[filled, 1], ".", label="measured")
    axes.plot(degrees, parametric_transfer(fit.brdf, along)[:, 1], label="fit")
    dress_profile(axes)
    axes = figure.add_subplot(grid[1, :2])
    used = table.measured & (table.cos_exitant > 0)
    lobes = (table.values[..., 1] - fit.brdf.kd[1]) * 4 * table.cos_incident * table.cos_exitant
    axes.plot(np.degrees(table.theta_h[used]), lobes[used], ",", color="C0")
    axes.set(xlabel="theta_h (degrees)", ylabel="(rho - Kd) 4 cos theta_i cos theta_o", xlim=(0, 60))
    axes.set_title("what is left of the diffuse part: F S, over the half angle")
    axes = figure.add_subplot(grid[1, 2])
    counts = table.counts.sum(axis=2).astype(float)
    edges = 90 * (np.arange(counts.shape[0] + 1) / counts.shape[0]) ** 2
    across = 90 * np.arange(counts.shape[1] + 1) / counts.shape[1]
    drawn = axes.pcolormesh(across, edges, np.where(counts > 0, counts, np.nan), norm="log")
    axes.set(xlabel="theta_d (degrees)", ylabel="theta_h (degrees)", title="samples")
    axes.set_facecolor(_EMPTY)
    figure.colorbar(drawn, ax=axes)
    return figure


def draw_slice(
    axes: Axes, values: Floats, known: NDArray[np.bool_] | None, title: str, top: float | None = None
) -> None:
    """A slice of `slice_grid`, (rows * columns, 3), green; below zero in red. top : the value drawn white."""
    green = values[:, 1].reshape(_ROWS, _COLUMNS)
    top = top or float(np.quantile(green, 0.999)) or 1.0
    shade = np.clip(green / top, 0, 1)
    colours = np.repeat(linear_to_srgb(shade)[..., None], 3, axis=2)
    colours[green < 0] = 0
    # As deep a red as it is high a white.
    colours[..., 0] = np.where(green < 0, linear_to_srgb(np.clip(-10 * green / top, 0, 1)), colours[..., 0])
    picture: Any = np.dstack([colours, np.ones_like(green) if known is None else known.reshape(green.shape)])
    axes.imshow(picture, extent=(0, 360, 90, 0), aspect="auto", interpolation="nearest")
    axes.set_facecolor(_EMPTY)
    axes.set(xlabel="azimuth of incidence (degrees)", ylabel="angle of incidence (degrees)", title=title)


def dress_profile(axes: Axes) -> None:
    """Labels of a profile in the plane of incidence."""
    axes.axhline(0, color="grey", linewidth=0.8)
    axes.set(
        xlabel="angle of incidence (degrees; negative: on the viewer's side)",
        ylabel="rho cos theta_i (1/sr), green",
        title=f"plane of incidence, exitant angle {EXITANT_DEG:.0f} degrees",
    )
    axes.legend()


def draw_picture(axes: Axes, title: str, radiance: NDArray[np.floating], top: float | None = None) -> None:
    """A picture (h, w, 3) of linear radiance. top : what is drawn white; its 99.5th percentile if None."""
    top = top or float(np.quantile(radiance, 0.995)) or 1.0
    axes.imshow(linear_to_srgb(np.clip(np.asarray(radiance, float) / top, 0, 1)), interpolation="nearest")
    axes.set_title(title)
    axes.set_axis_off()
