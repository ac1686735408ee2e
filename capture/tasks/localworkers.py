"""Tasks done by processes on this machine: one that is killed takes nothing but its photograph with it."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from threading import Thread
from typing import Any

from capture.tasks.remote import Shared, shared_stage, work
from capture.tasks.stage import Stage


class LocalWorkers:
    """An `Engine` of so many processes, started when they are needed; close it after the last stage."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._pool: ProcessPoolExecutor | None = None

    def outcomes(self, stage: Stage, items: Sequence[Any]) -> Iterator[Path | Exception]:
        """As of `Engine`. An item whose process is killed is tried once more, in a process of its own."""
        with shared_stage(stage) as shared:
            begun: deque[tuple[Any, Future[Path]]] = deque()
            for item in items:
                begun.append((item, self._begin(shared, item)))
                # Few ahead of what is taken: those are the ones that a killed process may have had.
                if len(begun) > 2 * self._count:
                    yield self._outcome(shared, *begun.popleft())
            while begun:
                yield self._outcome(shared, *begun.popleft())

    def close(self) -> None:
        """End the processes."""
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)
        self._pool = None

    def _begin(self, shared: Shared, item: Any) -> Future[Path]:
        if self._pool is None:
            self._pool = _processes(self._count)
        try:
            return self._pool.submit(work, shared, item)
        except BrokenProcessPool:
            self._pool = _processes(self._count)
            return self._pool.submit(work, shared, item)

    def _outcome(self, shared: Shared, item: Any, future: Future[Path]) -> Path | Exception:
        try:
            return future.result()
        except BrokenProcessPool:
            return _alone(shared, item)
        except Exception as error:
            return error


def _alone(shared: Shared, item: Any) -> Path | Exception:
    with _processes(1) as pool:
        try:
            return pool.submit(work, shared, item).result()
        except BrokenProcessPool:
            return ValueError(
                "the process that works on it is killed each time; the machine may lack memory, or the file may be"
                " one that a library fails on: leave it out, or give fewer --workers"
            )
        except Exception as error:
            return error


def _processes(count: int) -> ProcessPoolExecutor:
    # Not forked: threads of this process may hold locks that would never be freed in a copy.
    return ProcessPoolExecutor(count, multiprocessing.get_context("spawn"), initializer=_begin_process)


def _begin_process() -> None:
    """Leave Ctrl-C to the process that started this one, and end with it, however it ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
