"""A camera's colour matrix from photographs of a colour chart."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture.chart.chart import Chart, read_chart
from capture.chart.chartsearch import FoundChart, find_chart
from capture.chart.colorfit import LUMINANCE, ColorFit, fit_color
from capture.chart.colorspaces import XYZ_FROM_SRGB, delta_e_2000
from capture.chart.patches import SeenPatches, seen_patches
from capture.decode import Encoding, decode
from capture.radiance import Image
from capture.sensor.flatfield import FlatField

Floats = NDArray[np.float64]

# Mean differences (CIEDE2000) from which on a sentence says so, and from which on the chart is another one.
_POOR, _WRONG = 4.0, 12.0
# Shares: of the light across the chart, of its colour, of glare, and of the exponent.
_UNEVEN, _TINTED, _GLARE, _CURVED = 0.1, 0.03, 0.01, 0.03
# Standard deviations that count as more than chance.
_SURE = 3.0
# Times the misfit of the reference that was given, below which another one fits better.
_BETTER = 0.85
_VINTAGES = ("MCC24", "MCC24-2005")


@dataclass(frozen=True, eq=False)
class ChartPhoto:
    """A photograph of a chart. picture : (h, w, 3), linear camera RGB, at most 1000 pixels across, to look at."""

    path: Path
    grid: FoundChart
    seen: SeenPatches
    picture: Image
    step: int


@dataclass(frozen=True, eq=False)
class ColorRecovery:
    """What photographs of a chart say of a camera's colours.

    named : the chart as it was asked for. rival : another reference that fits better, if one does.
    """

    named: str
    chart: Chart
    photos: tuple[ChartPhoto, ...]
    fit: ColorFit
    rival: str | None

    @cached_property
    def delta_e(self) -> Floats:
        """How far patches are off, (photos, n), CIEDE2000."""
        return np.stack([delta_e_2000(own, self.chart.srgb) for own in self.fit.corrected])

    @cached_property
    def warnings(self) -> list[str]:
        """Sentences on what is wrong with the photographs."""
        found = []
        for k, photo in enumerate(self.photos):
            found += [f"{photo.path.name}: {text}" for text in self._of_photo(k)]
        fit = self.fit
        if abs(fit.exponent - 1) > max(_CURVED, _SURE * fit.exponent_std):
            found.append(
                f"the camera's numbers aren't linear, their power of {fit.exponent:.2f} ± {fit.exponent_std:.2f} would"
                " be: give RAW files, --encoding srgb, or the camera's --response"
            )
        mean = float(self.delta_e.mean())
        if mean > _POOR:
            found.append(
                f"Patches differ from the reference by {mean:.1f} (mean CIEDE2000): the chart may be old or soiled,"
                " its light no daylight, or it is another make"
            )
        if self.rival is not None:
            found.append(
                f"The colours agree better with {self.rival} than with {self.named}: look when the chart was made, and"
                f" give --chart {self.rival} if that is it"
            )
        return found

    def _of_photo(self, k: int) -> list[str]:
        fit, found = self.fit, []
        spread = float(np.ptp(fit.light[k]))
        if spread > _UNEVEN:
            found.append(
                f"light varies by {spread:.0%} over the chart, which is taken into account; light it evenly, and put it"
                " in the middle of the picture"
            )
        tint, std = np.abs(fit.tint[k]).max(axis=1), fit.tint_std[k].max(axis=1)
        if (tint > np.maximum(_TINTED, _SURE * std)).any():
            found.append(
                f"the light's colour changes by {tint.max():.0%} across the chart, which is taken into account; keep"
                " window and lamp from lighting it together"
            )
        glare, its_std = fit.glare[k] @ LUMINANCE, fit.glare_std[k] @ LUMINANCE
        if glare > max(_GLARE, _SURE * its_std):
            found.append(
                f"glare adds {glare:.1%} of white everywhere: shade the lens, and turn the chart away from what it"
                " mirrors"
            )
        return found


def recover_color(
    paths: Iterable[Path], named: str, encoding: Encoding = "linear", flat_field: FlatField | None = None
) -> ColorRecovery:
    """The colour matrix of the camera that photographed a chart, `named` as of `read_chart`.

    paths : one photograph or more, in one light. encoding : of integer files. flat_field : of the lens, divided out.
    ValueError names the photograph in which no chart is found, or in which it is cut off or too small, and says so
    where colours are those of another chart.
    """
    chart = read_chart(named)
    photos = tuple(_read(path, chart, encoding, flat_field) for path in paths)
    seen = [photo.seen for photo in photos]
    fit = fit_color(chart, seen)
    rivals = [name for name in _VINTAGES if named.upper() in _VINTAGES and name != named.upper()]
    better = [name for name in rivals if fit_color(read_chart(name), seen).misfit < _BETTER * fit.misfit]
    found = ColorRecovery(named, chart, photos, fit, next(iter(better), None))
    off = found.delta_e.mean(axis=1)
    if off.max() > _WRONG:
        raise ValueError(
            f"{photos[int(off.argmax())].path}: what is found there differs from {named} by {off.max():.0f} (mean"
            " CIEDE2000), so it is no such chart, or the reference has another order; to see where it was found,"
            " photograph the chart alone, upright"
        )
    return found


def _read(path: Path, chart: Chart, encoding: Encoding, flat_field: FlatField | None) -> ChartPhoto:
    image = decode(path, encoding, flat_field=flat_field)
    try:
        grid = find_chart(image.radiance, chart)
        seen = seen_patches(image, grid)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    if seen.cut_off.any():
        names = [chart.names[k] for k in np.flatnonzero(seen.cut_off)]
        said = (
            f"patch {names[0]!r} is"
            if len(names) == 1
            else f"{len(names)} patches, {names[0]!r} among them, are"
        )
        raise ValueError(f"{path}: {said} saturated: expose less")
    step = max(1, max(image.radiance.shape[:2]) // 1000)
    return ChartPhoto(path, grid, seen, np.array(image.radiance[::step, ::step]), step)


def color_document(recovery: ColorRecovery) -> dict[str, Any]:
    """The numbers of a color.json."""
    fit, chart = recovery.fit, recovery.chart
    return {
        "format": 1,
        "kind": "color",
        "unit": "matrix: linear sRGB (D65) of linear camera RGB; a neutral surface in the chart's light keeps its"
        " green",
        "chart": {"name": recovery.named, "layout": chart.layout},
        "matrix": fit.matrix.tolist(),
        "matrix_std": np.sqrt(np.diag(fit.covariance)).reshape(3, 3).tolist(),
        "covariance": fit.covariance.tolist(),
        "matrix_xyz": (XYZ_FROM_SRGB @ fit.matrix).tolist(),
        "white_balance": (1 / fit.neutral).tolist(),
        "exponent": fit.exponent,
        "exponent_std": fit.exponent_std,
        "delta_e_2000": {"mean": float(recovery.delta_e.mean()), "max": float(recovery.delta_e.max())},
        "photos": [_photo(recovery, k) for k in range(len(recovery.photos))],
        "warnings": recovery.warnings,
    }


def _photo(recovery: ColorRecovery, k: int) -> dict[str, Any]:
    fit, photo = recovery.fit, recovery.photos[k]
    return {
        "file": photo.path.name,
        "light_range": float(np.ptp(fit.light[k])),
        "light_slope": fit.slope[k].tolist(),
        "light_slope_std": fit.slope_std[k].tolist(),
        "glare": fit.glare[k].tolist(),
        "glare_std": fit.glare_std[k].tolist(),
        "patches": [
            {
                "name": name,
                "camera": rgb.tolist(),
                "camera_std": std.tolist(),
                "corrected": corrected.tolist(),
                "reference": reference.tolist(),
                "delta_e_2000": float(off),
            }
            for name, rgb, std, corrected, reference, off in zip(
                recovery.chart.names,
                photo.seen.rgb,
                photo.seen.std,
                fit.corrected[k],
                recovery.chart.srgb,
                recovery.delta_e[k],
                strict=True,
            )
        ],
    }
