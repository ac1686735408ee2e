"""Tasks done by the workers of a Dask cluster, of which each sees the folder of the work.

The scheduler hands out tasks and knows nothing else: results lie on disk, so that workers and scheduler may die.
"""

from __future__ import annotations

import platform
import socket
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from capture.tasks.contentkey import program_key
from capture.tasks.remote import Shared, shared_stage, work
from capture.tasks.stage import Stage
from capture.tasks.store import CACHE_VARIABLE

# Seconds in which a scheduler answers, and in which one that was lost, or its workers, may come back.
_ANSWER_S, _PATIENCE_S = 10.0, 120.0
# Seconds between questions, and the port that schedulers have unless they say otherwise.
_ASK_S, _PORT = 0.5, 8786


class Cluster:
    """An `Engine` of the workers of a Dask scheduler; close it after the last stage.

    ValueError where none answers at the address, or the package isn't installed.
    """

    def __init__(self, address: str, patience_s: float = _PATIENCE_S) -> None:
        self._address, self._patience_s = address, patience_s
        self._client = connected(address)

    def outcomes(self, stage: Stage, items: Sequence[Any]) -> Iterator[Path | Exception]:
        """As of `Engine`. An item whose workers are killed is tried once more, ahead of all others.

        ValueError where a worker has another version, doesn't see the work, or none comes back.
        """
        from distributed.scheduler import KilledWorker

        with shared_stage(stage) as shared:
            self._check_workers(shared)
            begun = self._begin(shared, items)
            for k, item in enumerate(items):
                outcome = self._outcome(shared, items, begun, k)
                if isinstance(outcome, KilledWorker):
                    # Dask blames those too that wait where another kills the worker: now it waits behind none.
                    begun[k] = self._client.submit(work, shared, item, pure=False, priority=1)
                    outcome = self._outcome(shared, items, begun, k)
                if isinstance(outcome, KilledWorker):
                    outcome = ValueError(
                        f"each of the {2 * (outcome.allowed_failures + 1)} workers that had it was killed; workers may"
                        " lack memory, or the file may be one that a library fails on: leave it out"
                    )
                yield outcome
                del begun[k]

    def _outcome(
        self, shared: Shared, items: Sequence[Any], begun: dict[int, Any], k: int
    ) -> Path | Exception:
        """What became of an item, once it is settled; items from it on begin anew where the scheduler was lost."""
        while (outcome := self._settled(begun[k])) is None:
            # What is done is on disk: workers that get it again return at once.
            self._reconnect(shared)
            begun |= {k + n: of for n, of in self._begin(shared, items[k:]).items()}
        return outcome

    def _settled(self, begun: Any) -> Path | Exception | None:
        """What became of a task; None where the scheduler is gone, and it with it."""
        try:
            while begun.status == "pending":
                with suppress(TimeoutError):
                    begun.result(timeout=self._patience_s)
                if begun.status == "pending" and not self._client.scheduler_info()["workers"]:
                    return ValueError(f"the scheduler at {self._address} has lost its workers; start some")
            done: Path = begun.result()
        except Exception as error:
            # The task's own, or of the connection that was lost.
            return error if begun.status == "error" else None
        return done

    def close(self) -> None:
        """Leave the cluster; its workers stay."""
        with suppress(Exception):
            self._client.close(timeout=2)

    def _begin(self, shared: Shared, items: Sequence[Any]) -> dict[int, Any]:
        # Tasks are no function's values to Dask: whether one is done, its file says.
        return {k: self._client.submit(work, shared, item, pure=False) for k, item in enumerate(items)}

    def _reconnect(self, shared: Shared) -> None:
        """Find the scheduler and its workers again; one that has only begun may fail at first."""
        end = time.monotonic() + self._patience_s
        while True:
            self.close()
            try:
                self._client = connected(self._address, self._patience_s)
                self._check_workers(shared)
                return
            except (ValueError, OSError):
                if time.monotonic() > end:
                    raise
                time.sleep(_ASK_S)

    def _check_workers(self, shared: Shared) -> None:
        try:
            self._client.wait_for_workers(1, timeout=self._patience_s)
        except TimeoutError as error:
            raise ValueError(
                f"{self._address}: the scheduler has no worker; start some: dask worker {self._address} --nthreads 1"
            ) from error
        here = identity(shared.file)
        for worker, found in self._client.run(identity, shared.file, on_error="return").items():
            if isinstance(found, OSError):
                continue  # it died meanwhile; those that come later are asked with their first task
            if isinstance(found, Exception):
                raise ValueError(f"worker {worker}: cannot run lightfactor ({found}); install it there")
            if found[0] != here[0]:
                raise ValueError(
                    f"worker {worker}: has another version of the program, {found[1]}; here is {here[1]}: install the"
                    " same on all, their libraries too"
                )
            if not found[2]:
                raise ValueError(
                    f"worker {worker}: doesn't see {shared.file.parent}; let {CACHE_VARIABLE} name a folder that all"
                    " workers see"
                )


def identity(file: Path) -> tuple[str, str, bool]:
    """This program's key, its version and Python's in words, and whether a file is seen."""
    words = f"lightfactor {version('lightfactor')}, Python {platform.python_version()}"
    return program_key(), words, file.is_file()


def connected(address: str, patience_s: float = 0.0) -> Any:
    """A Dask client of the scheduler at an address, which may begin within so many seconds.

    Certificates for tls:// are those of Dask's configuration. ValueError where none answers, or Dask isn't installed.
    """
    try:
        from distributed import Client
        from distributed.security import Security
    except ImportError as error:
        raise ValueError(
            f"--cluster needs Dask ({error}); install it: pip install 'lightfactor[cluster]'"
        ) from error
    try:
        _await_answer(address, patience_s)
        security = Security()
        if address.startswith("tls:") and security.get_connection_args("client")["ssl_context"] is None:
            raise ValueError("tls:// needs certificates, in distributed.comm.tls of Dask's configuration")
        return Client(address, timeout=_ANSWER_S, security=security, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise ValueError(
            f"{address}: no Dask scheduler answers there ({error}); start one (dask scheduler), and workers: dask"
            " worker ADDRESS --nthreads 1"
        ) from error


def _await_answer(address: str, patience_s: float) -> None:
    """Wait until something listens at an address; a client that waits itself leaves its connections open."""
    parts = urlsplit(address)
    if not parts.hostname:
        raise ValueError("an address is like tcp://HOST:8786")
    end = time.monotonic() + patience_s
    while True:
        try:
            socket.create_connection((parts.hostname, parts.port or _PORT), timeout=_ANSWER_S).close()
            return
        except ConnectionError:
            if time.monotonic() > end:
                raise
            time.sleep(_ASK_S)
