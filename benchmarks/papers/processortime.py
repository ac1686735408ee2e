"""Seconds of processor time, which other programs on the machine move least."""

from __future__ import annotations

import time
from collections.abc import Callable
from statistics import median


def seconds(work: Callable[[], object], repeats: int = 1) -> float:
    """Processor seconds of one call, the mean of some."""
    start = time.process_time()
    for _ in range(repeats):
        work()
    return (time.process_time() - start) / repeats


def median_seconds(work: Callable[[], object], rounds: int = 3, least: float = 0.05) -> float:
    """Median of some rounds, each of so many calls as take `least` seconds; the first call is not timed."""
    work()
    repeats = max(1, int(least / max(seconds(work), 1e-6)))
    return median(seconds(work, repeats) for _ in range(rounds))
