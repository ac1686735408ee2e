"""The command `export` at work: options to files, what is lost on the terminal."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from capture.terminal import console, leave_cleanly_when_stopped
from invrender.output.export.document import lost
from invrender.output.export.exported import export_result
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
    exported = export_result(
        result,
        options.out,
        options.form,
        light=options.light,
        lighting=options.lighting,
        albedo=None if options.albedo is None else parse_albedo(options.albedo),
        assumed=parse_assumed(options.assume),
        view=None if options.view is None else parse_view(options.view),
        photoset=options.photoset,
    )
    console.print(
        f"{result.content.name} for {options.form}: {', '.join(map(str, exported.files))}",
        soft_wrap=True,
        markup=False,
    )
    for sentence in lost(exported.mapping):
        console.print(sentence, markup=False)
    for note in exported.notes:
        console.print(f"Note: {note}", style="yellow", markup=False)
