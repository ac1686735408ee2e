"""Tasks on disk: what changes a key, what is kept, and who does them."""

from __future__ import annotations

import os
import pickle
import signal
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from threading import Lock

import numpy as np
import pytest

from capture.tasks.contentkey import content_key, program_key
from capture.tasks.listing import run_cache
from capture.tasks.localworkers import LocalWorkers
from capture.tasks.remote import shared_stage, work
from capture.tasks.stage import Stage, Workplace, stage_results, working_in
from capture.tasks.store import TaskStore, keep, kept, listed, packed, prune

NAMES = str


@dataclass(frozen=True, eq=False)
class Squared:
    """Squares a number, and writes down that it did; some numbers end its process, or are refused."""

    log: Path
    deadly: tuple[int, ...] = ()
    refused: tuple[int, ...] = ()

    def __call__(self, number: int) -> np.ndarray:
        with self.log.open("a") as stream:
            stream.write(f"{number}\n")
        if number in self.deadly:
            os.kill(os.getpid(), signal.SIGKILL)
        if number in self.refused:
            raise ValueError(f"{number} is refused")
        return np.array([number**2])

    @property
    def done(self) -> list[int]:
        return sorted(int(line) for line in self.log.read_text().split())


def squares(
    workplace: Workplace, function: Squared, numbers: range, made_of: object = "squares"
) -> list[int]:
    with working_in(workplace):
        return [int(found[0]) for found in stage_results("squares", function, numbers, NAMES, made_of)]


@dataclass(frozen=True)
class Part:
    values: np.ndarray
    name: str = "part"
    derived: int = field(default=0, init=False)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (1, 1.0),
        (1, True),
        ("1", 1),
        ((1, 2), [1, 2]),
        (("ab", "c"), ("a", "bc")),
        ((("a",), "b"), ("a", ("b",))),
        ({"a": 1, "b": 2}, {"b": 2, "a": 1}),
        (np.zeros(4), np.zeros((2, 2))),
        (np.zeros(4), np.zeros(4, np.float32)),
        (np.array([0.0]), np.array([-0.0])),
        (Part(np.zeros(3)), Part(np.zeros(3), "other")),
        (Part(np.zeros(3)), Part(np.array([0, 0, 1e-300]))),
        (partial(max, 1), partial(max, 2)),
        (max, min),
    ],
)
def test_values_that_differ_have_other_keys(one: object, other: object) -> None:
    assert content_key(one) != content_key(other)


def test_equal_values_have_one_key_however_they_lie_in_memory() -> None:
    array = np.arange(12.0).reshape(3, 4)
    assert content_key(Part(array)) == content_key(pickle.loads(pickle.dumps(Part(array))))
    assert content_key(array.T) == content_key(np.ascontiguousarray(array.T))
    assert content_key({"b", "a"}) == content_key({"a", "b"})


class Plain:
    """No dataclass, and holds itself."""

    def __init__(self, number: int) -> None:
        self.number, self.own = number, self


def test_other_objects_stand_for_what_they_hold() -> None:
    assert content_key(Plain(1)) == content_key(Plain(1)) != content_key(Plain(2))


def test_a_path_stands_for_what_its_file_holds(tmp_path: Path) -> None:
    one, other = tmp_path / "one", tmp_path / "other"
    one.write_bytes(b"photograph")
    other.write_bytes(b"photograph")
    key = content_key(one)
    assert content_key(other) == key
    # Of the same length, and with the time of change set back.
    times = one.stat()
    one.write_bytes(b"photogrAph")
    os.utime(one, ns=(times.st_atime_ns, times.st_mtime_ns))
    assert content_key(one) != key


def test_what_holds_no_content_is_refused() -> None:
    for value in (lambda: 1, Lock(), np.array([object()])):
        with pytest.raises(TypeError, match="no content that a key could be made of"):
            content_key(value)


def test_what_is_done_is_not_done_again(store: TaskStore, tmp_path: Path) -> None:
    squared = Squared(tmp_path / "log")
    assert squares(Workplace(store), squared, range(4)) == [0, 1, 4, 9]
    assert squares(Workplace(store), squared, range(6)) == [0, 1, 4, 9, 16, 25]
    assert squared.done == [0, 1, 2, 3, 4, 5]
    # Of other things it is; and where it is to be.
    squares(Workplace(store), squared, range(1), made_of="others")
    squares(Workplace(store, fresh=True), squared, range(1))
    assert squared.done == [0, 0, 0, 1, 2, 3, 4, 5]


def test_a_damaged_result_is_computed_again(store: TaskStore, tmp_path: Path) -> None:
    squared = Squared(tmp_path / "log")
    squares(Workplace(store), squared, range(2))
    for file in store.folder.glob("squares/*.kept"):
        file.write_bytes(file.read_bytes()[:-3])
    assert squares(Workplace(store), squared, range(2)) == [0, 1]
    assert squared.done == [0, 0, 1, 1]


