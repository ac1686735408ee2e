"""docs/papers/README.md: the index of all figures and tables, and a section for each."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.kept import Kept
from benchmarks.papers.catalogue import ENTRIES, PAPERS
from benchmarks.papers.entry import Entry

_HEAD = """# The papers' figures and tables

`python -m benchmarks.papers` draws every numbered figure and table of RH01 (Ramamoorthi and Hanrahan 2001), of R02
(Ramamoorthi 2002), chapters 2 and 5, and of RMB07 (Ramamoorthi et al. 2007) up to section 4.5, from scratch.
`python -m benchmarks.papers NAME ...` draws some. All of them take some 25 minutes on two cores.

The papers photographed objects that nobody else has. Here `synthetic` photographs objects with the numbers that RH01
found. It integrates by brute force, shares no formula with the fits, and adds 1% of noise. So the truth is known."""


def write_index(path: Path, kept: Kept) -> None:
    """Write the page from what has been drawn so far."""
    lines = [_HEAD]
    for paper, title in PAPERS.items():
        own = [entry for entry in ENTRIES.values() if entry.name.startswith(paper)]
        lines += [
            "",
            f"## {title}",
            "",
            "| name | shows | printed | ours | seconds |",
            "|---|---|---|---|---:|",
        ]
        lines += [_row(entry, kept.get(entry.name)) for entry in own]
    for entry in ENTRIES.values():
        if entry.name in kept:
            lines += _section(entry, kept[entry.name])
    path.write_text("\n".join([*lines, "", f"Drawn on {kept.caption}."]) + "\n", encoding="utf-8")


def _row(entry: Entry, drawn: Mapping[str, Any] | None) -> str:
    if entry.draw is None:
        return f"| {entry.name} | {entry.shows} | | {entry.reason} | |"
    if drawn is None:
        return f"| {entry.name} | {entry.shows} | | not drawn yet | |"
    link = f"[{entry.name}](#{_anchor(entry)})"
    return f"| {link} | {entry.shows} | {drawn['printed']} | {drawn['ours']} | {drawn['seconds']:.0f} |"


def _section(entry: Entry, drawn: Mapping[str, Any]) -> Iterator[str]:
    yield from ("", f"### {entry.name}: {entry.shows}", "", drawn["remark"])
    if drawn["picture"]:
        yield from ("", f"![{entry.shows}]({drawn['picture']})")
    if drawn["table"]:
        yield ""
        yield from _table(drawn["table"])


def _table(rows: Sequence[Sequence[str]]) -> Iterator[str]:
    titles, *cells = rows
    yield f"| {' | '.join(titles)} |"
    yield "|" + "---|" * len(titles)
    for row in cells:
        yield f"| {' | '.join(row)} |"


def _anchor(entry: Entry) -> str:
    """As GitHub makes it of a heading."""
    kept = "".join(c for c in f"{entry.name}: {entry.shows}".lower() if c.isalnum() or c in " -_")
    return kept.replace(" ", "-")
