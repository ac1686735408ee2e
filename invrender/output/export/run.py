"""The command `export` at work: options to files, what is lost on the terminal."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from capture.terminal import console, leave_cleanly_when_stopped, track
from invrender.output.export.document import lost
from invrender.output.export.exported import PAGE_FORM, export_result
from invrender.output.export.html import export_page
from invrender.output.export.material import parse_albedo
from invrender.output.render.run import parse_assumed
from invrender.output.render.view import parse_view
from invrender.result.saved import read_result


@dataclass(frozen=True)
class ExportOptions:
    """The options of the command, as given; see its help."""

    result: Path
    out: Path
    form: str
    light: bool = False
    lighting: str | None = None
    albedo: str | None = None
    assume: tuple[str, ...] = ()
    view: str | None = None
    photoset: Path | None = None


def run_export(options: ExportOptions) -> None:
    """Export what the options ask for and print what a user should know of it."""
    leave_cleanly_when_stopped()
    result = read_result(options.result)
    assumed = parse_assumed(options.assume)
    view = None if options.view is None else parse_view(options.view)
    if options.form == PAGE_FORM:
        _check_page(options)
        page = export_page(
            result,
            options.out,
            lighting=options.lighting,
            assumed=assumed,
            view=view,
            photoset=options.photoset,
            track=track,
        )
        files, said, notes = page.files, [page.error.stated], page.notes
    else:
        exported = export_result(
            result,
            options.out,
            options.form,
            light=options.light,
            lighting=options.lighting,
            albedo=None if options.albedo is None else parse_albedo(options.albedo),
            assumed=assumed,
            view=view,
            photoset=options.photoset,
        )
        files, said, notes = exported.files, lost(exported.mapping), exported.notes
    console.print(
        f"{result.content.name} for {options.form}: {', '.join(map(str, files))}",
        soft_wrap=True,
        markup=False,
    )
    for sentence in said:
        console.print(sentence, markup=False)
    for note in notes:
        console.print(f"Note: {note}", style="yellow", markup=False)


def _check_page(options: ExportOptions) -> None:
    if options.light:
        raise ValueError("--format html: a page always has its light; leave out --light")
    if options.albedo is not None:
        raise ValueError("--format html: object and light keep the result's own scale; leave out --albedo")
