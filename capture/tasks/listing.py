"""The command `cache` at work."""

from __future__ import annotations

import time
from pathlib import Path

from rich.markup import escape
from rich.table import Column, Table

from capture.photoset import MANIFEST_NAME
from capture.tasks.store import cache_folder, listed, prune
from capture.terminal import console

_DAY_S = 24 * 3600.0


def run_cache(photoset: Path | None, remove: bool, older_days: float) -> None:
    """List what is kept, of a set or of all, or remove it. older_days : only what was not used for so long."""
    source = None
    if photoset is not None:
        source = photoset if photoset.suffix == ".toml" else photoset / MANIFEST_NAME
        if not listed(source=source):
            raise ValueError(f"{photoset}: nothing is kept of it; `lightfactor cache` lists what is")
    older_s = older_days * _DAY_S
    if remove:
        count, size = prune(older_s, most_bytes=None, source=source)
        console.print(f"Removed {count} result{'' if count == 1 else 's'}, {_size(size)}.")
        return
    now, shown = time.time(), listed(older_s, source)
    # Whole paths: they are what the command takes.
    table = Table(Column("photo set", overflow="fold"), "stage", "results", "size", "last used")
    before = None
    for kept in shown:
        place = "" if kept.source == before else escape(kept.source.removesuffix(f"/{MANIFEST_NAME}"))
        table.add_row(place, kept.stage, str(kept.count), _size(kept.size), _ago(now - kept.used))
        before = kept.source
    if shown:
        console.print(table)
    console.print(
        f"{_size(sum(kept.size for kept in shown))} in {cache_folder()}", soft_wrap=True, markup=False
    )


def _size(size: int) -> str:
    for unit, least in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if size >= least:
            return f"{size / least:.3g} {unit}"
    return f"{size} bytes"


def _ago(seconds: float) -> str:
    for unit, length in (("days", _DAY_S), ("hours", 3600.0), ("minutes", 60.0)):
        if seconds >= 2 * length:
            return f"{seconds / length:.0f} {unit} ago"
    return "just now"
