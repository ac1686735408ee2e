"""A result as one page that a browser opens from disk: the object under light that can be turned."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from markupsafe import Markup

from capture.files.documents import input_hashes, software, write_json
from capture.files.outfolder import result_folder
from capture.progress import Track, silent
from invrender.output.export.exported import EXPORT_FILES, PAGE_FORM
from invrender.output.live.bundle import bundled, page_files
from invrender.output.live.drawn import LiveError, live_error
from invrender.output.live.packed import packed_light, packed_subject
from invrender.output.live.scene import LiveScene, live_scene
from invrender.output.pages import page_template
from invrender.output.render.photographer import photographer
from invrender.output.render.view import DEFAULT_VIEW, View
from invrender.result.saved import SavedResult
from invrender.result.shown import shown_numbers

PAGE_NAME = "object.html"
# Lights that a page holds: each takes one to three megabytes.
_MOST_LIGHTS = 4


@dataclass(frozen=True, eq=False)
class ExportedPage:
    """What was exported. error : of live pictures. notes : sentences."""

    files: tuple[Path, ...]
    error: LiveError
    notes: tuple[str, ...]


def export_page(
    result: SavedResult,
    out: Path,
    *,
    lighting: str | None = None,
    assumed: Mapping[str, float] | None = None,
    view: View | None = None,
    photoset: Path | None = None,
    track: Track = silent,
) -> ExportedPage:
    """Write OUT/object.html, which holds all that it shows, and export.json.

    lighting : one of the result's; all of them, up to four, if None. view : where it is first seen from. ValueError
    where the result leaves something open, or browsers can't draw it.
    """
    names = [entry.name for entry in result.content.lighting]
    chosen = names[:_MOST_LIGHTS] if lighting is None else [result.lighting(lighting).name]
    lightings = [result.read_lighting(result.lighting(name)) for name in chosen]
    studio = photographer(result, lightings[0], photoset, assumed or {})
    scene = live_scene(studio, track(lightings, "Lights"), view or DEFAULT_VIEW)
    error = live_error(scene, studio, lightings, track)
    notes = (*studio.notes, *scene.notes)
    if lighting is None and len(names) > _MOST_LIGHTS:
        notes += (f"The page has {_MOST_LIGHTS} of {len(names)} lightings; --lighting names another.",)
    with result_folder(out, EXPORT_FILES) as folder:
        page = object_page(result, scene, error, notes)
        (folder / PAGE_NAME).write_text(page, encoding="utf-8")
        document = {
            "format": 1,
            "name": result.content.name,
            "exported_as": PAGE_FORM,
            "files": [PAGE_NAME],
            "gauge": result.content.gauge,
            "lightings": chosen,
            "error": {"rms": error.rms, "worst": error.worst},
            "notes": list(notes),
            "inputs": input_hashes([result.path]),
            "software": software(),
        }
        write_json(folder / "export.json", document)
    return ExportedPage((out / PAGE_NAME,), error, notes)


def object_page(result: SavedResult, scene: LiveScene, error: LiveError, notes: Sequence[str]) -> str:
    """The page's text, with a scene of a result and how far its pictures are off."""
    content = result.content
    form = page_template("invrender.output.live", "page/controls.html.jinja").render(
        lights=[light.name for light in scene.lights], has_gaps=scene.kd.has_gaps
    )
    return page_template("invrender.output.export", "object.html.jinja").render(
        name=content.name,
        style=Markup(page_files()["live.css"]),
        script=Markup(bundled("exported")),
        controls=Markup(form),
        numbers=list(shown_numbers(result)),
        model=f"Lobe: {content.brdf.form.description}." if content.brdf.ks else "Matte: no lobe was needed.",
        gauge=content.gauge,
        stated=error.stated,
        notes=notes,
        version=software()["lightfactor"],
        subject=_text(packed_subject(scene)),
        lights=[_text(packed_light(light)) for light in scene.lights],
    )


def _text(data: bytes) -> str:
    return base64.b64encode(data).decode()
