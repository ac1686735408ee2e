"""The report page, filled photograph by photograph."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from invrender.estimate.quantities import FittedLighting, Quantity, limits
from invrender.estimate.solution import Solution
from invrender.estimate.textured.layout import TexelLayout
from invrender.output.pages import page_template
from invrender.output.report.causefigure import cause_figure
from invrender.output.report.pictures import (
    difference_picture,
    figure_url,
    image_url,
    lighting_figure,
    normals_figure,
    photo_error_figure,
    residual_figure,
    shrunk,
    texture_figure,
    tone_mapped,
    white_level,
)
from invrender.result.document import errors_in_words, identifiability
from invrender.result.run import Prediction, Run
from invrender.wording import with_error

# Photographs beyond this many are listed with their errors, without pictures: the page stays small.
_MAX_PICTURES = 24
_MARGIN = 0.08
# Lightings whose table is in plain view.
_FEW_LIGHTINGS = 6
# Shares of a photograph's white at which the colours of differences saturate.
_LIMITS = (0.02, 0.05, 0.1, 0.2, 0.5)
_NAMES = {
    "kd": ("K<sub>d</sub>", "1/sr"),
    "ks": ("K<sub>s</sub>", ""),
    "mu": ("μ", "refractive index"),
    "sigma": ("σ", "rad"),
    "coat": ("coat", "share of grazing light that it keeps out"),
    "haze": ("haze", "share of the highlight"),
    "spread": ("spread", "width of the haze over the core's"),
    "beyond": ("share beyond σ", "of the highlight, in lobes wider than σ"),
    "beyond_2": ("share beyond 2σ", "of that, in lobes wider than 2σ"),
    "beyond_4": ("share beyond 4σ", "of that, in lobes wider than 4σ"),
    "beyond_8": ("share beyond 8σ", "of that, in lobes wider than 8σ"),
    "stretch": (
        "α<sub>x</sub> / α<sub>y</sub>",
        "width of highlights along the brushing over that across it",
    ),
    "alpha_x": ("α<sub>x</sub>", "rad, along the brushing"),
    "alpha_y": ("α<sub>y</sub>", "rad, across the brushing"),
    "exponent": ("s", "Phong's exponent"),
    "albedo": ("albedo", "π K<sub>d</sub>"),
    "kd_normalised": ("K<sub>d</sub> / (K<sub>d</sub> + K<sub>s</sub>)", ""),
    "ks_normalised": ("K<sub>s</sub> / (K<sub>d</sub> + K<sub>s</sub>)", ""),
}


class ReportWriter:
    """Collects the predictions of a run, then writes its page."""

    def __init__(self, run: Run) -> None:
        self._run = run
        self._rows: list[dict[str, Any]] = []
        # One colour scale for all differences, wide enough for three times the usual residual.
        rms = run.rms(held_out=False) or 0.0
        self._limit = next((limit for limit in _LIMITS if limit >= 3 * rms), _LIMITS[-1])
        photos = run.photoset.photos
        chosen = np.unique(np.linspace(0, len(photos) - 1, min(len(photos), _MAX_PICTURES)).astype(int))
        self._pictured = {photos[k].label for k in chosen} | {
            photo.label for photo in photos if photo.held_out
        }

    def add(self, prediction: Prediction) -> None:
        """Take in one photograph with its prediction; nothing of its size is kept."""
        label, error = prediction.photo.label, prediction.error
        row: dict[str, Any] = {"label": label, "pictures": None, "highlight": error.rms**2 * error.brightest}
        worst = max(self._rows, key=lambda other: other["highlight"], default=row)
        if row["highlight"] >= worst["highlight"]:
            # The photograph with the worst highlight so far has pictures, whichever it is.
            if worst["label"] not in self._pictured:
                worst["pictures"] = None
            row["pictures"] = _pictures(prediction, self._limit)
        elif label in self._pictured:
            row["pictures"] = _pictures(prediction, self._limit)
        self._rows.append(row)

    def write(self, path: Path, document: Mapping[str, Any]) -> None:
        """Write the page as one self-contained file; document : result.json, whose errors are those of the pictures."""
        run, solution = self._run, self._run.solution
        errors = {photo["file"]: photo for photo in document["photos"]}
        scores = [
            replace(
                score,
                rms=errors[score.label]["rms_relative"],
                cross_validated=errors[score.label]["cross_validated_rms_relative"],
            )
            for score in run.scores
        ]
        of_label = {score.label: score for score in scores}
        rows = [{**row, "score": of_label[row["label"]]} for row in self._rows]
        worst = max(row["highlight"] for row in rows)
        rows.sort(key=lambda row: row["highlight"] < worst)
        textures = run.textures
        # Values at vertices make no picture.
        mapped = textures is not None and isinstance(textures.layout, TexelLayout)
        normals = normals_figure(solution.candidates, solution.chosen)
        page = page_template("invrender.output.report", "report.html.jinja").render(
            document=document,
            misfits=solution.misfits,
            interreflection=run.interreflection,
            model=solution.model.estimate.model,
            form=solution.brdf.form.description,
            best=min(solution.candidates, key=lambda candidate: candidate.error),
            parameters=_parameters(solution),
            rows=rows,
            limit=self._limit,
            mapped=[
                entry.lighting.name for entry in solution.lightings if entry.lighting.radiance_map is not None
            ],
            with_error=with_error,
            many_lightings=_many_lightings(solution.lightings),
            errors=errors_in_words(document["fit"]),
            causes=[(cause, figure_url(cause_figure(cause))) for cause in run.causes],
            figures={
                "residual": figure_url(residual_figure(self._run.fields, self._run.residuals)),
                "photos": figure_url(photo_error_figure(scores)),
                "lighting": figure_url(lighting_figure(solution.lightings)),
                "normals": None if normals is None else figure_url(normals),
                "texture": figure_url(texture_figure(textures)) if textures and mapped else None,
            },
        )
        path.write_text(page, encoding="utf-8")


def _pictures(prediction: Prediction, limit: float) -> dict[str, Any]:
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


def _many_lightings(entries: Sequence[FittedLighting]) -> str | None:
    """What lightings have in common, in a sentence, where they are too many for a table in plain view."""
    if len(entries) <= _FEW_LIGHTINGS:
        return None
    recovered = sum(bool(entry.lighting.recovers) or entry.harmonics is not None for entry in entries)
    made = f"{recovered} of them recovered" if recovered else "all given"
    turned = sum(entry.lighting.directions_found for entry in entries)
    if turned:
        made += f", sources of {turned} of them turned to where highlights lie"
    said = f"{len(entries)} lightings, {made}"
    directions = np.concatenate([entry.lighting.directions for entry in entries])
    if not len(directions):
        return f"{said}, without directional sources."
    strength = np.concatenate([entry.lighting.irradiances.mean(axis=1) for entry in entries])
    mean = directions.mean(axis=0)
    mean /= max(float(np.linalg.norm(mean)), 1e-9)
    off = np.degrees(np.arccos(np.clip(directions @ mean, -1, 1))).max()
    return (
        f"{said}, with {len(directions)} directional sources up to {off:.0f} degrees from their mean direction"
        f" ({', '.join(f'{value:.2f}' for value in mean)}); irradiance (mean of channels)"
        f" {strength.min():.3g} to {strength.max():.3g}."
    )


def _parameters(solution: Solution) -> list[dict[str, Any]]:
    """Rows of the parameter table: symbol, unit, values with errors, status, reason, remedy."""
    reasons = {row["parameter"]: row for row in identifiability(solution)}
    table: list[dict[str, Any]] = []
    said: dict[str, str] = {}
    absent = "undetermined" if solution.misfits else "not needed"
    for name, (symbol, unit) in _NAMES.items():
        quantity = solution.quantities.get(name)
        if quantity is None and name not in reasons:
            continue
        if not solution.is_absolute and name in ("kd", "ks"):
            unit = "relative"
        row = reasons.get(name, {"reason": "", "remedy": ""})
        repeated = said.get(row["reason"], "") if row["reason"] else ""
        said.setdefault(row["reason"], symbol)
        table.append(
            {
                "symbol": symbol,
                "unit": unit,
                "as_for": repeated,
                "values": _values(quantity),
                "status": quantity.status if quantity else absent,
                "limits": limits(quantity.shares) if quantity else "",
                "reason": row["reason"],
                "remedy": row["remedy"],
            }
        )
    return table


def _values(quantity: Quantity | None) -> list[str]:
    if quantity is None or quantity.value is None or quantity.std is None:
        return []
    return [with_error(value, std) for value, std in zip(quantity.value, quantity.std, strict=True)]
