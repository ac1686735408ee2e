"""How long work reports on itself, without knowing of a terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Protocol

# track(items, description) iterates over the items and may show progress.
Track = Callable[[Iterable[Any], str], Iterable[Any]]


def silent(items: Iterable[Any], description: str) -> Iterable[Any]:
    """The track that shows nothing."""
    return items


class OnStep(Protocol):
    """What work calls after each of its steps; outcome : what the step found, in a few words, or nothing."""

    def __call__(self, outcome: str = "") -> None: ...


def unwatched(outcome: str = "") -> None:
    """The `OnStep` that tells nobody."""


@dataclass
class TrackedStep:
    """A step of `counted` work, and its outcome once it is done."""

    outcome: str = ""


@contextmanager
def counted(track: Track, steps: int, description: str) -> Iterator[OnStep]:
    """A function for work to call after each of its steps, of which there are so many at most."""
    left = iter(track([TrackedStep() for _ in range(steps)], description))
    now = [next(left)]

    def done(outcome: str = "") -> None:
        now[0].outcome = outcome
        now[0] = next(left, now[0])

    yield done
    for _ in left:
        pass
