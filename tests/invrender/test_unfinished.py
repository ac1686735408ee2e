"""A run that was stopped among its pictures goes on there: nothing is solved anew, and nothing stale is taken."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
from numpy.testing import assert_allclose

from capture.files.imagefile import read_pixels
from capture.photoset import load_photoset
from invrender.output.report import run as command
from invrender.output.report.files import photoset_hashes
from invrender.output.report.unfinished import keep_run, kept_run, unfinished_key
from invrender.process.pipeline import process

from .faultysets import SIZE, change_manifest, change_pixels, write_set

SETTINGS = {"samples": 2000, "published": False}
LAMPS = r"directional = .*"


def key_of(folder: Path, settings: dict[str, object]) -> str:
    photoset = load_photoset(folder)
    return unfinished_key(photoset, photoset_hashes(photoset), settings)


def assert_alike(one: Path, other: Path) -> None:
    """Two results are the same but for the time they took, pictures and their errors to rounding."""
    assert {path.relative_to(one) for path in one.rglob("*")} == {
        path.relative_to(other) for path in other.rglob("*")
    }
    first, second = (json.loads((out / "result.json").read_text()) for out in (one, other))
    assert (first["brdf"], first["lighting"]) == (second["brdf"], second["lighting"])
    assert_allclose(
        *([photo["rms_relative"] for photo in found["photos"]] for found in (first, second)), rtol=1e-5
    )
    for path in (one / "predicted").iterdir():
        # Sums over arrays that lie otherwise in memory, in single precision.
        pixels = read_pixels(path)
        assert_allclose(pixels, read_pixels(other / "predicted" / path.name), atol=3e-7 * pixels.max())


@pytest.mark.parametrize("light", ["known", pytest.param("unknown", marks=pytest.mark.slow)])
def test_only_what_lacks_is_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, light: str) -> None:
    folder, out = write_set(tmp_path / "set"), tmp_path / "out"
    if light == "unknown":
        change_manifest(folder, LAMPS, lambda _: "unknown = true\ndark = true")
    command.run_process(folder, tmp_path / "whole", 2000)
    write, solve = command.write_pictures, command.process

    def stopped(*_: object) -> None:
        raise OSError("no space left on the device")

    monkeypatch.setattr(command, "write_pictures", stopped)
    with pytest.raises(ValueError, match="finished result but for predicted photographs and report"):
        command.run_process(folder, out, 2000)
    monkeypatch.setattr(command, "write_pictures", write)
    monkeypatch.setattr(command, "process", lambda *_, **__: pytest.fail("it was solved anew"))
    command.run_process(folder, out, 2000)
    assert_alike(out, tmp_path / "whole")
    # What is done isn't kept.
    assert not list(Path(os.environ["LIGHTFACTOR_CACHE"]).iterdir())
    monkeypatch.setattr(command, "process", solve)
    assert kept_run(key_of(folder, SETTINGS)) is None


def test_whatever_changes_what_is_solved_changes_the_key(tmp_path: Path) -> None:
    folder = write_set(tmp_path / "set")

    def key(**settings: object) -> str:
        return key_of(folder, SETTINGS | settings)

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
    keys.append(key_of(moved, SETTINGS))
    assert len(set(keys)) == len(keys)


def test_a_damaged_file_is_no_solution(tmp_path: Path) -> None:
    folder = write_set(tmp_path / "set")
    run = process(load_photoset(folder), 2000, causes=False)
    keep_run("key", run)
    (file,) = Path(os.environ["LIGHTFACTOR_CACHE"]).glob("key.run")
    assert oct(file.parent.stat().st_mode)[-3:] == "700"
    found = kept_run("key")
    assert found is not None
    photo = run.photoset.photos[0]
    for one, other in zip(run.predictions([photo]), found.predictions([photo]), strict=True):
        assert (one.predicted == other.predicted).all()
        assert one.predicted.shape == (SIZE, SIZE, 3)
    file.write_bytes(file.read_bytes()[:-100])
    assert kept_run("key") is None
    file.unlink()
