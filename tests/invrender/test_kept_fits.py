"""A run that was stopped among its pictures goes on there: nothing is solved anew, and nothing stale is taken."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from numpy.testing import assert_allclose

from capture.photoset import load_photoset
from capture.tasks.store import TaskStore, kept, listed
from invrender.output.report import run as command
from invrender.output.report.files import photoset_hashes
from invrender.output.report.keptfit import fit_place, keep_fit
from invrender.process import known_light
from invrender.process.pipeline import process
from invrender.transport import columns

from .faultysets import SIZE, change_manifest, change_pixels, write_set
from .test_textures import LAMP_LIT, write_doll_set

Counted = Callable[[Any, str], list[None]]
SETTINGS = {"samples": 2000, "published": False}
LAMPS = r"directional = .*"

pytestmark = pytest.mark.usefixtures("own_cache", "few_forms", "no_figures")


def place_of(folder: Path, settings: dict[str, object]) -> Path:
    photoset = load_photoset(folder)
    store = TaskStore.of(photoset.manifest)
    return fit_place(store, photoset, photoset_hashes(photoset), settings)


def assert_alike(one: Path, other: Path) -> None:
    """Two results are the same but for the time they took."""
    assert {path.relative_to(one) for path in one.rglob("*")} == {
        path.relative_to(other) for path in other.rglob("*")
    }
    first, second = (json.loads((out / "result.json").read_text()) for out in (one, other))
    assert first | {"timing_s": None} == second | {"timing_s": None}
    for path in (one / "predicted").iterdir():
        assert path.read_bytes() == (other / "predicted" / path.name).read_bytes()


@pytest.mark.parametrize(
    "kind",
    [
        pytest.param("known", marks=pytest.mark.slow),
        *(pytest.param(k, marks=pytest.mark.sweep) for k in ("unknown", "paint")),
    ],
)
def test_only_what_lacks_is_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str) -> None:
    paint = kind == "paint"
    folder = write_doll_set(tmp_path, LAMP_LIT) if paint else write_set(tmp_path / "set")
    out = tmp_path / "out"
    if kind == "unknown":
        change_manifest(folder, LAMPS, lambda _: "unknown = true\ndark = true")
    command.run_process(folder, tmp_path / "whole", 1000)
    write, solve = command.write_pictures, command.process

    def stopped(*_: object, **__: object) -> None:
        raise OSError("no space left on the device")

    monkeypatch.setattr(command, "write_pictures", stopped)
    with pytest.raises(ValueError, match="finished result but for predicted photographs and report"):
        command.run_process(folder, out, 1000)
    monkeypatch.setattr(command, "write_pictures", write)
    monkeypatch.setattr(command, "process", lambda *_, **__: pytest.fail("it was solved anew"))
    # Threads predicted the first one's pictures.
    command.run_process(folder, out, 1000, workers=2)
    assert_alike(out, tmp_path / "whole")
    monkeypatch.setattr(command, "process", solve)
    # What is in the result isn't kept any longer.
    kept_on = {"texture-points", "texture-fit"} if paint else {"outlines", "samples"}
    assert {each.stage for each in listed()} == kept_on


def test_whatever_changes_what_is_solved_changes_the_key(tmp_path: Path) -> None:
    folder = write_set(tmp_path / "set")

    def key(**settings: object) -> str:
        return place_of(folder, SETTINGS | settings).name

    keys = [key(), key(samples=3000), key(published=True)]
    assert key() == keys[0]
    change_manifest(folder, r'mask = "001_mask.png"\n', lambda _: "held_out = true\n")
    keys.append(key())
    mask = folder / "002_mask.png"
    mask.write_bytes((folder / "003_mask.png").read_bytes() + b"\0")
    keys.append(key())
    change_pixels(folder, lambda k, pixels: pixels * (1.01 if k == 5 else 1))
    keys.append(key())
    moved = folder.rename(tmp_path / "moved")
    keys.append(place_of(moved, SETTINGS).name)
    assert len(set(keys)) == len(keys)


def test_a_damaged_file_is_no_solution(tmp_path: Path) -> None:
    folder = write_set(tmp_path / "set")
    file = place_of(folder, SETTINGS)
    run = keep_fit(file, process(load_photoset(folder), 1000, causes=False))
    found = kept(file)
    assert found is not None
    photo = run.photoset.photos[0]
    for one, other in zip(run.predictions([photo]), found[0].predictions([photo]), strict=True):
        assert (one.predicted == other.predicted).all()
        assert one.predicted.shape == (SIZE, SIZE, 3)
    file.write_bytes(file.read_bytes()[:-100])
    assert kept(file) is None


@pytest.mark.sweep
def test_under_a_map_a_kept_fit_predicts_what_the_fit_itself_did(
    demo_set_original: Path, tmp_path: Path
) -> None:
    """Forms of the registry are compared by identity: a copy of RH01's was integrated as any other form, 3% off."""
    run = process(load_photoset(demo_set_original), 3000, causes=False)
    photo = run.photoset.photos[0]
    read = keep_fit(tmp_path / "kept", run)
    (one,), (other,) = run.predictions([photo]), read.predictions([photo])
    assert_allclose(other.predicted, one.predicted, rtol=1e-5, atol=1e-7)  # single precision's rounding


@pytest.mark.slow
def test_a_fit_that_was_stopped_takes_the_columns_that_are_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, counted: Counted
) -> None:
    folder, out = write_set(tmp_path / "set"), tmp_path / "out"
    made = counted(columns, "_columns")
    command.run_process(folder, tmp_path / "whole", 1000)
    assert made

    def stopped(*_: object, **__: object) -> None:
        raise ValueError("stopped")

    # The last that a solution needs: all else of it was computed by then.
    with monkeypatch.context() as within:
        within.setattr(known_light, "photo_scores", stopped)
        with pytest.raises(ValueError, match="stopped"):
            command.run_process(folder, out, 1000, workers=2)
    assert "columns" in {each.stage for each in listed()}
    made.clear()
    command.run_process(folder, out, 1000)
    assert not made
    assert_alike(out, tmp_path / "whole")
    assert "columns" not in {each.stage for each in listed()}
