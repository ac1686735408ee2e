"""The command `compare` at work: tables on the terminal, a page on disk."""

from __future__ import annotations

from pathlib import Path

from rich.table import Table

from capture.files.outfolder import result_files
from capture.terminal import console, leave_cleanly_when_stopped
from invrender.output.compare.page import write_page
from invrender.output.compare.sides import COMPARISON_HEADINGS, SideComparison, compare_sides, read_side
from invrender.output.compare.tables import error_summary, light_text


def run_compare(first: Path, second: Path, page: Path | None) -> None:
    """Compare two results, or a result and a truth, and print what was found."""
    if page is not None and page.suffix.lower() not in (".html", ".htm"):
        raise ValueError(f"-o {page}: the name must end in .html")
    leave_cleanly_when_stopped()
    found = compare_sides(read_side(first), read_side(second))
    if page is not None:
        with result_files(page, inputs=[path for path in (first, second) if path.is_file()]) as folder:
            write_page(folder / page.name, found)
    _print(found)
    if page is not None:
        console.print(f"Open in a browser: {page}", soft_wrap=True, markup=False)


def _print(found: SideComparison) -> None:
    a, b = found.first, found.second
    console.print(f"A: {a.title}\nB: {b.title}", soft_wrap=True, markup=False)
    table = Table(*COMPARISON_HEADINGS)
    for cells in found.table:
        table.add_row(*cells)
    console.print(table)
    console.print(found.verdict, markup=False)
    for pair in found.lights:
        console.print(light_text(pair), soft_wrap=True, markup=False)
    for name, side in (("A", a), ("B", b)):
        if side.photo_errors:
            console.print(
                f"Photographs' errors in {name}, relative RMS: {error_summary(side)}.", soft_wrap=True
            )
    for note in found.notes:
        console.print(f"Note: {note}", style="yellow", soft_wrap=True, markup=False)
