"""How long work reports on itself, without knowing of a terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

# track(items, description) iterates over the items and may show progress.
Track = Callable[[Iterable[Any], str], Iterable[Any]]


def silent(items: Iterable[Any], description: str) -> Iterable[Any]:
    """The track that shows nothing."""
    return items


@contextmanager
def counted(track: Track, steps: int, description: str) -> Iterator[Callable[[], None]]:
    """A function for work to call after each of its steps, of which there are so many at most."""
    left = iter(track(range(steps), description))
    next(left)
    yield lambda: next(left, None)
    for _ in left:
        pass
