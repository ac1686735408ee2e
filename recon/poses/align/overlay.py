"""A picture to check an alignment by: the mesh's outline drawn over photographs, beside their masks' outlines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from capture.camera import Camera
from capture.figures import short_name
from capture.srgb import linear_to_srgb

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Pixels around the object that are shown, as a share of its size.
_MARGIN = 0.12


@dataclass(frozen=True, eq=False)
class Overlay:
    """One photograph. radiance : (h, w, 3), mesh : (h, w) bool where the mesh is seen, mask : (h, w) or None.

    picks : (k, 2) where they were clicked, and to : (k, 2) where the mesh's points are seen, pixels.
    """

    title: str
    radiance: NDArray[np.floating]
    mesh: NDArray[np.bool_]
    mask: NDArray[np.floating] | None
    picks: NDArray[np.floating]
    to: NDArray[np.floating]


def alignment_figure(overlays: Sequence[Overlay], headline: str) -> Figure:
    """Photographs side by side, each cut to its object."""
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    figure = Figure(figsize=(1 + 4.6 * len(overlays), 5.6), dpi=110, layout="constrained")
    panels = np.atleast_1d(figure.subplots(1, len(overlays)))
    for axes, overlay in zip(panels, overlays, strict=True):
        _draw(axes, overlay)
    panels[0].set_ylabel("row (px)")
    handles = [Line2D([], [], color="magenta", lw=1.2, label="outline of the aligned mesh")]
    if any(overlay.mask is not None for overlay in overlays):
        handles.append(Line2D([], [], color="cyan", lw=1.2, ls="--", label="outline of the mask"))
    if any(len(overlay.picks) for overlay in overlays):
        handles.append(
            Line2D(
                [],
                [],
                color="yellow",
                marker="+",
                ls="-",
                label="pick, and a line to where its point is seen",
            )
        )
    figure.legend(handles=handles, loc="outside lower center", ncols=3, fontsize=9)
    figure.suptitle(headline, fontsize=11)
    return figure


def shown_photos(off: Sequence[float | None]) -> list[tuple[int, str]]:
    """Which photographs to show, of their residuals: the worst, the median and the best, and what each is."""
    ranked = sorted((i for i, value in enumerate(off) if value is not None), key=lambda i: -(off[i] or 0.0))
    if not ranked:
        return []
    chosen = {ranked[0]: "worst"}
    chosen.setdefault(ranked[len(ranked) // 2], "median")
    chosen.setdefault(ranked[-1], "best")
    return list(chosen.items())


def _draw(axes: Axes, overlay: Overlay) -> None:
    height, width = overlay.mesh.shape
    area = overlay.mesh if overlay.mask is None else overlay.mesh | (overlay.mask >= 0.5)
    rows, columns = np.nonzero(area)
    if not len(rows):
        rows, columns = np.array([0, height - 1]), np.array([0, width - 1])
    margin = _MARGIN * max(np.ptp(rows), np.ptp(columns)) + 3
    top, bottom = max(int(rows.min() - margin), 0), min(int(rows.max() + margin) + 1, height)
    left, right = max(int(columns.min() - margin), 0), min(int(columns.max() + margin) + 1, width)
    window = (slice(top, bottom), slice(left, right))
    radiance = np.asarray(overlay.radiance[window], float)
    white = max(float(np.percentile(radiance, 99)), 1e-12)
    # As bright as leaves lines to be seen.
    extent = (left, right, bottom, top)
    axes.imshow(0.85 * linear_to_srgb(np.clip(radiance / white, 0, 1)), extent=extent)
    x, y = np.arange(left, right) + 0.5, np.arange(top, bottom) + 0.5
    if overlay.mask is not None:
        axes.contour(x, y, overlay.mask[window], [0.5], colors="cyan", linewidths=1.2, linestyles="dashed")
    if overlay.mesh[window].any():
        axes.contour(x, y, overlay.mesh[window].astype(float), [0.5], colors="magenta", linewidths=1.0)
    for pick, to in zip(overlay.picks, overlay.to, strict=True):
        axes.plot(*pick, "+", color="yellow", markersize=9)
        if np.isfinite(to).all():
            axes.plot([pick[0], to[0]], [pick[1], to[1]], "-", color="yellow", lw=1)
    axes.set_xlim(left, right)
    axes.set_ylim(bottom, top)
    axes.set_xlabel("column (px)")
    axes.set_title(overlay.title, fontsize=9)


def title_of(label: str, what: str, off_px: float | None, overlap: float | None, camera: Camera) -> str:
    """The title of a photograph's panel."""
    size = f"{camera.width}x{camera.height}"
    if off_px is None:
        return f"{short_name(label)} ({size})"
    share = "" if overlap is None else f", overlap {overlap:.1%}"
    return f"{what}: {short_name(label)} ({size})\noutlines {off_px:.2f} px apart (RMS){share}"
