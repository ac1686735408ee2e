"""A workplace for a set's work: opened for a run, its cache tidied afterwards."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from capture.tasks.cluster import Cluster
from capture.tasks.localworkers import LocalWorkers
from capture.tasks.stage import Workplace, working_in
from capture.tasks.store import CACHE_VARIABLE, TaskStore, prune


@contextmanager
def opened_workplace(
    manifest: Path, workers: int | None = None, cluster: str | None = None, fresh: bool = False
) -> Iterator[Workplace]:
    """Where the tasks of a set's run are done within the block, and what is kept of them.

    workers : processes on this machine, cluster : the address of a Dask scheduler, to do them instead of this process's
    threads. fresh : whether what is kept already is computed again. ValueError where both are given, where the cluster
    doesn't answer, or where the cache can't be written, which others than threads need.
    """
    if workers is not None and cluster is not None:
        raise ValueError("give --workers or --cluster, not both: a cluster has workers of its own")
    store = TaskStore.of(manifest)
    try:
        store.prepare(manifest)
    except OSError as error:
        if workers is not None or cluster is not None:
            raise ValueError(
                f"{store.folder}: cannot be written ({error.strerror or error}); let {CACHE_VARIABLE} name another"
                " folder"
            ) from error
    engine = Cluster(cluster) if cluster else LocalWorkers(workers) if workers else None
    workplace = Workplace(store, engine, fresh)
    try:
        with working_in(workplace):
            yield workplace
    finally:
        if engine is not None:
            engine.close()
    with suppress(OSError):
        prune()
