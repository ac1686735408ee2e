"""Work in other processes: the same results, and nothing left behind."""

from __future__ import annotations

import contextlib
import operator
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pytest

from capture.parallel import parallel_map, process_map

# Notes its process and how many threads BLAS would use; sleeps for the second item only, so that one worker is idle.
SCRIPT = """
import os, sys, time
from pathlib import Path
import numpy, scipy.linalg
from threadpoolctl import threadpool_info
from capture.parallel import process_map

def work(folder, item):
    threads = max(info["num_threads"] for info in threadpool_info() if info["user_api"] == "blas")
    (folder / f"{item}.new").write_text(f"{os.getpid()} {threads}")
    (folder / f"{item}.new").rename(folder / f"{item}.txt")
    time.sleep(SECONDS * item)

if __name__ == "__main__":
    list(process_map(work, Path(sys.argv[1]), range(2), workers=2))
"""


class Counted(Sequence[int]):
    """Numbers, which are counted as they are taken."""

    def __init__(self, size: int) -> None:
        self.size, self.taken = size, 0

    def __len__(self) -> int:
        return self.size

    def __getitem__(self, index: object) -> int:
        assert isinstance(index, int)
        if index >= self.size:
            raise IndexError
        self.taken += 1
        return index


@pytest.mark.parametrize("workers", [1, 2, None])
def test_results_come_in_order_and_not_far_ahead(workers: int | None) -> None:
    items = Counted(30)
    results = process_map(operator.mul, 3, items, workers)
    assert items.taken == 0
    assert [next(results) for _ in range(5)] == [0, 3, 6, 9, 12]
    assert items.taken <= 5 + (workers or os.cpu_count() or 1)
    assert list(results) == [3 * item for item in range(5, 30)]


def test_one_item_or_none_needs_no_process() -> None:
    # A lambda can't be sent to one.
    assert list(process_map(lambda state, item: state - item, 5, [2])) == [3]
    assert list(process_map(lambda state, item: state - item, 5, [])) == []


@pytest.mark.parametrize("workers", [1, 2])
def test_exceptions_arrive_as_they_were_raised(workers: int) -> None:
    results = process_map(list.index, ["a", "b"], ["b", "a", "c", "a"], workers)
    assert [next(results), next(results)] == [1, 0]
    with pytest.raises(ValueError, match="'c' is not in list"):
        next(results)


def test_no_workers_is_an_error() -> None:
    with pytest.raises(ValueError, match="workers is 0; it must be at least 1"):
        next(process_map(operator.mul, 3, [1, 2], 0))


def test_threads_keep_the_order_too() -> None:
    items = Counted(50)
    results = parallel_map(lambda item: -item, items)
    assert next(results) == 0
    assert items.taken <= 2 + (os.cpu_count() or 1)
    assert list(results) == [-item for item in range(1, 50)]


@pytest.fixture
def started(tmp_path: Path) -> Iterator[Callable[[float], subprocess.Popen[str]]]:
    """`started(seconds)`: a program in a session of its own; of its two workers one is busy for so long."""
    programs = []

    def start(seconds: float) -> subprocess.Popen[str]:
        script = tmp_path / "script.py"
        script.write_text(SCRIPT.replace("SECONDS", str(seconds)))
        program = subprocess.Popen(
            [sys.executable, str(script), str(tmp_path)],
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        programs.append(program)
        until(lambda: len(notes(tmp_path)) >= 2, seconds=60)
        return program

    yield start
    for program in programs:
        # Workers that outlive it hold its stderr open.
        with contextlib.suppress(ProcessLookupError):
            os.killpg(program.pid, signal.SIGKILL)
        program.communicate()


def notes(folder: Path) -> list[tuple[int, int]]:
    """Process and number of BLAS threads of every item that was begun."""
    return [(int(a), int(b)) for a, b in (path.read_text().split() for path in folder.glob("*.txt"))]


def until(reached: Callable[[], bool], seconds: float) -> None:
    end = time.monotonic() + seconds
    while not reached():
        assert time.monotonic() < end, f"not reached within {seconds} s"
        time.sleep(0.02)


def alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    # A worker whose parent is gone stays a zombie until init looks; it is dead all the same.
    status = Path(f"/proc/{process}/stat")
    return not status.exists() or status.read_text().rsplit(")", 1)[1].split()[0] != "Z"


def test_workers_use_one_blas_thread_each(
    started: Callable[[float], subprocess.Popen[str]], tmp_path: Path
) -> None:
    program = started(0.5)
    assert program.wait(timeout=60) == 0
    processes, threads = zip(*notes(tmp_path), strict=True)
    assert set(threads) == {1}
    assert program.pid not in processes


@pytest.mark.skipif(os.name == "nt", reason="signals as POSIX has them")
def test_workers_end_with_a_parent_that_was_killed(
    started: Callable[[float], subprocess.Popen[str]], tmp_path: Path
) -> None:
    program = started(1000)
    workers = [process for process, _ in notes(tmp_path)]
    assert all(alive(worker) for worker in workers)
    program.send_signal(signal.SIGKILL)
    until(lambda: not any(alive(worker) for worker in workers), seconds=20)


@pytest.mark.skipif(os.name == "nt", reason="signals as POSIX has them")
def test_an_interrupt_is_the_parents_alone(
    started: Callable[[float], subprocess.Popen[str]], tmp_path: Path
) -> None:
    program = started(1.0)
    # As a terminal sends it: to all processes in the foreground.
    os.killpg(program.pid, signal.SIGINT)
    _, errors = program.communicate(timeout=60)
    assert program.returncode == -signal.SIGINT
    assert errors.count("KeyboardInterrupt") == 1
    assert not any(alive(process) for process, _ in notes(tmp_path))
