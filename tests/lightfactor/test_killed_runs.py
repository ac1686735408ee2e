"""Runs that are killed at any moment leave nothing that the next one doesn't clear away."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from distributed import LocalCluster

from invrender.output.report.run import run_process
from tests.capture.test_cluster import killing
from tests.invrender.faultysets import write_set
from tests.invrender.test_kept_fits import assert_alike

PROGRAM = [sys.executable, "-c", "from lightfactor.cli import main; main()"]


def numbers(out: Path) -> object:
    """What a result says, but for the time it took."""
    document = json.loads((out / "result.json").read_text())
    del document["timing_s"]
    return document


def assert_nothing_is_left(folder: Path, names: list[str]) -> None:
    """A folder holds nothing beside what is named, and the cache nothing that is half written, or in results by now."""
    assert sorted(path.name for path in folder.iterdir()) == names
    kept = [path for path in Path(os.environ["LIGHTFACTOR_CACHE"]).rglob("*") if path.is_file()]
    assert {path.parent.name for path in kept if path.suffix == ".kept"} == {"outlines", "samples"}
    assert {path.name for path in kept if path.suffix != ".kept"} == {"set.txt"}


@pytest.fixture(autouse=True)
def _cache_of_its_own(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LIGHTFACTOR_CACHE", str(tmp_path_factory.mktemp("cache")))


@pytest.mark.slow
def test_a_run_after_killed_ones_gives_the_same_result_and_leaves_nothing_else(tmp_path: Path) -> None:
    folder = write_set(tmp_path / "set")
    out = tmp_path / "out"

    def start(place: Path) -> subprocess.Popen[bytes]:
        command = [*PROGRAM, "process", str(folder), "-o", str(place), "--samples", "2000"]
        return subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
        )

    begun = time.monotonic()
    assert start(tmp_path / "undisturbed").wait() == 0
    whole = time.monotonic() - begun
    # Most of it is start-up, decoding and the fit; pictures and report come at the end.
    for share in (0.6, 0.9):
        running = start(out)
        time.sleep(share * whole)
        os.killpg(running.pid, signal.SIGKILL)
        running.wait()
    assert start(out).wait() == 0
    assert numbers(out) == numbers(tmp_path / "undisturbed")
    assert {path.name for path in out.iterdir()} == {
        path.name for path in (tmp_path / "undisturbed").iterdir()
    }
    assert_nothing_is_left(tmp_path, ["out", "set", "undisturbed"])


@pytest.mark.sweep
def test_a_cluster_whose_workers_are_killed_gives_the_same_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = write_set(tmp_path / "set")
    run_process(folder, tmp_path / "serial", 2000, fresh=True)
    with (
        LocalCluster(
            n_workers=3, threads_per_worker=1, dashboard_address=":0", local_directory=str(tmp_path / "dask")
        ) as cluster,
        killing(cluster, 2.0) as killed,
    ):
        # Workers are in another folder than what is named from here.
        monkeypatch.chdir(tmp_path)
        run_process(Path("set"), Path("spread"), 2000, fresh=True, cluster=cluster.scheduler_address)
    assert killed
    assert_alike(tmp_path / "spread", tmp_path / "serial")
    run_process(folder, tmp_path / "processes", 2000, fresh=True, workers=2)
    assert_alike(tmp_path / "processes", tmp_path / "serial")
