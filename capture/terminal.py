"""The terminal that commands share: one console, and progress bars on it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

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
