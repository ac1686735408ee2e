"""The command `cache` at work."""

from __future__ import annotations

import time
from pathlib import Path

from rich.markup import escape
from rich.table import Table

from capture.photoset import MANIFEST_NAME
from capture.tasks.store import cache_folder, listed, prune
from capture.terminal import console

_DAY_S = 24 * 3600.0


def run_cache(photoset: Path | None, remove: bool, older_days: float) -> None:
    """List what is kept, of a set or of all, or remove it. older_days : only what was not used for so long."""
    source = None
    if photoset is not None:
        source = photoset if photoset.suffix == ".toml" else photoset / MANIFEST_NAME
        if not any(kept.source == str(source.absolute()) for kept in listed()):
            raise ValueError(f"{photoset}: nothing is kept of it; `lightfactor cache` lists what is")
    if remove:
        count, size = prune(older_days * _DAY_S, most_bytes=0 if older_days == 0 else 1 << 62, source=source)
        console.print(f"Removed {count} results, {_size(size)}.")
        return
    now = time.time()
    shown = [
        kept
        for kept in listed()
        if source is None or kept.source == str(source.absolute())
        if now - kept.used >= older_days * _DAY_S
    ]
    table = Table("photo set", "stage", "results", "size", "last used")
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
