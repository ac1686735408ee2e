"""A sweep across a boundary: what was found on both sides of it, point by point, kept as JSON."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, as_completed
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.atlas.stage import ABSENT, QUANTITIES, Finding
from benchmarks.kept import Kept
from capture.parallel import one_blas_thread

Floats = NDArray[np.float64]

# Of a normal distribution's draws, 95% are within so many standard deviations.
_TWO_SIDED_95 = 1.96


@dataclass(frozen=True)
class Boundary:
    """One boundary and how it is swept.

    name : of its file. title, axis, edge_label : words of the chart. values : what is swept; quick : places among them
    of a coarse sweep. edge : where along the axis theory puts the boundary; None where there is none. draw : findings
    by name at a value, of a number of a draw of the noise. theory : what is expected at a value. at : a value's place
    along the axis. says : what to read from the chart.
    """

    name: str
    title: str
    axis: str
    values: tuple[float, ...]
    quick: tuple[int, ...]
    draw: Callable[[float, int], dict[str, Finding]]
    theory: Callable[[float], dict[str, Finding]]
    says: str
    edge: float | None = None
    edge_label: str = ""
    at: Callable[[float], float] = float
    quantities: tuple[str, ...] = QUANTITIES
    log: bool = False


@dataclass(frozen=True, eq=False)
class Sweep:
    """Findings along a boundary: v values, d draws, q quantities.

    at : (v,) along the axis. error, std : (v, d, q), NaN where the fit's model lacks the number. status : (v, d, q).
    expected_std : (v, q), NaN where theory has none; expected_status : (v, q).
    """

    boundary: Boundary
    at: Floats
    error: Floats
    std: Floats
    status: NDArray[np.str_]
    expected_std: Floats
    expected_status: NDArray[np.str_]

    @property
    def stated(self) -> NDArray[np.bool_]:
        """Where the fit gives a number, (v, d, q)."""
        return np.isin(self.status, ("determined", "weak"))

    @property
    def scores(self) -> Floats:
        """Errors over their standard deviations where a number is given, (v, d, q); NaN elsewhere."""
        return np.where(self.stated, self.error / self.std, np.nan)

    @property
    def covered(self) -> Floats:
        """Share (v, q) of the stated numbers whose 95% interval holds the truth; NaN where none is stated."""
        count = self.stated.sum(axis=1)
        hits = (np.abs(self.scores) < _TWO_SIDED_95).sum(axis=1)
        return np.where(count > 0, hits / np.maximum(count, 1), np.nan)


def swept(boundary: Boundary, values: Sequence[float], draws: int, kept: Kept, pool: Executor) -> Sweep:
    """The sweep at some values: what `kept` lacks of it is computed, point by point in a pool, and kept."""
    tasks = [(value, number) for value in values for number in (-1, *range(draws))]
    missing = [task for task in tasks if _key(*task) not in kept]
    running = {pool.submit(_computed, boundary, *task): task for task in missing}
    for done in as_completed(running):
        kept[_key(*running[done])] = done.result()
    return gathered(boundary, values, draws, kept)


def gathered(boundary: Boundary, values: Sequence[float], draws: int, found: Mapping[str, Any]) -> Sweep:
    """A sweep of findings by `value#draw`, as `swept` keeps them."""
    names = boundary.quantities

    def column(number: int, value: float) -> list[Finding]:
        findings = found[_key(value, number)]
        return [Finding(**findings[name]) if name in findings else ABSENT for name in names]

    drawn = [[column(number, value) for number in range(draws)] for value in values]
    theory = [column(-1, value) for value in values]
    return Sweep(
        boundary,
        np.array([boundary.at(value) for value in values]),
        np.array([[[_number(one.error) for one in row] for row in rows] for rows in drawn]),
        np.array([[[_number(one.std) for one in row] for row in rows] for rows in drawn]),
        np.array([[[one.status for one in row] for row in rows] for rows in drawn]),
        np.array([[_number(one.std) for one in row] for row in theory]),
        np.array([[one.status for one in row] for row in theory]),
    )


def _computed(boundary: Boundary, value: float, number: int) -> dict[str, Any]:
    with one_blas_thread():
        findings = boundary.theory(value) if number < 0 else boundary.draw(value, number)
    return {name: asdict(finding) for name, finding in findings.items()}


def _key(value: float, number: int) -> str:
    return f"{value:g} " + ("theory" if number < 0 else f"draw {number}")


def _number(value: float | None) -> float:
    return np.nan if value is None else value
