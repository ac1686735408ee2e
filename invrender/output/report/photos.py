"""What the report has of each photograph: its prediction, how far off it is, and for some of them pictures."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from capture.files.imagefile import write_exr
from capture.photo import Photo
from invrender.estimate.evidence import PictureError
from invrender.output.report.pictures import difference_picture, image_url, shrunk, tone_mapped, white_level
from invrender.result.run import Prediction, Run

_MARGIN = 0.08
# Photographs that have pictures, evenly taken of all, and of those that are held out: the page stays small.
_PICTURED, _HELD_OUT = 24, 12
# Of the others, so many whose highlights are predicted worst.
_WORST = 3
# Shares of a photograph's white at which the colours of differences saturate.
_LIMITS = (0.02, 0.05, 0.1, 0.2, 0.5)


@dataclass(frozen=True)
class PhotoReport:
    """What the report has of a photograph. predicted : an EXR file. pictures : data URLs by what they show, or None."""

    label: str
    error: PictureError
    predicted: bytes
    pictures: Mapping[str, str] | None

    @property
    def highlight(self) -> float:
        """How far the prediction is off where the photograph is brightest."""
        return self.error.rms**2 * self.error.brightest


@dataclass(frozen=True, eq=False)
class Reporting:
    """Predicts photographs for a report. limit : share of a photograph's white at which differences saturate."""

    run: Run
    limit: float

    @classmethod
    def of(cls, run: Run) -> Reporting:
        # One colour scale for all differences, wide enough for three times the usual residual.
        rms = run.rms(held_out=False) or 0.0
        return cls(run, next((limit for limit in _LIMITS if limit >= 3 * rms), _LIMITS[-1]))

    def __call__(self, item: tuple[Photo, bool]) -> PhotoReport:
        """A photograph's report, and whether it is to have pictures."""
        photo, with_pictures = item
        prediction = self.run.predict(photo)
        with tempfile.TemporaryDirectory(prefix="lightfactor-") as folder:
            file = Path(folder) / "predicted.exr"
            write_exr(file, prediction.predicted)
            predicted = file.read_bytes()
        pictures = _pictures(prediction, self.limit) if with_pictures else None
        return PhotoReport(photo.label, prediction.error, predicted, pictures)


def pictured(photos: Sequence[Photo]) -> set[str]:
    """Labels of the photographs that have pictures in a report whatever they look like."""
    held_out = [photo for photo in photos if photo.held_out]
    return {photo.label for photo in (*_evenly(photos, _PICTURED), *_evenly(held_out, _HELD_OUT))}


def worst(reports: Sequence[PhotoReport]) -> set[str]:
    """Labels of those without pictures that deserve some: their highlights are predicted worst of all."""
    ranked = sorted(reports, key=lambda report: -report.highlight)[:_WORST]
    return {report.label for report in ranked if report.pictures is None}


def _evenly(photos: Sequence[Photo], most: int) -> list[Photo]:
    chosen = np.unique(np.linspace(0, len(photos) - 1, min(len(photos), most)).astype(int))
    return [photos[k] for k in chosen]


def _pictures(prediction: Prediction, limit: float) -> dict[str, str]:
    rows, columns = np.nonzero(prediction.inside)
    margin = int(_MARGIN * max(np.ptp(rows), np.ptp(columns))) + 1
    top, left = max(rows.min() - margin, 0), max(columns.min() - margin, 0)
    crop = np.s_[top : rows.max() + margin + 1, left : columns.max() + margin + 1]
    observed = prediction.observed.radiance[crop].astype(float)
    predicted, inside = prediction.predicted[crop].astype(float), prediction.inside[crop]
    white = white_level(observed[inside])
    difference = (observed - predicted).mean(axis=2)
    pictures = {
        "photograph": tone_mapped(observed, white),
        "prediction": tone_mapped(predicted, white),
        "difference": difference_picture(difference, limit * white, inside),
    }
    return {name: image_url(shrunk(picture), jpeg=name != "difference") for name, picture in pictures.items()}
