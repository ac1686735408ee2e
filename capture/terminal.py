"""The terminal that commands share: one console, and progress bars on it."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterable, Iterator
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from capture.files.outfolder import discard_unfinished

console = Console(highlight=False)


def track(items: Iterable[Any], description: str) -> Iterator[Any]:
    """Iterate with a progress bar that vanishes when done; nothing is shown where stdout is no terminal."""
    if not console.is_terminal:
        yield from items
        return
    items = list(items)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=True) as progress:
        yield from progress.track(items, description=description)


def leave_cleanly_when_stopped() -> None:
    """From here on Ctrl-C and SIGTERM end the program at once, its temporary folders removed."""
    # Its import puts a handler of its own in place: import it first.
    import pycolmap  # noqa: F401

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _stop)


def _stop(number: int, frame: object) -> None:
    # Not by an exception: raised within an import or a callback of a library, it may be swallowed.
    left = discard_unfinished()
    if left is None:
        return
    console.show_cursor()
    print(f"\nlightfactor: stopped; {left}", file=sys.stderr)  # noqa: T201
    sys.stderr.flush()
    os._exit(128 + number)
