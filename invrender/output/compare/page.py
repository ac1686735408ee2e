"""The page of a comparison, one self-contained file."""

from __future__ import annotations

from pathlib import Path

from capture.files.documents import software
from invrender.output.compare.pictures import lights_figure, material_panels, photo_panels
from invrender.output.compare.sides import SideComparison
from invrender.output.compare.tables import error_summary, light_text, texts
from invrender.output.pages import page_template


def write_page(path: Path, found: SideComparison) -> None:
    """Write the page: numbers, lightings, both predictions of the same photographs, both materials in one light."""
    first, second, lights = found.first, found.second, found.lights
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
    page = page_template("invrender.output.compare", "page.html.jinja").render(
        first=first,
        second=second,
        rows=[(row, texts(row)) for row in found.rows],
        verdict=found.verdict,
        lights=[light_text(pair) for pair in lights],
        lights_figure=lights_figure(lights) if lights else "",
        photo_panels=list(photo_panels(first, second)),
        material_panels=list(material_panels(first, second, lights)),
        light_name=lights[0].first.lighting.name if lights else "",
        errors=errors,
        summaries=[error_summary(side) for side in (first, second)],
        notes=found.notes,
        version=software()["lightfactor"],
    )
    path.write_text(page, encoding="utf-8")
