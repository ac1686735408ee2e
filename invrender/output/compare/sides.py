"""Two results, or a result and a truth, compared. No terminal, no files written."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from invrender.output.compare.lightings import LightPair, light_pairs
from invrender.output.compare.tables import comparison_notes, light_text, texts
from invrender.output.compare.textured import over_same_part
from invrender.output.compare.verdicts import Row, number_rows, verdict
from invrender.result.saved import read_result
from invrender.result.side import Side, result_side
from invrender.result.truth import is_truth, truth_side
from invrender.tables import html_list, html_table, text_table

COMPARISON_HEADINGS = ("parameter", "A ± std", "B ± std", "B - A", "z", "verdict")


@dataclass(frozen=True, eq=False, repr=False)
class SideComparison:
    """What a comparison found.

    rows : number by number. lights : lightings that have a counterpart. notes : sentences.
    """

    first: Side
    second: Side
    rows: tuple[Row, ...]
    lights: tuple[LightPair, ...]
    notes: tuple[str, ...]

    @property
    def table(self) -> list[tuple[str, ...]]:
        """The rows' cells, by `COMPARISON_HEADINGS`."""
        return [(row.label, *texts(row), row.verdict) for row in self.rows]

    @property
    def lines(self) -> list[str]:
        """What is to be said beside the table, in sentences."""
        return [self.verdict, *map(light_text, self.lights), *(f"Note: {note}" for note in self.notes)]

    def __str__(self) -> str:
        sides = f"A: {self.first.title}\nB: {self.second.title}"
        return "\n".join([sides, text_table(COMPARISON_HEADINGS, self.table), *self.lines])

    __repr__ = __str__

    def _repr_html_(self) -> str:
        """For notebooks."""
        sides = [f"A: {self.first.title}", f"B: {self.second.title}"]
        return html_table(COMPARISON_HEADINGS, self.table) + html_list([*sides, *self.lines])

    @property
    def verdict(self) -> str:
        """What the rows say together, in a sentence."""
        return verdict(self.rows)


def compare_sides(first: Side, second: Side) -> SideComparison:
    """Two sides compared; means of textures are taken over the same part of the surface where that can be done."""
    matched = over_same_part(first, second)
    a, b = matched.first, matched.second
    lights = light_pairs(a, b)
    notes = [*([matched.note] if matched.note else []), *comparison_notes(a, b, lights)]
    return SideComparison(a, b, number_rows(a, b, matched.unlike), lights, tuple(notes))


def read_side(path: Path) -> Side:
    """A result or a truth; ValueError says what is wrong with the path."""
    return truth_side(path) if is_truth(path) else result_side(read_result(path))
