"""factor.png: recovered light, the BRDF's numbers with error bars, and photographs beside their predictions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from capture.figures import printable, short_name
from capture.lighting import Lighting
from capture.photo import Photo
from capture.photoset import PhotoSet
from capture.radiance import CHANNELS
from invrender.estimate.quantities import FittedLighting, Quantity
from invrender.estimate.solution import Solution
from invrender.factor.given import Given
from invrender.inverse_lighting.figure import draw_map, white_level
from invrender.inverse_lighting.maps import coefficient_map, true_light
from invrender.output.report.pictures import difference_picture, tone_mapped
from invrender.output.report.pictures import white_level as white_of_photo
from invrender.result.run import Prediction, Run
from recon.harmonics.basis import degree_of, to_degree

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]

_COLOURS = ("#d1242f", "#1a7f37", "#0969da")
# Differences saturate at so many times the least error of the pictures, which are cut out with so many pixels around.
_DEVIATIONS, _MARGIN = 4.0, 3


@dataclass(frozen=True, eq=False)
class ShownPhoto:
    """A photograph, cut out around the object: observed and predicted (h, w, 3), and where it is predicted (h, w).

    error : of the picture, relative RMS.
    """

    label: str
    held_out: bool
    error: float
    observed: Floats
    predicted: Floats
    inside: NDArray[np.bool_]

    @staticmethod
    def of(prediction: Prediction) -> ShownPhoto:
        rows, columns = np.nonzero(prediction.inside)
        cut = np.s_[
            max(rows.min() - _MARGIN, 0) : rows.max() + _MARGIN + 1,
            max(columns.min() - _MARGIN, 0) : columns.max() + _MARGIN + 1,
        ]
        return ShownPhoto(
            prediction.photo.label,
            prediction.photo.held_out,
            prediction.error.rms,
            prediction.observed.radiance[cut].astype(float),
            prediction.predicted[cut].astype(float),
            prediction.inside[cut],
        )


def pictured(photoset: PhotoSet, scores: Sequence[Mapping[str, Any]]) -> list[Photo]:
    """The fitted photographs that are predicted worst and typically, and the worst of those held out, if any.

    scores : the photographs in result.json, with the errors of their pictures.
    """
    errors = {score["file"]: score["rms_relative"] for score in scores}
    ranked = sorted(photoset.photos, key=lambda photo: errors[photo.label])
    fitted = [photo for photo in ranked if not photo.held_out]
    held_out = [photo for photo in ranked if photo.held_out]
    chosen = (fitted[-1], fitted[(len(fitted) - 1) // 2], *held_out[-1:])
    return list({photo.label: photo for photo in chosen}.values())


def factor_figure(run: Run, given: Given, photos: Sequence[ShownPhoto]) -> Figure:
    """Maps and numbers in the first row, then a row per photograph; what is given is drawn beside what was found."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(14, 3.7 + 2.9 * len(photos)), dpi=90, layout="constrained")
    figure.suptitle(printable(f"{run.photoset.name}: light and BRDF from the same photographs"))
    top, *rows = figure.subfigures(
        1 + len(photos), 1, squeeze=False, height_ratios=[3.4] + [2.9] * len(photos)
    )[:, 0]
    (entry,) = run.solution.lightings
    panels = top.subplots(1, 3 if given.light is None else 4)
    assert entry.harmonics is not None
    slow = coefficient_map(entry.harmonics.coefficients)
    white = white_level(slow)
    degree = degree_of(len(entry.harmonics.coefficients))
    draw_map(panels[0], slow, white, f"recovered light, l ≤ {degree}, lamps")
    _draw_sources(panels[0], entry.lighting)
    if given.light is not None:
        _draw_given(panels[1], given, entry, degree)
    for axes in panels[:-2]:
        axes.set(xlabel="azimuth from +X (degrees)", ylabel="polar angle from +Z (degrees)")
    _draw_shares(panels[-2], run.solution, given)
    _draw_scalars(panels[-1], run.solution, given)
    limit = max(_DEVIATIONS * min(shown.error for shown in photos), 1e-6)
    for row, shown in zip(rows, photos, strict=True):
        _draw_photo(row.subplots(1, 3), shown, limit)
    return figure


