"""stereo.png: normals, their error bars, the albedo, and a photograph beside its prediction."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from capture.figures import short_name
from capture.srgb import linear_to_srgb
from invrender.photometric_stereo.result import StereoResult

if TYPE_CHECKING:
    from matplotlib.figure import Figure


Floats = NDArray[np.float64]
# Pixels around the object that are shown; of values, the share that is within the scale.
_MARGIN, _WITHIN = 3, 0.99


def stereo_figure(result: StereoResult, errors: Sequence[float]) -> Figure:
    """The figure of a result; errors : relative RMS of the set's photographs."""
    from matplotlib.figure import Figure

    photos = result.capture.photoset.photos
    shown = _shown_photo(result, errors)
    normals = result.normal_map
    figure = Figure(figsize=(15, 8.5), layout="constrained")
    panels = figure.subplots(2, 3)
    pictures = (
        ("normals (x right, y up, z to the camera, as colours)", (normals.normals + 1) / 2),
        ("albedo (pi Kd), brightest hundredth white", _toned(result.as_picture(result.solved.surface.kd))),
        (f"photograph {short_name(photos[shown].name)}", _toned(result.as_picture(_radiance(result, shown)))),
        (
            f"prediction, off by {errors[shown]:.1%}"
            + (" (not used in the fit)" if photos[shown].held_out else ""),
            _toned(
                result.as_picture(result.predicted(shown)[0]), result.as_picture(_radiance(result, shown))
            ),
        ),
    )
    for axes, (title, picture) in zip(panels.flat[[0, 1, 3, 4]], pictures, strict=True):
        axes.imshow(np.where(np.isfinite(picture), picture, 1)[_cut(result)])
        axes.set_title(title, fontsize=10)
    if normals.std_deg is not None:
        scaled, title = normals.std_deg, "error bar of the normal (degrees)"
    else:
        kd = result.solved.surface.kd.mean(axis=1)
        share = 100 * result.solved.deviations.kd.mean(axis=1) / np.maximum(kd, 1e-12)
        scaled, title = result.as_picture(share), "error bar of the albedo (percent of it)"
    _scale(figure, panels.flat[2], title, scaled[_cut(result)])
    _scale(
        figure,
        panels.flat[5],
        "depth from the mean (metres)",
        (np.nanmean(result.depths) - result.depths)[_cut(result)],
        1.0,
    )
    for axes in panels.flat:
        axes.set_xticks([])
        axes.set_yticks([])
    return figure


def _scale(figure: Figure, axes: object, title: str, values: Floats, within: float = _WITHIN) -> None:
    top = float(np.nanquantile(values, within))
    image = axes.imshow(values, vmax=top, vmin=0.0 if within < 1 else None, cmap="viridis")  # type: ignore[attr-defined]
    axes.set_title(title, fontsize=10)  # type: ignore[attr-defined]
    figure.colorbar(image, ax=axes, shrink=0.8)  # type: ignore[arg-type]


def _shown_photo(result: StereoResult, errors: Sequence[float]) -> int:
    """The photograph of median error, of the held-out ones where there are any."""
    held_out = result.capture.places(held_out=True)
    among = held_out if len(held_out) else result.capture.places(held_out=False)
    return int(sorted(among, key=lambda place: errors[place])[len(among) // 2])


def _radiance(result: StereoResult, photo: int) -> Floats:
    return np.asarray(result.capture.radiance[:, photo], float)


def _toned(picture: Floats, like: Floats | None = None) -> Floats:
    """A linear picture as sRGB; like : the picture whose white it has, itself unless given."""
    brightest = np.max(picture if like is None else like, axis=2)
    white = max(float(np.nanquantile(brightest, _WITHIN)), 1e-300)
    toned = linear_to_srgb(np.clip(np.nan_to_num(picture) / white, 0, 1))
    return np.where(np.isfinite(picture), toned, np.nan)


def _cut(result: StereoResult) -> tuple[slice, slice]:
    rows, columns = np.nonzero(result.capture.inside)
    return (
        slice(max(rows.min() - _MARGIN, 0), rows.max() + _MARGIN + 1),
        slice(max(columns.min() - _MARGIN, 0), columns.max() + _MARGIN + 1),
    )
