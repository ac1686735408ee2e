"""Parts of results are kept one by one, computed where one lacks, and read again in the items' order."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import pytest

from capture.tasks import parted
from capture.tasks.localworkers import LocalWorkers
from capture.tasks.parted import Parts
from capture.tasks.stage import Workplace, working_in
from capture.tasks.store import TaskStore

NUMBERS = range(4)


@dataclass(frozen=True)
class Powers:
    """The first three powers of a number; a line for each number that they were computed of."""

    log: str
    refused: int | None = None

    def __call__(self, number: int) -> list[int]:
        with Path(self.log).open("a") as stream:
            stream.write(f"{number}\n")
        if number == self.refused:
            raise ValueError(f"{number} is refused")
        return [number, number**2, number**3]

    @property
    def done(self) -> list[int]:
        return sorted(int(line) for line in Path(self.log).read_text().split())


@pytest.fixture
def powers(tmp_path: Path) -> Powers:
    return Powers(str(tmp_path / "log"))


def made(function: Powers) -> Parts[int, int]:
    parts = Parts.of("powers", function, NUMBERS, 3)
    assert len(list(parts.make(str))) == len(NUMBERS)
    return parts


def assert_right(parts: Parts[int, int]) -> None:
    for power in range(3):
        assert list(parts.read(power)) == [number ** (power + 1) for number in NUMBERS]


def test_outside_of_a_workplace_parts_lie_in_memory(powers: Powers) -> None:
    assert_right(made(powers))
    assert powers.done == list(NUMBERS)


def test_what_lacks_a_part_is_computed_again(powers: Powers, store: TaskStore) -> None:
    with working_in(Workplace(store)):
        parts = made(powers)
        assert not parts.held
        assert_right(made(powers))
        assert powers.done == list(NUMBERS)
        assert parts.stage is not None
        parts.stage.part(2, 1).unlink()
        # Removed while it is needed, and before.
        assert list(parts.read(1)) == [0, 1, 4, 9]
        assert_right(made(powers))
    assert powers.done == [0, 1, 2, 2, 2, 3]
    with working_in(Workplace(store, fresh=True)):
        assert_right(made(powers))
    assert powers.done == sorted([*NUMBERS, *NUMBERS, 2, 2])


def test_without_room_on_the_disk_they_stay_in_memory(
    powers: Powers, store: TaskStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, os.strerror(28))

    monkeypatch.setattr(parted, "keep", full)
    with working_in(Workplace(store)):
        parts = made(powers)
        assert_right(parts)
    assert sorted(parts.held) == list(NUMBERS)


def test_processes_compute_them_and_errors_name_the_item(powers: Powers, store: TaskStore) -> None:
    engine = LocalWorkers(2)
    try:
        with working_in(Workplace(store, engine)):
            assert_right(made(powers))
            assert powers.done == list(NUMBERS)
            with pytest.raises(ValueError, match="2 is refused"):
                made(Powers(powers.log, refused=2))
    finally:
        engine.close()
    assert powers.done == sorted([*NUMBERS, *NUMBERS])
