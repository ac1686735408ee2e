"""Floats without a stated white level: what was cut off is found by where values pile up."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from capture.decode import decode
from capture.files.imagefile import write_exr

from .pictures import write


def shaded_ball(colour: Sequence[float], highlight: float = 4.0, size: int = 160) -> np.ndarray:
    """A matte ball with a soft highlight before a black background, noise-free."""
    y, x = (np.mgrid[:size, :size] + 0.5) / size * 2 - 1
    z = np.sqrt(np.clip(0.9 - x**2 - y**2, 0, None))
    towards = (0.5 * x - 0.4 * y + 0.77 * z) * (z > 0)
    shading = np.clip(towards, 0, None)[..., None] * np.array(colour)
    return (shading + highlight * np.exp((towards[..., None] - 0.95) / 0.02) * (z > 0)[..., None]).astype(
        np.float32
    )


@pytest.mark.parametrize("level", [1.0, 0.37])
@pytest.mark.parametrize(
    ("name", "half"), [("a.exr", False), ("a.exr", True), ("a.hdr", False), ("a.tif", False)]
)
def test_floats_that_pile_up_at_their_largest_value_are_saturated(
    tmp_path: Path, name: str, half: bool, level: float
):
    def saturated(pixels: np.ndarray) -> np.ndarray:
        if name.endswith(".exr"):
            write_exr(tmp_path / name, pixels.astype(np.float16 if half else np.float32), half=half)
        else:
            write(tmp_path / name, pixels)
        return decode(tmp_path / name).saturated

    whole = shaded_ball([0.3, 0.25, 0.15])
    assert not saturated(whole).any()
    # As in integer files, the same pixels; what is a step of its format below the level may be rounded up to it.
    rounded = (np.abs(whole / level - 1) < (1 / 128 if name == "a.hdr" else 1 / 1024)).any(axis=2)
    found = saturated(np.minimum(whole, level))
    assert_array_equal(found | rounded, (whole >= level).any(axis=2) | rounded)
    assert found.sum() > 100


@pytest.mark.parametrize(
    "scene",
    [
        pytest.param(np.zeros((90, 120, 3), np.float32), id="black"),
        pytest.param(np.full((90, 120, 3), [0.8, 0.5, 0.3], np.float32), id="a constant wall"),
        pytest.param(
            np.where(np.mgrid[:90, :120][1][..., None] < 60, [0.8, 0.5, 0.3], [0.4, 0.3, 0.2]).astype(
                np.float32
            ),
            id="flat faces, noise-free",
        ),
        pytest.param(shaded_ball([0.9, 0.6, 0.4], 0.0), id="a matte ball, noise-free"),
        pytest.param(shaded_ball([0.9, 0.9, 0.9], 0.0, 600), id="a large grey one"),
    ],
)
def test_what_is_constant_or_smooth_in_a_float_file_is_not_saturated(tmp_path: Path, scene: np.ndarray):
    for half in (False, True):
        write_exr(tmp_path / "a.exr", scene.astype(np.float16 if half else np.float32), half=half)
        assert not decode(tmp_path / "a.exr").saturated.any()
    assert not decode(write(tmp_path / "a.hdr", scene)).saturated.any()


def test_a_grey_picture_cut_off_at_white_is_saturated_there(tmp_path: Path):
    grey = np.minimum(shaded_ball([0.3, 0.3, 0.3]), 1)
    write_exr(tmp_path / "a.exr", grey)
    assert_array_equal(decode(tmp_path / "a.exr").saturated, (grey == 1).all(axis=2))
