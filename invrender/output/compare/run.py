"""The command `compare` at work: tables on the terminal, a page on disk."""

from __future__ import annotations

from pathlib import Path

from rich.table import Table

from capture.files.outfolder import result_files
from capture.terminal import console, leave_cleanly_when_stopped
from invrender.output.compare.lightings import LightPair, light_pairs
from invrender.output.compare.page import write_page
from invrender.output.compare.tables import comparison_notes, error_summary, light_text, texts
from invrender.output.compare.textured import over_same_part
from invrender.output.compare.verdicts import Row, number_rows, verdict
from invrender.result.saved import read_result
from invrender.result.side import Side, result_side
from invrender.result.truth import is_truth, truth_side


def run_compare(first: Path, second: Path, page: Path | None) -> None:
    """Compare two results, or a result and a truth, and print what was found."""
    if page is not None and page.suffix.lower() not in (".html", ".htm"):
        raise ValueError(f"-o {page}: the name must end in .html")
    leave_cleanly_when_stopped()
    matched = over_same_part(read_side(first), read_side(second))
    a, b = matched.first, matched.second
    rows, lights = number_rows(a, b, matched.unlike), light_pairs(a, b)
    notes = [*([matched.note] if matched.note else []), *comparison_notes(a, b, lights)]
    if page is not None:
        with result_files(page, inputs=[path for path in (first, second) if path.is_file()]) as folder:
            write_page(folder / page.name, a, b, rows, lights, notes)
    _print(a, b, rows, lights, notes)
    if page is not None:
        console.print(f"Open in a browser: {page}", soft_wrap=True, markup=False)


def read_side(path: Path) -> Side:
    """A result or a truth; ValueError says what is wrong with the path."""
    return truth_side(path) if is_truth(path) else result_side(read_result(path))


def _print(a: Side, b: Side, rows: tuple[Row, ...], lights: tuple[LightPair, ...], notes: list[str]) -> None:
    console.print(f"A: {a.title}\nB: {b.title}", soft_wrap=True, markup=False)
    table = Table()
    for heading in ("parameter", "A ± std", "B ± std", "B - A", "z", "verdict"):
        table.add_column(heading)
    for row in rows:
        table.add_row(row.label, *texts(row), row.verdict)
    console.print(table)
    console.print(verdict(rows), markup=False)
    for pair in lights:
        console.print(light_text(pair), soft_wrap=True, markup=False)
    for name, side in (("A", a), ("B", b)):
        if side.photo_errors:
            console.print(
                f"Photographs' errors in {name}, relative RMS: {error_summary(side)}.", soft_wrap=True
            )
    for note in notes:
        console.print(f"Note: {note}", style="yellow", soft_wrap=True, markup=False)
