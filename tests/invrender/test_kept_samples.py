"""Kept samples are those that would be drawn anew, whatever has changed; what hasn't changed isn't read again."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from capture.photoset import load_photoset
from capture.progress import silent
from capture.tasks.contentkey import content_key
from capture.tasks.stage import Workplace, working_in
from capture.tasks.store import TaskStore
from invrender.observation.clock import Clock
from invrender.observation.geometry import find_geometry
from invrender.observation.samples import read_samples
from recon.lighting import read_lighting
from recon.sampling.lightfield import LightField

from .faultysets import LAMPS, change_manifest, change_pixels, write_set

ALL = len(LAMPS)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_set(tmp_path / "set")


@pytest.fixture
def store(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> TaskStore:
    monkeypatch.setenv("LIGHTFACTOR_CACHE", str(tmp_path / "cache"))
    return TaskStore.of(folder / "photoset.toml")


def drawn(folder: Path, samples: int = 2000) -> dict[str, LightField]:
    photoset = load_photoset(folder)
    geometry = find_geometry(photoset)
    sources = {
        table.name: read_lighting(photoset, table, geometry.body).sources for table in photoset.lightings
    }
    return read_samples(photoset, geometry.found, sources, samples, Clock(), silent)[0]


def brighter(folder: Path) -> None:
    change_pixels(folder, lambda k, pixels: pixels * (1.01 if k == 3 else 1))


def smaller_mask(folder: Path) -> None:
    mask = folder / "002_mask.png"
    mask.write_bytes((folder / "003_mask.png").read_bytes() + b"\0")


def held_out(folder: Path) -> None:
    change_manifest(folder, r'mask = "001_mask.png"\n', lambda found: f"{found[0]}held_out = true\n")


def longer_lens(folder: Path) -> None:
    change_manifest(
        folder, r"params = \[([\d.]+), ([\d.]+)", lambda found: f"params = [{float(found[1]) + 1}, {found[2]}"
    )


def another_lamp(folder: Path) -> None:
    change_manifest(folder, r"0\.9848077530122081", lambda _: "0.98")


def white_balance(folder: Path) -> None:
    change_manifest(
        folder, r'encoding = "linear"', lambda _: 'encoding = "linear"\nwhite_balance = [1, 1, 1.01]'
    )


def nothing(folder: Path) -> None:
    """What isn't read has no say: here a comment."""
    change_manifest(folder, r"format = 1", lambda found: f"{found[0]}  # a comment")


@pytest.mark.parametrize(
    ("change", "anew"),
    [
        (nothing, 0),
        (brighter, 1),
        (smaller_mask, 1),
        (held_out, ALL),
        (longer_lens, ALL),
        (another_lamp, ALL),
        (white_balance, ALL),
    ],
)
def test_what_changes_is_read_again(
    folder: Path, store: TaskStore, change: Callable[[Path], None], anew: int
) -> None:
    with working_in(Workplace(store)):
        drawn(folder)
        before = set(store.folder.glob("samples/*.kept"))
        assert len(before) == ALL
        change(folder)
        found = drawn(folder)
    expected = drawn(folder)
    for label, field in expected.items():
        assert content_key(found[label]) == content_key(field)
        assert (found[label].radiance == field.radiance).all()
    assert len(set(store.folder.glob("samples/*.kept")) - before) == anew


def test_another_budget_is_drawn_anew(folder: Path, store: TaskStore) -> None:
    with working_in(Workplace(store)):
        few, more = drawn(folder, 2000), drawn(folder, 3000)
    assert np.mean([len(more[label]) / len(few[label]) for label in few]) == pytest.approx(1.5, abs=0.01)
