"""Sets that photometric stereo refuses, in words that name the fault, and commands that name the way on."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.invrender.stereosets import write_small

Lightfactor = Callable[..., tuple[int, str, str]]


@pytest.fixture
def small(tmp_path: Path) -> Path:
    return write_small(tmp_path / "small")


def changed(folder: Path, change: Callable[[str], str]) -> None:
    path = folder / "photoset.toml"
    path.write_text(change(path.read_text(encoding="utf-8")), encoding="utf-8")


FAULTS = {
    "no mask": (lambda text: re.sub(r"mask = .*\n", "", text), "no photo has a mask"),
    "two lamps": (
        lambda text: re.sub(
            r"directional = \[(\{.*?\})\]", r"directional = [\1, \1]", text, count=1, flags=re.S
        ),
        "has 2 lamps",
    ),
    "recovers": (
        lambda text: re.sub(r"(\[\[lighting\]\]\n)", r"\1recover = ['irradiance']\n", text, count=1),
        "recovers irradiance; shape = 'normals' takes measured lamps",
    ),
    "no map": (lambda text: text.replace('"unknown"', '"lost.npz"'), "lost.npz: does not exist"),
    "no word": (
        lambda text: text.replace('normals = "unknown"\n', ""),
        "needs normals = the file of a normal map",
    ),
    "texture": (
        lambda text: text.replace('"unknown"', '"unknown"\ntexture = true'),
        "texture is not for shape",
    ),
    "mesh": (
        lambda text: text.replace('"unknown"', '"unknown"\nmesh = "a.obj"'),
        "mesh is for shape = 'mesh'",
    ),
}


@pytest.mark.parametrize("fault", list(FAULTS))
def test_what_does_not_fit_is_said(small: Path, tmp_path: Path, lightfactor: Lightfactor, fault: str) -> None:
    change, said = FAULTS[fault]
    changed(small, change)
    status, _, error = lightfactor("process", small, "-o", tmp_path / "out")
    assert status
    assert said in error
    assert not (tmp_path / "out").exists()


def test_lamps_on_a_line_are_refused(small: Path, tmp_path: Path, lightfactor: Lightfactor) -> None:
    text = (small / "photoset.toml").read_text(encoding="utf-8")
    places = iter(range(9))

    def on_a_line(match: re.Match[str]) -> str:
        turn = np.radians(15 * next(places) - 20)
        return f"direction = [{np.cos(turn)}, {np.sin(turn)}, 0.0]"

    changed(small, lambda text: re.sub(r"direction = \[[^\]]*\]", on_a_line, text))
    assert text != (small / "photoset.toml").read_text(encoding="utf-8")
    status, _, error = lightfactor("process", small, "-o", tmp_path / "out")
    assert status
    assert "the lamps lie on a line" in error
    assert "off that line" in error


def test_options_that_do_nothing_are_refused(small: Path, tmp_path: Path, lightfactor: Lightfactor) -> None:
    status, _, error = lightfactor("process", small, "-o", tmp_path / "out", "--workers", "2")
    assert status
    assert "--workers does nothing for a set with shape = 'normals'" in error


def test_other_commands_name_the_way_on(small: Path, tmp_path: Path, lightfactor: Lightfactor) -> None:
    for command in ("samples", "factor", "brdf"):
        status, _, error = lightfactor(command, small, "-o", tmp_path / "out")
        assert status
        assert "`lightfactor integrate` makes a mesh" in error