def test_where_nothing_can_be_kept_threads_go_on_and_workers_say_so(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    workplace = Workplace(TaskStore(tmp_path / "file" / "store"))
    assert squares(workplace, Squared(tmp_path / "log"), range(3)) == [0, 1, 4]
    with pytest.raises(ValueError, match=r"file/store: work can't be shared there .*LIGHTFACTOR_CACHE"):
        squares(replace(workplace, engine=LocalWorkers(1)), Squared(tmp_path / "log"), range(3))


@pytest.fixture
def workers() -> Iterator[LocalWorkers]:
    engine = LocalWorkers(2)
    yield engine
    engine.close()


def test_one_that_kills_its_process_is_named_and_all_others_are_done(
    store: TaskStore, workers: LocalWorkers, tmp_path: Path
) -> None:
    squared = Squared(tmp_path / "log", deadly=(3,))
    with pytest.raises(ValueError, match=r"^3: the process that works on it is killed each time"):
        squares(Workplace(store, workers), squared, range(9))
    # All the others are there, for a run without it.
    assert len(list(store.folder.glob("squares/*.kept"))) == 8
    others = [number for number in squared.done if number != 3]
    assert sorted(set(others)) == [0, 1, 2, 4, 5, 6, 7, 8]
    refusing = Squared(tmp_path / "other", refused=(1, 7))
    with pytest.raises(ValueError, match="2 of 9 failed, the others are done: 1 is refused; 7 is refused"):
        squares(Workplace(store, workers), refusing, range(9), made_of="refusing")


def test_a_worker_of_another_version_or_without_the_folder_does_nothing(
    store: TaskStore, tmp_path: Path
) -> None:
    with shared_stage(Stage("squares", Squared(tmp_path / "log"), "squares", store)) as shared:
        with pytest.raises(ValueError, match="another version of lightfactor"):
            work(replace(shared, program="other"), 1)
        with pytest.raises(ValueError, match="nowhere: this worker doesn't see it"):
            work(replace(shared, file=tmp_path / "nowhere"), 1)
        assert kept(work(shared, 5)) == (np.array([25]),)
        assert program_key() == shared.program
    assert not list(store.folder.glob("stages/*"))


def test_parts_that_killed_processes_left_are_removed_and_others_not(
    store: TaskStore, tmp_path: Path
) -> None:
    keep(store.place("squares", "a"), packed(1))
    whole = store.place("squares", "a")
    running = whole.with_suffix(f".{os.uname().nodename}.{os.getpid()}.1.part")
    child = os.spawnlp(os.P_NOWAIT, "true", "true")
    os.waitpid(child, 0)
    ended = whole.with_suffix(f".{os.uname().nodename}.{child}.1.part")
    elsewhere = whole.with_suffix(".another.host.1.1.part")
    for part in (running, ended, elsewhere):
        part.write_bytes(b"half")
    store.prepare(tmp_path / "set" / "photoset.toml")
    assert sorted(whole.parent.iterdir()) == sorted([whole, running, elsewhere])


def test_what_is_old_or_too_much_is_pruned_least_used_first(store: TaskStore, tmp_path: Path) -> None:
    now = time.time()
    for age, key in enumerate("abcd"):
        keep(store.place("squares", key), bytes(1000))
        os.utime(store.place("squares", key), (now - age, now - age))
    (found,) = listed()
    assert (found.source, found.stage, found.count, found.size) == (
        str(tmp_path / "set" / "photoset.toml"),
        "squares",
        4,
        4000,
    )
    assert prune(most_bytes=2500) == (2, 2000)
    assert [store.place("squares", key).exists() for key in "abcd"] == [True, True, False, False]
    assert prune(source=tmp_path / "other" / "photoset.toml", older_s=0) == (0, 0)
    assert prune(older_s=0.5) == (1, 1000)
    assert prune(older_s=-1) == (1, 1000)
    assert not store.folder.exists()


def test_the_command_lists_and_prunes_what_is_asked_for(
    store: TaskStore, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for key in "ab":
        keep(store.place("squares", key), bytes(1500))
    old = time.time() - 5 * 24 * 3600
    os.utime(store.place("squares", "a"), (old, old))
    run_cache(None, remove=False, older_days=0)
    said = capsys.readouterr().out
    for words in ("squares", " 2 ", "3 kB", "just now", f"3 kB in {tmp_path / 'cache'}"):
        assert words in said
    run_cache(tmp_path / "set", remove=False, older_days=3)
    assert "5 days ago" in capsys.readouterr().out
    run_cache(tmp_path / "set", remove=True, older_days=3)
    assert capsys.readouterr().out == "Removed 1 result, 1.5 kB.\n"
    with pytest.raises(ValueError, match="other: nothing is kept of it; `lightfactor cache` lists what is"):
        run_cache(tmp_path / "other", remove=True, older_days=0)
    run_cache(None, remove=True, older_days=0)
    assert not store.folder.exists()


def test_only_its_user_can_read_what_is_kept(store: TaskStore) -> None:
    assert oct(store.folder.stat().st_mode)[-3:] == "700"
