"""Recovered lighting as a picture: both maps beside the truth, how certain they are, which degrees are determined."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from capture.figures import printable
from capture.srgb import linear_to_srgb
from invrender.brdf.microfacet import Microfacet
from invrender.inverse_lighting.coefficients import DETERMINED, UNDETERMINED
from invrender.inverse_lighting.estimate import LightResult
from invrender.inverse_lighting.maps import TrueLight, coefficient_map, coefficient_std_map
from invrender.transport.harmonic_rows import lobe_blur
from recon.harmonics.basis import degree_of, degrees

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

Floats = NDArray[np.float64]

# Zero is drawn as this grey and what is negative darker, as in RH01's fig. 9, so that ringing and noise show.
_ZERO = 0.25
# White is this percentile of the radiance in the direct map.
_WHITE = 99.7


def light_figure(results: Sequence[LightResult]) -> Figure:
    """Two rows of panels per lighting: truth, coefficients, dual; truth blurred, standard deviation, shares."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(15, 6 * len(results)), dpi=90, layout="constrained")
    for part, result in zip(figure.subfigures(len(results), 1, squeeze=False)[:, 0], results, strict=True):
        part.suptitle(printable(result.name))
        panels = part.subplots(2, 3)
        direct = coefficient_map(result.direct.values)
        white = white_level(direct)
        draw_map(panels[0, 1], direct, white, f"coefficients, l ≤ {result.direct.degree}")
        if result.truth is None:
            _say(panels[0, 0], "the truth isn't known")
            panels[1, 0].set_axis_off()
        else:
            draw_map(panels[0, 0], result.truth.radiance_map, white, "truth")
            draw_map(
                panels[1, 0],
                blurred_truth(result.truth, result.brdf),
                white,
                "truth, blurred as the highlight does",
            )
        if result.dual is None:
            _say(panels[0, 2], "no specular part, no dual map")
        else:
            draw_map(panels[0, 2], result.dual.radiance, white, "dual: map and nine coefficients")
            _hatch(panels[0, 2], result.dual.reached)
        _draw_std(part, panels[1, 1], result)
        _draw_shares(panels[1, 2], result)
    return figure


def _say(axes: Axes, text: str) -> None:
    axes.set_axis_off()
    axes.text(0.5, 0.5, text, ha="center", transform=axes.transAxes)


def blurred_truth(truth: TrueLight, brdf: Microfacet) -> Floats:
    """Lat-long map (64, 128, 3) of a light, up to degree 30, as the highlight blurs it, if there is one."""
    if brdf.sigma is None or not brdf.ks.any():
        return coefficient_map(truth.coefficients)
    l_max = degree_of(len(truth.coefficients))
    return coefficient_map(truth.coefficients * lobe_blur(brdf, l_max)[degrees(l_max), None])


def white_level(radiance_map: Floats) -> float:
    """The radiance that is drawn as white."""
    return max(float(np.percentile(radiance_map, _WHITE)), 1e-12)


def draw_map(axes: Axes, radiance_map: Floats, white: float, title: str) -> None:
    """A lat-long map (H, 2H, 3) as RH01 shows them: theta downwards, phi to the right; zero is dark grey."""
    shown = linear_to_srgb(np.clip(radiance_map / white, 0, 1))
    below = np.clip(radiance_map / white, -1, 0)
    axes.imshow(_ZERO + (1 - _ZERO) * shown + _ZERO * below, extent=(0, 360, 180, 0), interpolation="nearest")
    axes.set_title(title)
    _label(axes)


def _draw_std(figure: SubFigure, axes: Axes, result: LightResult) -> None:
    """Standard deviation of the dual map, or of the coefficients' where there is none, directions unreached hatched."""
    dual = result.dual
    std = (coefficient_std_map(result.direct) if dual is None else dual.std).mean(axis=-1)
    image = axes.imshow(std, extent=(0, 360, 180, 0), cmap="viridis", vmin=0, vmax=np.percentile(std, 99))
    figure.colorbar(image, ax=axes, shrink=0.6, label="radiance")
    title = "standard deviation of the coefficients' map"
    if dual is not None:
        title = f"standard deviation of the dual map; {dual.coverage:.0%} of directions reached"
        _hatch(axes, dual.reached)
    axes.set_title(title, fontsize="medium")
    _label(axes)


def _label(axes: Axes) -> None:
    """Ticks and units of a map's directions."""
    axes.set(xticks=range(0, 361, 90), yticks=range(0, 181, 90))
    axes.set_xlabel("azimuth from +X (degrees)", fontsize="small")
    axes.set_ylabel("from +Z (degrees)", fontsize="small")


def _hatch(axes: Axes, reached: NDArray[np.bool_]) -> None:
    """Hatch the directions of a map that no reflection reaches, (H, 2H)."""
    if reached.all():
        return
    degrees_per_row = 180 / len(reached)
    theta, phi = ((np.arange(count) + 0.5) * degrees_per_row for count in reached.shape)
    axes.contourf(phi, theta, (~reached).astype(float), levels=[0.5, 1.5], colors="none", hatches=["///"])


def _draw_shares(axes: Axes, result: LightResult) -> None:
    shares = result.direct.share_per_degree
    axes.bar(np.arange(len(shares)), 100 * shares, color="#0072B2")
    for level, name in ((DETERMINED, "determined"), (UNDETERMINED, "weak")):
        axes.axhline(100 * level, color="#666666", linewidth=0.8)
        axes.annotate(
            name, (1.01, 100 * level), xycoords=("axes fraction", "data"), va="center", fontsize="small"
        )
    axes.set(
        xlabel="degree l",
        ylabel="share determined [%]",
        ylim=(0, 104),
        title="what the photographs determine",
    )
