"""A stage of the work: one function over many items, mostly photographs, whose results are kept as tasks end."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol, TypeVar

from capture.parallel import parallel_map
from capture.tasks.contentkey import content_key, program_key
from capture.tasks.store import TaskStore, keep, keep_if_room, kept, packed

Item = TypeVar("Item")
Result = TypeVar("Result")
# Of tasks that failed, so many are named.
_NAMED = 5


@dataclass(frozen=True, eq=False)
class Stage:
    """What all tasks of a stage share.

    function : of an item. made_of : all that its results depend on beside the item and the program. store : where
    results are kept. fresh : whether results that are there are computed again.
    """

    name: str
    function: Callable[[Any], Any]
    made_of: object
    store: TaskStore
    fresh: bool = False

    @cached_property
    def key(self) -> str:
        """A hash of what all its results depend on."""
        return content_key(self.name, self.made_of, program_key())

    def place(self, item: object) -> Path:
        """The file that an item's result is kept in."""
        return self.store.place(self.name, content_key(self.key, item))

    def result(self, item: Any) -> Any:
        """An item's result, read if it is kept, otherwise computed and kept where the disk has room."""
        place = self.place(item)
        if not self.fresh and (found := kept(place)) is not None:
            return found[0]
        return keep_if_room(place, self.function(item))

    def done(self, item: Any) -> Path:
        """The file of an item's result, once it is kept there; OSError where the disk has no room."""
        place = self.place(item)
        if self.fresh or kept(place) is None:
            keep(place, packed(self.function(item)))
        return place


class Engine(Protocol):
    """What does tasks away from this process."""

    def outcomes(self, stage: Stage, items: Sequence[Any]) -> Iterator[Path | Exception]:
        """Files of a stage's results in the order of its items, and errors of those that failed."""


@dataclass(frozen=True, eq=False)
class Workplace:
    """Where results are kept, and what does the tasks; engine : None for this process's threads."""

    store: TaskStore
    engine: Engine | None = None
    fresh: bool = False


_here: ContextVar[Workplace | None] = ContextVar("workplace", default=None)


@contextmanager
def working_in(workplace: Workplace) -> Iterator[None]:
    """Stages within the block keep their results in a workplace, and have its engine do their tasks."""
    token = _here.set(workplace)
    try:
        yield
    finally:
        _here.reset(token)


def stage_results(
    name: str,
    function: Callable[[Item], Result],
    items: Iterable[Item],
    named: Callable[[Item], str],
    made_of: object = None,
) -> Iterator[Result]:
    """Results of a function over items, in their order; a few are in memory at a time.

    Outside of `working_in` they are computed by this process's threads, and nothing is kept.
    made_of : all that the results depend on beside the items, where that isn't what the function is made from. named :
    an item in words, for messages. ValueError names items that failed, once all others are done.
    """
    here = _here.get()
    if here is None:
        return parallel_map(function, items)
    stage = Stage(name, function, function if made_of is None else made_of, here.store, here.fresh)
    if here.engine is None:
        _ = stage.key  # once, not by each thread
        return parallel_map(stage.result, items)
    return _gathered(stage, here.engine, list(items), named)


def kept_result(name: str, compute: Callable[[], Result], made_of: object) -> Result:
    """What a function returns, which this process computes; within `working_in` it is kept, as of `stage_results`."""
    here = _here.get()
    if here is None:
        return compute()
    found: Result = Stage(name, lambda _: compute(), made_of, here.store, here.fresh).result(None)
    return found


def workplace() -> Workplace | None:
    """Where stages keep their results just now."""
    return _here.get()


def _gathered(
    stage: Stage, engine: Engine, items: Sequence[Any], named: Callable[[Any], str]
) -> Iterator[Any]:
    for item, file in finished(stage, engine, items, named):
        found = kept(file)
        # Pruned by another run in the meantime, perhaps.
        yield stage.result(item) if found is None else found[0]


def finished(
    stage: Stage, engine: Engine, items: Sequence[Any], named: Callable[[Any], str]
) -> Iterator[tuple[Any, Path]]:
    """Items and the files of their results as an engine has done them, until one fails; as of `stage_results`."""
    failed: list[tuple[str, Exception]] = []
    for item, outcome in zip(items, engine.outcomes(stage, items), strict=True):
        if isinstance(outcome, Exception):
            failed.append((named(item), outcome))
        elif not failed:
            yield item, outcome
    if failed:
        raise _failure(failed, len(items))


def _failure(failed: Sequence[tuple[str, Exception]], count: int) -> ValueError:
    sentences = [str(error) if name in str(error) else f"{name}: {error}" for name, error in failed[:_NAMED]]
    if len(failed) == 1:
        return ValueError(sentences[0])
    more = f"; and {len(failed) - _NAMED} more" if len(failed) > _NAMED else ""
    return ValueError(f"{len(failed)} of {count} failed, the others are done: {'; '.join(sentences)}{more}")
