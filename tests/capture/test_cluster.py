"""Tasks on a Dask cluster: workers and schedulers die, and nothing is lost or done twice."""

from __future__ import annotations

import os
import random
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import pytest
from distributed import LocalCluster

from capture.tasks.cluster import Cluster
from capture.tasks.stage import Workplace, stage_results, working_in
from capture.tasks.store import TaskStore

COUNT = 60


@dataclass(frozen=True)
class Slowly:
    """Returns a number after a while, and writes down that it did; one number kills its worker."""

    log: Path
    seconds: float
    deadly: int = -1

    def __call__(self, number: int) -> int:
        if number == self.deadly:
            os.kill(os.getpid(), signal.SIGKILL)
        time.sleep(self.seconds)
        with self.log.open("a") as stream:
            stream.write(f"{number}\n")
        return number

    @property
    def done(self) -> list[int]:
        return sorted(int(line) for line in self.log.read_text().split())


@dataclass(frozen=True)
class Unlucky(Slowly):
    """Number 17 loses its first two workers, as one does that waits where another kills them."""

    def __call__(self, number: int) -> int:
        if number == 17:
            (self.log.parent / f"lost {len(list(self.log.parent.glob('lost *')))}").touch()
            if len(list(self.log.parent.glob("lost *"))) <= 2:
                os.kill(os.getpid(), signal.SIGKILL)
        return super().__call__(number)


def numbers(store: TaskStore, address: str, function: Slowly) -> list[int]:
    engine = Cluster(address, patience_s=60)
    try:
        with working_in(Workplace(store, engine)):
            return list(stage_results("slowly", function, range(COUNT), str, "slowly"))
    finally:
        engine.close()


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LocalCluster]:
    # In a folder of its own: another cluster on the machine may take one that is just made for a leftover.
    place = str(tmp_path_factory.mktemp("dask"))
    with LocalCluster(
        n_workers=3, threads_per_worker=1, dashboard_address=":0", local_directory=place
    ) as found:
        yield found


@pytest.fixture
def impatient(cluster: LocalCluster, monkeypatch: pytest.MonkeyPatch) -> LocalCluster:
    """It gives a task up that has killed two workers, not four: each takes seconds to be replaced."""
    monkeypatch.setattr(cluster.scheduler, "allowed_failures", 1)
    return cluster


@contextmanager
def killing(cluster: LocalCluster, every_s: float) -> Iterator[list[int]]:
    """Kill a random worker again and again; the processes that were killed."""
    over, killed = threading.Event(), []

    def kill() -> None:
        draw = random.Random(0)
        while not over.wait(every_s):
            # A busy machine starts them slower than this: one stays, or nothing would ever be done.
            if len(cluster.scheduler.workers) < 2:
                continue
            process = draw.choice([nanny.process for nanny in cluster.workers.values() if nanny.pid]).process
            # By what has started it: another process may have the number of one that has just ended.
            cluster.loop.add_callback(process.kill)
            killed.append(process.pid)

    thread = threading.Thread(target=kill)
    thread.start()
    try:
        yield killed
    finally:
        over.set()
        thread.join()


@pytest.mark.slow
def test_workers_that_are_killed_change_nothing(
    store: TaskStore, cluster: LocalCluster, tmp_path: Path
) -> None:
    slowly = Slowly(tmp_path / "log", 0.25)
    with killing(cluster, 2.0) as killed:
        assert numbers(store, cluster.scheduler_address, slowly) == list(range(COUNT))
    assert killed
    # What was done when its worker was killed is on disk.
    assert len(slowly.done) <= COUNT + len(killed)
    assert set(slowly.done) == set(range(COUNT))


def test_one_that_kills_its_workers_is_named_and_all_others_are_done(
    store: TaskStore, impatient: LocalCluster, tmp_path: Path
) -> None:
    # Slow enough for others to wait behind it when it kills its worker.
    slowly = Slowly(tmp_path / "log", 0.05, deadly=17)
    with pytest.raises(ValueError, match=r"^17: each of the 4 workers that had it was killed"):
        numbers(store, impatient.scheduler_address, slowly)
    assert set(slowly.done) == set(range(COUNT)) - {17}
    assert len(list(store.folder.glob("slowly/*.kept"))) == COUNT - 1


def test_one_that_only_waited_where_workers_were_killed_is_done(
    store: TaskStore, impatient: LocalCluster, tmp_path: Path
) -> None:
    unlucky = Unlucky(tmp_path / "log", 0.0)
    assert numbers(store, impatient.scheduler_address, unlucky) == list(range(COUNT))
    assert len(list(tmp_path.glob("lost *"))) == 3


def _started(*command: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-m", *command],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


def _free_port() -> int:
    """One that no system hands out by itself, so that it stays free while a scheduler begins anew."""
    for port in range(15000 + os.getpid() % 15000, 32000):
        with suppress(OSError), socket.socket() as found:
            found.bind(("127.0.0.1", port))
            return port
    raise OSError("no port is free")


@contextmanager
def scheduler(port: int, place: Path) -> Iterator[None]:
    """A scheduler with two workers in processes of their own, all killed at the end; place : for what they write."""
    address = f"tcp://127.0.0.1:{port}"
    options = ("--host", "127.0.0.1", "--dashboard-address", ":0")
    workers = ("--nthreads", "1", "--nworkers", "2", "--dashboard-address", ":0")
    workers += ("--local-directory", str(place))
    processes = [
        _started("distributed.cli.dask_scheduler", "--port", str(port), *options),
        _started("distributed.cli.dask_worker", address, *workers),
    ]
    try:
        yield
    finally:
        for process in processes:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()


@pytest.mark.sweep
def test_a_scheduler_that_is_killed_and_comes_back_does_nothing_twice(
    store: TaskStore, tmp_path: Path
) -> None:
    port, slowly, found = _free_port(), Slowly(tmp_path / "log", 0.1), []
    with scheduler(port, tmp_path):
        address = f"tcp://127.0.0.1:{port}"
        _until_it_answers(port)
        thread = threading.Thread(target=lambda: found.extend(numbers(store, address, slowly)))
        thread.start()
        while not (slowly.log.exists() and len(slowly.done) > COUNT // 3):
            time.sleep(0.05)
    begun = len(slowly.done)
    assert begun < COUNT
    with scheduler(port, tmp_path):
        thread.join()
    assert found == list(range(COUNT))
    # Two workers were killed, perhaps between writing the log and the result.
    assert len(slowly.done) <= COUNT + 2


def _until_it_answers(port: int) -> None:
    while True:
        with socket.socket() as asked:
            if asked.connect_ex(("127.0.0.1", port)) == 0:
                return
        time.sleep(0.1)


def test_a_cluster_that_is_not_there_is_said() -> None:
    address = f"tcp://127.0.0.1:{_free_port()}"
    with pytest.raises(
        ValueError, match=rf"{address}: no Dask scheduler answers there \(.*refused\); start one"
    ):
        Cluster(address)
    with pytest.raises(
        ValueError, match=r"nonsense: no Dask scheduler answers there \(an address is like tcp://"
    ):
        Cluster("nonsense")


def test_workers_that_lack_or_have_another_program_are_named(
    store: TaskStore, cluster: LocalCluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("capture.tasks.cluster.program_key", lambda: "another")
    with pytest.raises(
        ValueError, match=r"^worker tcp://.*: has another version of the program, lightfactor"
    ):
        numbers(store, cluster.scheduler_address, Slowly(tmp_path / "log", 0))
