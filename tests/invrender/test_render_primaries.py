"""Pictures in other primaries: the numbers are turned into these, and files say which they are."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from numpy.testing import assert_allclose
from PIL import Image

from capture.files.imagefile import read_exr_layers, read_pixels
from capture.primaries import PRIMARIES
from capture.srgb import linear_to_srgb

Command = Callable[..., tuple[int, str, str]]


def test_pictures_in_other_primaries_say_so(lightfactor: Command, workshop: Path, tmp_path: Path) -> None:
    def rendered(name: str, *more: str) -> Path:
        out = tmp_path / name
        code, _, err = lightfactor("render", workshop / "result", "-o", out, "--size", "40x30", *more)
        assert (code, err) == (0, "")
        return out

    plain = rendered("plain.exr")
    assert "chromaticities" not in OpenEXR.File(str(plain)).header()
    for primaries in PRIMARIES.values():
        path = rendered(f"{primaries.name}.exr", "--primaries", primaries.name)
        # Single precision.
        assert_allclose(
            OpenEXR.File(str(path)).header()["chromaticities"], primaries.chromaticities, atol=1e-6
        )
        back = read_pixels(path) @ np.linalg.inv(primaries.of_srgb).T
        assert_allclose(back, read_pixels(plain), atol=1e-6)
    path = rendered("p3.png", "--primaries", "p3", "--exposure", "0")
    # Another program reads the old chunk: white, red, green and blue in turn.
    with Image.open(path) as picture:
        assert_allclose(picture.info["chromaticity"], np.roll(PRIMARIES["p3"].chromaticities, 2), atol=1e-5)
        seen = np.asarray(picture).astype(float)[..., :3] / 255
    assert b"cICP" + bytes([12, 13, 0, 1]) in path.read_bytes()
    # Inside of the outline, where alpha is whole.
    linear = read_pixels(tmp_path / "p3.exr")
    whole = read_exr_layers(plain)["A"] == 1
    assert_allclose(seen[whole], linear_to_srgb(np.clip(linear, 0, 1))[whole], atol=0.6 / 255)


@pytest.mark.parametrize(
    ("out", "options", "message"),
    [
        ("x.png", ["--primaries", "acescg"], "its white isn't D65"),
        ("x.exr", ["--primaries", "rec2021"], "did you mean 'rec2020'"),
        ("x.exr", ["--primaries", "p3", "--std"], "leave --primaries or --std out"),
    ],
)
def test_primaries_that_no_file_holds_are_refused(
    lightfactor: Command, workshop: Path, tmp_path: Path, out: str, options: list[str], message: str
) -> None:
    code, _, err = lightfactor("render", workshop / "result", "-o", tmp_path / out, *options)
    assert code != 0
    assert message in err
