"""The terminal that commands share: one console, and progress bars on it."""

from __future__ import annotations

import json
import os
import signal
import sys
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from capture.files.outfolder import discard_unfinished
from capture.progress import TrackedStep

console = Console(highlight=False)

PROGRESS_VARIABLE = "LIGHTFACTOR_PROGRESS"


def track(items: Iterable[Any], description: str) -> Iterator[Any]:
    """Iterate with a progress bar that vanishes when done; nothing is shown where stdout is no terminal.

    Where `PROGRESS_VARIABLE` names a file, a line of JSON is added to it at each step, for who watches from outside.
    """
    if file := os.environ.get(PROGRESS_VARIABLE):
        yield from _reported(list(items), description, file)
        return
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
        task = progress.add_task(description, total=len(items))
        for item in items:
            yield item
            progress.update(
                task, advance=1, description=" - ".join(filter(None, (description, _outcome(item))))
            )


def _reported(items: list[Any], description: str, file: str) -> Iterator[Any]:
    for done in range(len(items) + 1):
        now = {"doing": description, "done": done, "of": len(items)}
        if done and (outcome := _outcome(items[done - 1])):
            now["outcome"] = outcome
        with open(file, "a", encoding="utf-8") as lines:
            lines.write(json.dumps(now) + "\n")
        if done < len(items):
            yield items[done]


def _outcome(item: Any) -> str:
    return item.outcome if isinstance(item, TrackedStep) else ""


def leave_cleanly_when_stopped(first: Callable[[], None] = lambda: None) -> None:
    """From here on Ctrl-C and SIGTERM end the program at once, its temporary folders removed.

    first : is done before that.
    """
    # Its import puts a handler of its own in place: import it first.
    import pycolmap  # noqa: F401

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, partial(_stop, first))


def _stop(first: Callable[[], None], number: int, frame: object) -> None:
    first()
    # Not by an exception: raised within an import or a callback of a library, it may be swallowed.
    left = discard_unfinished()
    if left is None:
        return
    console.show_cursor()
    print(f"\nlightfactor: stopped; {left}", file=sys.stderr)  # noqa: T201
    sys.stderr.flush()
    os._exit(128 + number)
