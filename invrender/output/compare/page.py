"""The page of a comparison, one self-contained file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined

from capture.files.documents import software
from invrender.output.compare.lightings import LightPair
from invrender.output.compare.pictures import lights_figure, material_panels, photo_panels
from invrender.output.compare.tables import error_summary, light_text, texts
from invrender.output.compare.verdicts import Row, verdict
from invrender.result.side import Side


def write_page(
    path: Path,
    first: Side,
    second: Side,
    rows: Sequence[Row],
    lights: Sequence[LightPair],
    notes: Sequence[str],
) -> None:
    """Write the page: numbers, lightings, both predictions of the same photographs, both materials in one light."""
    environment = Environment(
        loader=PackageLoader("invrender.output.compare", "."),
        undefined=StrictUndefined,
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    labels = list(dict.fromkeys([*first.photo_errors, *second.photo_errors]))
    errors = [
        (
            label,
            *(
                f"{side.photo_errors[label]:.2%}" if label in side.photo_errors else ""
                for side in (first, second)
            ),
        )
        for label in labels
    ]
    page = environment.get_template("page.html.jinja").render(
        first=first,
        second=second,
        rows=[(row, texts(row)) for row in rows],
        verdict=verdict(rows),
        lights=[light_text(pair) for pair in lights],
        lights_figure=lights_figure(lights) if lights else "",
        photo_panels=list(photo_panels(first, second)),
        material_panels=list(material_panels(first, second, lights)),
        light_name=lights[0].first.lighting.name if lights else "",
        errors=errors,
        summaries=[error_summary(side) for side in (first, second)],
        notes=notes,
        version=software()["lightfactor"],
    )
    path.write_text(page, encoding="utf-8")
