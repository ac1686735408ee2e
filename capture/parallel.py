"""Work spread over the cores, item by item, in order."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, TypeVar

from threadpoolctl import threadpool_limits

Item = TypeVar("Item")
Result = TypeVar("Result")
State = TypeVar("State")


def parallel_map(function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """Results of a function over items, in their order, computed by one thread per core.

    Only a core's worth of items is begun ahead of what has been taken, so that memory doesn't grow with
    their number. numpy and OpenCV release the interpreter while they work.
    """
    cores = os.cpu_count() or 1
    with ThreadPoolExecutor(cores) as pool:
        yield from _in_order(lambda item: pool.submit(function, item), items, cores)


def process_map(
    function: Callable[[State, Item], Result],
    state: State,
    items: Sequence[Item],
    workers: int | None = None,
) -> Iterator[Result]:
    """Results of function(state, item) over items, in their order, computed by one process per core.

    For work that holds the interpreter. Every worker gets the state once; function, state, items and results must
    be such as can be pickled, and a script that calls this must do so under `if __name__ == "__main__"`.
    Exceptions arrive as they were raised. Workers end with their parent, however that ends; an interrupt reaches the
    parent alone, which lets them finish what they have begun. In this process if `workers` or the items are one.
    """
    if workers is None:
        workers = os.cpu_count() or 1
    if workers < 1:
        raise ValueError(f"workers is {workers}; it must be at least 1")
    workers = min(workers, len(items))
    if workers <= 1:
        for item in items:
            # As in the workers, so that sums are rounded alike.
            with one_blas_thread():
                result = function(state, item)
            yield result
        return
    # Forked, a worker would inherit locks that threads of the parent hold.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, context, _begin_worker, (function, state)) as pool:

        def submit(item: Item) -> Future[Result]:
            with _interrupts_held():
                return pool.submit(_work, item)

        yield from _in_order(submit, items, workers)


def _in_order(
    submit: Callable[[Item], Future[Result]], items: Iterable[Item], ahead: int
) -> Iterator[Result]:
    """Results in the order of items, of which at most `ahead` are begun before they are asked for."""
    pending: deque[Future[Result]] = deque()
    try:
        for item in items:
            pending.append(submit(item))
            if len(pending) > ahead:
                yield pending.popleft().result()
        while pending:
            yield pending.popleft().result()
    finally:
        for future in pending:
            future.cancel()


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """Hold interrupts back: from this thread for now, from processes that are started meanwhile for good."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


# What a worker process works with; set once, as it begins.
_worker: tuple[Callable[[Any, Any], Any], Any]


def _begin_worker(function: Callable[[State, Item], Result], state: State) -> None:
    global _worker
    _worker = function, state
    # For systems on which the parent cannot hold interrupts back from it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threadpool_limits(limits=1, user_api="blas")
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """A worker whose parent was killed would wait for work for ever."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def _work(item: Any) -> Any:
    function, state = _worker
    return function(state, item)


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Keep BLAS to one thread each while we spread the work ourselves.

    Two layers of threads on the same cores wait for each other: measured here, a statistics pass took
    eighty times as long with a second process on the machine.
    """
    with threadpool_limits(limits=1, user_api="blas"):
        yield
