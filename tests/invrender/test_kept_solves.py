"""What `factor`, `light` and `refine` have solved is there when they run again, and solved anew if it may differ."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from capture.files.imagefile import read_pixels, write_exr
from invrender.factor import run as factoring
from invrender.inverse_lighting import estimate as lighting
from invrender.refine import alternate

from .faultysets import LAMPS, change_pixels, write_set
from .test_refine import write_egg_set

Command = Callable[..., tuple[int, str, str]]
Counted = Callable[[Any, str], list[None]]
BRDF = ["--kd", "0.2", "--ks", "0.1", "--mu", "1.5", "--sigma", "0.15", "--degree", "3"]


pytestmark = pytest.mark.usefixtures("own_cache", "few_forms", "no_figures")


def numbers(path: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return found | {"timing_s": None}


@pytest.mark.parametrize(
    ("command", "options", "module", "solver", "document"),
    [
        ("light", BRDF, lighting, "_solved", "lighting.json"),
        pytest.param(
            *("factor", ["--order", "4", "--no-ladder"], factoring, "factor", "result.json"),
            marks=pytest.mark.sweep,
        ),
    ],
)
def test_solved_once(
    lightfactor: Command,
    small_set: Path,
    tmp_path: Path,
    counted: Counted,
    command: str,
    options: list[str],
    module: Any,
    solver: str,
    document: str,
) -> None:
    solved = counted(module, solver)

    def run(name: str, *more: str) -> dict[str, Any]:
        out = tmp_path / name
        code, _, err = lightfactor(command, small_set, "-o", out, "--samples", 1000, *options, *more)
        assert (code, err) == (0, "")
        return numbers(out / document)

    first = run("first")
    assert run("again") == first
    assert len(solved) == 1
    assert run("fresh", "--fresh") == first
    assert len(solved) == 2
    photo = min(small_set.glob("*.exr"))
    write_exr(photo, read_pixels(photo) * np.float32(1.01))
    assert run("brighter") != first
    assert len(solved) == 3


@pytest.mark.sweep
def test_of_many_lightings_those_that_changed_are_solved_anew(
    lightfactor: Command, tmp_path: Path, counted: Counted
) -> None:
    folder = write_set(tmp_path / "set")
    solved = counted(lighting, "_solved")
    for _ in range(2):
        assert lightfactor("light", folder, "-o", tmp_path / "out", "--samples", 2000, *BRDF)[0] == 0
    assert len(solved) == len(LAMPS)
    change_pixels(folder, lambda k, pixels: pixels * (1.01 if k == 3 else 1))
    assert lightfactor("light", folder, "-o", tmp_path / "out", "--samples", 2000, *BRDF)[0] == 0
    assert len(solved) == len(LAMPS) + 1


@pytest.mark.sweep
def test_rounds_of_refinement_are_not_repeated(
    lightfactor: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, counted: Counted
) -> None:
    folder = write_egg_set(tmp_path)
    rounds = counted(alternate, "process")
    refined = alternate._refined

    def stopped(*_: object) -> None:
        raise OSError("no space left on the device")

    options = ("refine", folder, "--samples", 1000, "--turn-deg", 1.5)
    monkeypatch.setattr(
        alternate, "_refined", lambda *given: stopped() if len(rounds) == 2 else refined(*given)
    )
    code, _, _ = lightfactor(*options)
    assert (code, len(rounds)) == (1, 2)
    monkeypatch.setattr(alternate, "_refined", refined)
    assert lightfactor(*options)[0] == 0
    # The first round was there.
    went_on = len(rounds) - 2
    found = numbers(folder / "refined-poses.json")
    assert lightfactor(*options, "--fresh")[0] == 0
    assert len(rounds) - 2 - went_on == went_on + 1
    assert numbers(folder / "refined-poses.json") == found
