"""How long work reports on itself, without knowing of a terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

# track(items, description) iterates over the items and may show progress.
Track = Callable[[Iterable[Any], str], Iterable[Any]]


def silent(items: Iterable[Any], description: str) -> Iterable[Any]:
    """The track that shows nothing."""
    return items
