"""What is compared on a board: methods at settings, each with time and errors on the same photographs."""

from __future__ import annotations

from collections.abc import Callable, MutableMapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.contest import Outcome
from capture.parallel import one_blas_thread


@dataclass(frozen=True)
class Contestant:
    """A method at a setting.

    family : methods that differ by setting only are one line. run : judged on a draw of the noise. told : knows what
    a user has no way to know, and so isn't on the front; in words.
    """

    family: str
    setting: str
    run: Callable[[int], Outcome]
    is_default: bool = False
    told: bool = False

    @property
    def key(self) -> str:
        return f"{self.family}, {self.setting}"


@dataclass(frozen=True)
class Board:
    """Methods that do the same work; those that are told more than a user knows get one draw, the others `draws`.

    parameters : in words, the error of an outcome's parameters, and the number that it is. warm_up : done before
    anything is timed, such as tables of lobes that a first run builds for all.
    """

    title: str
    parameters: str
    error: Callable[[Outcome], float]
    contestants: Sequence[Contestant]
    draws: int
    warm_up: Callable[[], object]


@dataclass(frozen=True, eq=False)
class Point:
    """A contestant's median time over the default's, and RMS errors of parameters and of unseen photographs."""

    contestant: Contestant
    label: str
    time: float
    parameters: float
    held_out: float


def measured(board: Board, kept: MutableMapping[str, Any]) -> list[Point]:
    """All contestants of a board; what `kept` lacks is measured and kept, one by one.

    Times are in units of the default's of the same run, which is measured first.
    """
    missing = [one for one in board.contestants if _key(board, one) not in kept]
    if missing:
        board.warm_up()
        default = next(one for one in board.contestants if one.is_default)
        of_default = _outcomes(board, default)
        unit = _median_seconds(of_default)
        for one in missing:
            outcomes = of_default if one is default else _outcomes(board, one)
            errors = [
                _rms([board.error(each) for each in outcomes]),
                _rms([each.held_out for each in outcomes]),
            ]
            kept[_key(board, one)] = [_median_seconds(outcomes) / unit, *errors]
    return [Point(one, board.parameters, *kept[_key(board, one)]) for one in board.contestants]


def _outcomes(board: Board, contestant: Contestant) -> list[Outcome]:
    with one_blas_thread():
        return [contestant.run(seed) for seed in range(1 if contestant.told else board.draws)]


def _median_seconds(outcomes: Sequence[Outcome]) -> float:
    return float(np.median([one.seconds for one in outcomes]))


def _rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _key(board: Board, contestant: Contestant) -> str:
    return f"{board.title}: {contestant.key}"