def _draw_sources(axes: Axes, lighting: Lighting) -> None:
    x, y, z = lighting.directions.T
    azimuth, polar = np.degrees(np.arctan2(y, x)) % 360, np.degrees(np.arccos(np.clip(z, -1, 1)))
    axes.plot(azimuth, polar, "*", color="#f5b301", mec="black", mew=0.6, ms=11)


def _draw_given(axes: Axes, given: Given, entry: FittedLighting, degree: int) -> None:
    """The given light without its sources, up to the same degree, each channel in the recovered light's scale."""
    assert given.light is not None
    assert entry.harmonics is not None
    bare = Lighting("bare", given.light.radiance_map, np.zeros((0, 3)), np.zeros((0, 3)))
    coefficients = to_degree(true_light(bare).coefficients, degree)
    found = entry.harmonics.coefficients
    power = (coefficients**2).sum(axis=0)
    scale = (coefficients * found).sum(axis=0) / np.where(power > 0, power, 1)
    shown = coefficient_map(coefficients * scale)
    draw_map(axes, shown, white_level(coefficient_map(found)), f"given light, l ≤ {degree}")
    _draw_sources(axes, given.light)


def _draw_shares(axes: Axes, solution: Solution, given: Given) -> None:
    """Ks / (Kd + Ks) per channel."""
    quantity = solution.quantities.get("ks_normalised")
    truth = given.numbers.get("ks_normalised")
    axes.set_title("Ks / (Kd + Ks)")
    _draw_number(axes, quantity, truth)
    axes.set(xticks=range(3), xticklabels=CHANNELS, xlim=(-0.6, 2.6))


def _draw_scalars(axes: Axes, solution: Solution, given: Given) -> None:
    """mu on the left scale, sigma on the right."""
    axes.set_title("μ and σ (radians)")
    right = axes.twinx()
    for place, (name, own) in enumerate((("mu", axes), ("sigma", right))):
        _draw_number(own, solution.quantities.get(name), given.numbers.get(name), place)
    axes.set(xticks=(0, 1), xticklabels=["μ (left)", "σ (right)"], xlim=(-0.6, 1.6))


def _draw_number(axes: Axes, quantity: Quantity | None, truth: Floats | None, first: int = 0) -> None:
    """Values with error bars of two standard deviations, and what is given as lines."""
    if truth is not None:
        places = first + np.arange(len(truth))
        axes.hlines(truth, places - 0.3, places + 0.3, color="#24292f", ls="--", label="given")
    if quantity is None or quantity.value is None or quantity.std is None:
        axes.text(
            first, 0.5, "undetermined" if quantity else "not needed", rotation=90, va="center", ha="center",
            transform=axes.get_xaxis_transform(),
        )  # fmt: skip
        return
    std = np.nan_to_num(quantity.std)
    colours = _COLOURS if len(quantity.value) == 3 else ("#24292f",)
    for place, (value, error, colour) in enumerate(zip(quantity.value, std, colours, strict=True)):
        axes.errorbar(first + place, value, 2 * error, fmt="o", color=colour, ms=4, capsize=5)
    # Room, where error bars are too small to see.
    low, high = axes.get_ylim()
    middle, half = (low + high) / 2, max((high - low) / 2, 1e-3 * float(np.abs(quantity.value).max()))
    axes.set_ylim(middle - 1.2 * half, middle + 1.2 * half)


def _draw_photo(panels: Sequence[Axes], shown: ShownPhoto, limit: float) -> None:
    """Photograph, prediction and difference, which saturates at `limit`, relative to the photograph's radiance."""
    observed = np.where(shown.inside[..., None], shown.observed, 0)
    white = white_of_photo(observed[shown.inside])
    scale = float(np.sqrt(np.mean(observed[shown.inside] ** 2)))
    difference = (observed - shown.predicted).mean(axis=2)
    name = short_name(shown.label) + (", held out" if shown.held_out else "")
    off = f"predicted, off by {shown.error:.1%} RMS"
    pictures = (
        (f"photograph {name}", tone_mapped(observed, white)),
        (off, tone_mapped(shown.predicted, white)),
        (
            f"difference, ±{limit:.1%} of RMS radiance",
            difference_picture(difference, limit * scale, shown.inside),
        ),
    )
    for axes, (title, picture) in zip(panels, pictures, strict=True):
        axes.imshow(picture, interpolation="nearest")
        axes.set_title(title, fontsize="medium")
        axes.set_axis_off()
