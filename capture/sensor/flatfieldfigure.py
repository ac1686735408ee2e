"""A flat field as a picture: the illumination, its profile along the radius, and what the model leaves."""

from __future__ import annotations

from typing import Any

import numpy as np

from capture.radiance import CHANNELS
from capture.sensor.flatfield import FlatFieldMap, half_diagonal
from capture.sensor.flatrecovery import FlatFieldRecovery

_COLOURS = ("#c8372d", "#2c8a3d", "#2b5fb8")


def flat_field_figure(recovery: FlatFieldRecovery) -> Any:
    """A matplotlib Figure: map of the green channel, profile over the radius, and residuals of the tiles."""
    from matplotlib.figure import Figure

    tiles, fit, radial = recovery.tiles, recovery.fit, recovery.radial
    figure = Figure(figsize=(13, 4.2), dpi=110, layout="constrained")
    picture, profile, rest = figure.subplots(1, 3)
    illumination = recovery.flat_field.gain(tiles.width, tiles.height)
    extent = (0, tiles.width, tiles.height, 0)
    shown = picture.imshow(illumination[..., 1], extent=extent, cmap="viridis", interpolation="nearest")
    lines = picture.contour(
        np.linspace(0, tiles.width, 80), np.linspace(0, tiles.height, 80),
        radial.gain(tiles.width, tiles.height)[_even(tiles.height)][:, _even(tiles.width), 1],
        colors="white", linewidths=0.7,
    )  # fmt: skip
    picture.clabel(lines, fontsize=7)
    picture.plot(*radial.centre, "+", color="white", ms=9)
    picture.set_title("relative illumination, green; + centre", fontsize=9)
    figure.colorbar(shown, ax=picture, shrink=0.8)

    # Each tile of all photographs, without its photograph's level and gradient: the lens and what is left.
    offset = (tiles.position - fit.numbers[:2]).mean(axis=1)
    radius = np.linalg.norm(offset, axis=1)
    powers = radius[:, None] ** (2 * np.arange(1, radial.coefficients.shape[1] + 1))
    lens = 1 + powers @ radial.coefficients.T
    measured = np.exp(fit.residual.mean(axis=0)) * lens
    order = np.argsort(radius)
    for channel, (colour, name) in enumerate(zip(_COLOURS, CHANNELS, strict=True)):
        profile.plot(radius, measured[:, channel], ".", ms=4 - channel, color=colour, alpha=0.5)
        profile.plot(radius[order], lens[order, channel], color=colour, lw=3 - channel, label=name)
    profile.set_title("tiles (dots, mean of the photographs) and polynomial (lines)", fontsize=9)
    profile.set_xlabel("distance from the centre (half diagonals)", fontsize=8)
    profile.set_ylabel("illumination relative to the centre", fontsize=8)
    profile.grid(alpha=0.25)
    profile.legend(fontsize=7)

    left = 100 * fit.residual.mean(axis=(0, 2)).reshape(tiles.grid)
    limit = max(float(np.quantile(np.abs(left), 0.99)), 1e-3)
    border = half_diagonal(tiles.width, tiles.height) * tiles.position
    middle = (tiles.width / 2, tiles.height / 2)
    corners = border.reshape(-1, 2).min(axis=0) + middle, border.reshape(-1, 2).max(axis=0) + middle
    drawn = rest.imshow(
        left,
        extent=(corners[0][0], corners[1][0], corners[1][1], corners[0][1]),
        cmap="RdBu",
        vmin=-limit,
        vmax=limit,
    )
    rest.set_title("what the polynomial leaves: dust, marks, texture", fontsize=9)
    figure.colorbar(drawn, ax=rest, shrink=0.8, label="measured / polynomial - 1 (%)")
    for axis in (picture, rest):
        axis.set_xlabel("column (pixels)", fontsize=8)
        axis.set_ylabel("row (pixels)", fontsize=8)
    for axis in (picture, profile, rest):
        axis.tick_params(labelsize=7)
    kind = "map" if isinstance(recovery.flat_field, FlatFieldMap) else f"radial, {fit.model.order} orders"
    photos = "one photograph" if len(recovery.photos) == 1 else f"{len(recovery.photos)} photographs"
    figure.suptitle(f"Flat field of {tiles.width}x{tiles.height} px from {photos}: {kind}", fontsize=10)
    return figure


def _even(size: int) -> Any:
    return np.linspace(0, size - 1, 80).round().astype(int)
