"""What the index of the papers' figures is made of: an entry per figure, and what came of drawing it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure


class MissingMeansError(RuntimeError):
    """A figure needs what this machine lacks: real data, or a compiler."""


@dataclass(frozen=True)
class Workplace:
    """Where drawings go, and what they are made of.

    out : folder of pictures. sets : folder of photo sets, rendered where they are missing. data : folder of real
    photographs and measured BRDFs; None if there is none. quick : whether coarse versions do, to see whether all works.
    """

    out: Path
    sets: Path
    data: Path | None
    quick: bool

    def real(self, *parts: str) -> Path:
        """A file or folder of real data; MissingMeansError where there is no data."""
        if self.data is None:
            raise MissingMeansError("LIGHTFACTOR_DATA isn't set: there is no real data")
        return self.data.joinpath(*parts)

    def save(self, figure: Figure, name: str) -> str:
        """Write a picture as NAME.png and return that."""
        file = f"{name}.png"
        figure.savefig(
            self.out / file, dpi=90, metadata={"Software": None}, pil_kwargs={"optimize": not self.quick}
        )
        return file


@dataclass(frozen=True)
class Outcome:
    """What drawing a figure showed.

    printed, ours : the paper's numbers and ours, each a few words. remark : what holds and what doesn't, a sentence or
    more. picture : its file, if there is one. table : rows of words, the first of titles.
    """

    printed: str
    ours: str
    remark: str
    picture: str | None = None
    table: Sequence[Sequence[str]] = ()

    def document(self) -> dict[str, Any]:
        """Itself, ready to be kept as JSON."""
        return {**vars(self), "table": [list(row) for row in self.table]}


@dataclass(frozen=True)
class Entry:
    """A figure or table of a paper.

    name : as the command takes it, `rh01-fig4` or `r02-table5.4`. shows : what it shows, in a few words. draw : draws
    it; None of one that has nothing to compute. reason : why it has nothing, and where its matter is found. coarse :
    whether it has a coarse version; meshes take minutes in any case.
    """

    name: str
    shows: str
    draw: Callable[[Workplace], Outcome] | None = None
    reason: str = ""
    coarse: bool = True
