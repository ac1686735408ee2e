"""A stage whose results have parts that are read apart: what each photograph says of each part of a surface."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, TypeVar

from capture.parallel import parallel_map
from capture.tasks.contentkey import content_key
from capture.tasks.stage import Engine, Stage, finished, workplace
from capture.tasks.store import keep, kept, packed

Item = TypeVar("Item")
Part = TypeVar("Part")


@dataclass(frozen=True, eq=False)
class PartedStage(Stage):
    """A stage whose function returns so many parts of an item's result; each is kept in a file of its own."""

    count: int = 1

    def part(self, item: object, number: int) -> Path:
        """The file of a part of an item's result."""
        return self.store.place(self.name, content_key(self.key, item, number))

    def done(self, item: Any) -> Path:
        """The file of the first part, once all are kept; OSError where the disk has no room."""
        files = [self.part(item, number) for number in range(self.count)]
        if self.fresh or not all(file.is_file() for file in files):
            for file, part in zip(files, self.function(item), strict=True):
                keep(file, packed(part))
        return files[0]


@dataclass(frozen=True, eq=False)
class Parts(Generic[Item, Part]):
    """Parts of a stage's results, on disk; in memory where nothing is kept, or the disk has no room.

    held : by the items' places, what lies in memory.
    """

    function: Callable[[Item], Sequence[Part]]
    items: Sequence[Item]
    stage: PartedStage | None
    held: dict[int, Sequence[Part]] = field(default_factory=dict)

    @classmethod
    def of(
        cls, name: str, function: Callable[[Item], Sequence[Part]], items: Sequence[Item], count: int
    ) -> Parts[Item, Part]:
        """Parts that a function returns of each item, `count` of them; as of `stage_results`."""
        here = workplace()
        stage = None if here is None else PartedStage(name, function, function, here.store, here.fresh, count)
        return cls(function, items, stage)

    @property
    def key(self) -> object:
        """What stands for all of them in keys."""
        return None if self.stage is None else (self.stage.key, self.items)

    def make(self, named: Callable[[Item], str]) -> Iterator[None]:
        """Compute what isn't there, item by item; named : as of `stage_results`."""
        here = workplace()
        engine = None if here is None else here.engine
        if self.stage is not None and engine is not None:
            return self._by_engine(self.stage, engine, named)
        return parallel_map(self._make, range(len(self.items)))

    def read(self, number: int) -> Iterator[Part]:
        """A part of each item's result, in the items' order."""
        for place, item in enumerate(self.items):
            if place in self.held:
                yield self.held[place][number]
                continue
            assert self.stage is not None
            found = kept(self.stage.part(item, number))
            # Pruned by another run in the meantime, perhaps.
            yield self.function(item)[number] if found is None else found[0]

    def _make(self, place: int) -> None:
        item = self.items[place]
        if self.stage is not None:
            try:
                self.stage.done(item)
                return
            except OSError:
                pass
        self.held[place] = self.function(item)

    def _by_engine(self, stage: PartedStage, engine: Engine, named: Callable[[Item], str]) -> Iterator[None]:
        for _ in finished(stage, engine, self.items, named):
            yield
