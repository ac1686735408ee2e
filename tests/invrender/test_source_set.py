"""The photo set that a result was made from is known, whatever of it has changed that pictures don't ask for."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from invrender.plan.from_result import result_experiment
from invrender.result.saved import read_result
from invrender.result.source_set import find_photoset

from .faultysets import change_manifest


@pytest.fixture
def folder(fitted_original: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(fitted_original, tmp_path / "set"))


def test_masks_lights_and_held_out_photographs_may_change(folder: Path) -> None:
    result = read_result(folder / "fit")
    before = result_experiment(result)
    change_manifest(folder, r'mask = "001_mask.png"\n', lambda _: "held_out = true\n")
    change_manifest(folder, r'name = "lamp 7"\n', lambda line: f"{line[0]}# moved since\n")
    for given in (None, folder):
        assert find_photoset(result, given) is not None
    # The plan is of what was fitted, not of what will be.
    assert [view.name for view in result_experiment(result).views] == [view.name for view in before.views]


@pytest.mark.parametrize(
    ("pattern", "instead"),
    [
        (r"params = \[9", "params = [8"),
        (r"0\.6\], \[0", "0.61], [0"),
        (r'file = "007.exr"', 'file = "other.exr"'),
    ],
    ids=["lens", "pose", "photograph"],
)
def test_a_set_with_other_cameras_is_another_one(folder: Path, pattern: str, instead: str) -> None:
    shutil.copyfile(folder / "007.exr", folder / "other.exr")
    change_manifest(folder, pattern, lambda _: instead)
    result = read_result(folder / "fit")
    assert find_photoset(result, None) is None
    with pytest.raises(ValueError, match="cameras, poses or photographs have changed since"):
        find_photoset(result, folder)
