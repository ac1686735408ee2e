"""Work spread over the cores, photograph by photograph, in order."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TypeVar

from threadpoolctl import threadpool_limits

Item = TypeVar("Item")
Result = TypeVar("Result")

# Names how many threads share the work, in place of one per core.
THREADS_VARIABLE = "LIGHTFACTOR_THREADS"
# Whether whoever calls is one of many that do the same beside each other.
_beside_others: ContextVar[bool] = ContextVar("beside_others", default=False)


def cores() -> int:
    """How many threads share the work."""
    if _beside_others.get():
        return 1
    asked = os.environ.get(THREADS_VARIABLE, "")
    return int(asked) if asked.isdigit() and int(asked) else len(usable_cores())


@contextmanager
def on_one_core() -> Iterator[None]:
    """Keep the work within the block to its thread, and BLAS to one: other processes work on the other cores."""
    token = _beside_others.set(True)
    try:
        with one_blas_thread():
            yield
    finally:
        _beside_others.reset(token)


def usable_cores() -> list[int]:
    """The cores that this process may use, by their numbers."""
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    return list(range(os.cpu_count() or 1))


def parallel_map(function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """Results of a function over items, in their order, computed by one thread per core.

    Only a core's worth of items is begun ahead of what has been taken, so that memory doesn't grow with
    their number. numpy and OpenCV release the interpreter while they work.
    """
    threads = cores()
    if threads == 1:
        yield from map(function, items)
        return
    pending: deque[Future[Result]] = deque()
    with ThreadPoolExecutor(threads) as pool:
        try:
            for item in items:
                pending.append(pool.submit(function, item))
                if len(pending) > threads:
                    yield pending.popleft().result()
            while pending:
                yield pending.popleft().result()
        finally:
            for future in pending:
                future.cancel()


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Keep BLAS to one thread each while we spread the work ourselves.

    Two layers of threads on the same cores wait for each other: measured here, a statistics pass took
    eighty times as long with a second process on the machine.
    """
    with threadpool_limits(limits=1, user_api="blas"):
        yield
