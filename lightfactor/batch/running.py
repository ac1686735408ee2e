"""Sets of a batch, each processed by a process of its own; what is there already stays."""

from __future__ import annotations

import os
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, replace
from pathlib import Path
from queue import SimpleQueue
from typing import Literal

from capture.files.documents import software
from capture.parallel import THREADS_VARIABLE, usable_cores
from capture.photoset import load_photoset
from capture.tasks.stage import Stage
from capture.tasks.store import kept
from capture.tasks.workplace import opened_workplace
from invrender.output.report.files import photoset_hashes
from invrender.result.saved import SavedResult, read_result
from lightfactor.batch.asked import AskedSet
from lightfactor.program import BOUND_PROGRAM

Status = Literal["done", "kept", "failed"]
# What the program says in front of what is wrong.
_SAYS = "lightfactor: error: "
# The last lines of a process that ended without saying why.
_LAST = 3
# Processes that run; and that no further ones are to be started.
_running: set[subprocess.Popen[str]] = set()
_stopped, _starting = threading.Event(), threading.Lock()


@dataclass(frozen=True, eq=False)
class Outcome:
    """What became of a set, and what was found of it; `result` is None where it failed.

    kept : its result was there. error : what is wrong. seconds : how long it took.
    """

    asked: AskedSet
    status: Status
    result: SavedResult | None
    error: str = ""
    seconds: float = 0.0

    @property
    def in_words(self) -> str:
        """The outcome in a few words."""
        error = self.result and self.result.content.fit.fitted
        return f"{self.asked.name}: {self.status if error is None else f'{error:.2%}'}"


def whole_result(folder: Path) -> SavedResult | None:
    """The result in a folder, if it has its report and as many predicted photographs as it should."""
    try:
        result = read_result(folder)
    except (ValueError, OSError):
        return None
    predicted = list((folder / "predicted").glob("*.exr"))
    is_whole = (folder / "report.html").is_file() and len(predicted) == len(result.content.photos)
    return result if is_whole else None


def current_result(asked: AskedSet, folder: Path) -> SavedResult | None:
    """The whole result in a folder, if it was made of the set as it is now, with its settings, by this version."""
    result = whole_result(folder)
    if result is None or (result.content.settings, result.content.software) != (asked.settings, software()):
        return None
    try:
        now = photoset_hashes(load_photoset(asked.manifest))
    except (ValueError, OSError):
        return None
    return result if result.content.inputs == now else None


def outcomes(
    sets: Sequence[AskedSet], out: Path, workers: int, fresh: bool, cluster: str | None = None
) -> Iterator[Outcome]:
    """What becomes of each set, as they end; results lie in folders of `out` by the sets' names.

    workers : how many are processed at a time, each on its share of the cores. fresh : whether results that are there
    are computed again. cluster : a Dask scheduler whose workers process the sets, each on one core.
    """
    if cluster is not None:
        yield from _on_cluster(sets, out, fresh, cluster)
        return
    cores = usable_cores()
    shares: SimpleQueue[set[int]] = SimpleQueue()
    for k in range(workers):
        shares.put(set(cores[k::workers]) or set(cores))

    def run(asked: AskedSet) -> Outcome:
        if not fresh and (result := current_result(asked, out / asked.name)) is not None:
            return Outcome(asked, "kept", result)
        share = shares.get()
        try:
            return _processed(asked, out / asked.name, fresh, share)
        finally:
            shares.put(share)

    with ThreadPoolExecutor(workers) as pool:
        started = [pool.submit(run, asked) for asked in sets]
        try:
            for future in as_completed(started):
                yield future.result()
        finally:
            for future in started:
                future.cancel()


@dataclass(frozen=True)
class _Processing:
    """Processes a set into a folder of `out`, as a worker of a cluster does it."""

    out: Path
    fresh: bool

    def __call__(self, asked: AskedSet) -> Outcome:
        folder = self.out / asked.name
        if not self.fresh and current_result(asked, folder) is not None:
            return Outcome(asked, "kept", None)
        # What was found is on disk.
        return replace(_processed(asked, folder, self.fresh), result=None)


def _on_cluster(sets: Sequence[AskedSet], out: Path, fresh: bool, address: str) -> Iterator[Outcome]:
    absolute = [replace(asked, manifest=asked.manifest.absolute()) for asked in sets]
    with opened_workplace(out / "sets", cluster=address) as workplace:
        assert workplace.engine is not None
        # Whether a set is done, its result says, not what is kept of the task.
        processing = _Processing(out.absolute(), fresh)
        stage = Stage("sets", processing, str(out.absolute()), workplace.store, fresh=True)
        for asked, done in zip(sets, workplace.engine.outcomes(stage, absolute), strict=True):
            found = None if isinstance(done, Exception) else kept(done)
            outcome: Outcome = found[0] if found else Outcome(asked, "failed", None, str(done))
            result = whole_result(out / asked.name) if outcome.status != "failed" else None
            yield replace(outcome, asked=asked, result=result)
        workplace.store.forget(stage.name)


def _processed(asked: AskedSet, folder: Path, fresh: bool, share: set[int] | None = None) -> Outcome:
    """Process a set in a process of its own, on a share of this machine's cores, or on one core without one."""
    command = [
        *BOUND_PROGRAM,
        "process",
        str(asked.manifest),
        "-o",
        str(folder),
        "--samples",
        str(asked.samples),
    ]
    command += (["--published"] if asked.published else []) + (["--fresh"] if fresh else [])
    begun = time.monotonic()
    # Of what it says, the last counts: a file holds it, however much it is.
    with tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace") as said:
        with _starting:
            if _stopped.is_set():
                return Outcome(asked, "failed", None, "the batch was stopped")
            alone = os.environ if share else os.environ | {THREADS_VARIABLE: "1"}
            process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=said,
                text=True,
                env=alone,
            )
            _running.add(process)
        if share and hasattr(os, "sched_setaffinity"):
            os.sched_setaffinity(process.pid, share)
        code = process.wait()
        assert process.stdin is not None
        process.stdin.close()
        _running.discard(process)
        said.seek(0)
        text = said.read()
    seconds = time.monotonic() - begun
    result = whole_result(folder) if code == 0 else None
    if result is None:
        return Outcome(asked, "failed", None, _why(text, code), seconds)
    return Outcome(asked, "done", result, seconds=seconds)


def _why(said: str, code: int) -> str:
    """Why a process failed, by what it said."""
    lines = [line.strip() for line in said.splitlines() if line.strip()]
    for k, line in enumerate(lines):
        if line.startswith(_SAYS):
            return " ".join([line.removeprefix(_SAYS), *lines[k + 1 :]])
    if code == 0:
        return "its process ended as if all were well, but the result isn't whole; run the batch again"
    last = " ".join(lines[-_LAST:])
    if code < 0:
        memory = "; the machine may lack memory" if code == -signal.SIGKILL else ""
        return f"its process was ended by signal {-code}{memory}. {last}".strip()
    return last or f"its process ended with status {code}"


def stop_all() -> None:
    """Stop the processes that run, each of which removes what it hasn't finished, and start no more."""
    with _starting:
        _stopped.set()
        stopped = list(_running)
    for process in stopped:
        process.terminate()
    for process in stopped:
        process.wait()
