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
from invrender.output.report.photos import PhotoReport
from invrender.output.report.pictures import (
    figure_url,
    lighting_figure,
    normals_figure,
    photo_error_figure,
    residual_figure,
    texture_figure,
)
from invrender.result.document import identifiability
from invrender.result.run import Run
from invrender.result.sentences import errors_in_words, filters_in_words, reference_in_words
from invrender.wording import with_error

# Of photographs without pictures, so many are listed with their errors, the worst.
_LISTED = 40
# Lightings whose table is in plain view.
_FEW_LIGHTINGS = 6
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


def write_report(
    path: Path, run: Run, document: Mapping[str, Any], reports: Sequence[PhotoReport], limit: float
) -> None:
    """Write the page of a run as one self-contained file.

    document : result.json, whose errors are those of the pictures. reports : of each photograph, in the set's order.
    limit : share of a photograph's white at which the colours of differences saturate.
    """
    solution = run.solution
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
    first = max(reports, key=lambda report: report.highlight).label
    shown = [report for report in reports if report.pictures is not None]
    shown.sort(key=lambda report: report.label != first)
    rows = [{"score": of_label[report.label], "pictures": report.pictures} for report in shown]
    rest = [of_label[report.label] for report in reports if report.pictures is None]
    rest.sort(key=lambda score: -score.rms)
    textures = run.textures
    # Values at vertices make no picture.
    mapped = textures is not None and isinstance(textures.layout, TexelLayout)
    normals = normals_figure(solution.candidates, solution.chosen)
    page = page_template("invrender.output.report", "report.html.jinja").render(
        document=document,
        misfits=solution.misfits,
        filters=None if run.photoset.extinction is None else filters_in_words(run.photoset.extinction),
        references=[reference_in_words(score) for score in run.references],
        interreflection=run.interreflection,
        model=solution.model.estimate.model,
        form=solution.brdf.form.description,
        best=min(solution.candidates, key=lambda candidate: candidate.error),
        parameters=_parameters(solution),
        rows=rows,
        rest=rest[:_LISTED],
        unlisted=len(rest[_LISTED:]),
        limit=limit,
        mapped=[
            entry.lighting.name for entry in solution.lightings if entry.lighting.radiance_map is not None
        ],
        with_error=with_error,
        many_lightings=_many_lightings(solution.lightings),
        errors=errors_in_words(document["fit"]),
        causes=[(cause, figure_url(cause_figure(cause))) for cause in run.causes],
        figures={
            "residual": figure_url(residual_figure(run.fields, run.residuals)),
            "photos": figure_url(photo_error_figure(scores)),
            "lighting": figure_url(lighting_figure(solution.lightings)),
            "normals": None if normals is None else figure_url(normals),
            "texture": figure_url(texture_figure(textures)) if textures and mapped else None,
        },
    )
    path.write_text(page, encoding="utf-8")


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
