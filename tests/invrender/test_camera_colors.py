"""A photo set in a camera's own colours, with its matrix: linear sRGB, and bars that hold the matrix's."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from capture.files.imagefile import read_pixels, write_exr
from capture.photoset import load_photoset
from invrender.brdf.lobes import GGX_FORM
from invrender.estimate.textured.textures import FittedTextures
from invrender.process.pipeline import process

from .faultysets import change_manifest, change_pixels, write_set
from .test_textures import LAMP_LIT, write_doll_set

Floats = NDArray[np.float64]

# Linear camera RGB of linear sRGB.
CAMERA = np.array([[0.42, 0.16, 0.04], [0.19, 0.85, 0.17], [0.04, 0.18, 0.44]])
MATRIX = np.linalg.inv(CAMERA)
# One way in which the matrix may be off by one standard deviation.
OFF = 0.01 * np.array([[1.0, -0.5, 0.2], [0.3, 1.5, -0.4], [-0.2, 0.6, -1.2]]) @ MATRIX


def solved(folder: Path, matrix: Floats, covariance: Floats) -> dict[str, Any]:
    document = {"format": 1, "matrix": matrix.tolist(), "covariance": covariance.tolist()}
    (folder / "color.json").write_text(json.dumps(document))
    return dict(process(load_photoset(folder), 1000, causes=False).solution.quantities)


@pytest.mark.slow
@pytest.mark.usefixtures("few_forms")
def test_a_cameras_colours_are_undone_and_error_bars_hold_the_matrix(tmp_path: Path) -> None:
    folder = write_set(tmp_path / "set")
    given = process(load_photoset(folder), 1000, causes=False).solution.quantities
    change_pixels(folder, lambda _, pixels: pixels @ CAMERA.T)
    change_manifest(folder, r'encoding = "linear"', lambda found: f'{found[0]}\ncolor = "color.json"')
    exact = solved(folder, MATRIX, np.zeros((9, 9)))
    # Noise is weighed otherwise where channels share it.
    for name in ("kd", "sigma"):
        assert_allclose(exact[name].value, given[name].value, atol=float(given[name].std.max()))
    sure, doubted = exact["kd"], solved(folder, MATRIX, np.outer(OFF, OFF))["kd"]
    moved = solved(folder, MATRIX + OFF, np.zeros((9, 9)))["kd"]
    added = np.sqrt(doubted.std**2 - sure.std**2)
    # To first order, of a matrix that is off by a percent.
    assert_allclose(added, np.abs(moved.value - sure.value), rtol=0.05, atol=2e-4)
    assert doubted.shares["color"] > 0.5


@pytest.mark.slow
def test_bars_of_a_texture_hold_the_matrix(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("invrender.estimate.textured.fit.OTHER_FORMS", (GGX_FORM,))
    folder = write_doll_set(tmp_path, LAMP_LIT)
    for path in folder.glob("[0-9][0-9][0-9].exr"):
        write_exr(path, (read_pixels(path) @ CAMERA.T).astype(np.float32))
    change_manifest(folder, r'encoding = "linear"', lambda found: f'{found[0]}\ncolor = "color.json"')

    def painted(matrix: Floats, covariance: Floats) -> FittedTextures:
        document = {"format": 1, "matrix": matrix.tolist(), "covariance": covariance.tolist()}
        (folder / "color.json").write_text(json.dumps(document))
        run = process(load_photoset(folder), 2000)
        assert run.textures is not None
        return run.textures

    sure, doubted = painted(MATRIX, np.zeros((9, 9))), painted(MATRIX, np.outer(OFF, OFF))
    moved = painted(MATRIX + OFF, np.zeros((9, 9)))
    known = sure.known & doubted.known & moved.known & (sure.kd > 0).all(axis=1)
    added = np.sqrt(doubted.kd_std[known] ** 2 - sure.kd_std[known] ** 2)
    # To first order, of a matrix that is off by a percent; Ks takes a part of what moves.
    off = np.abs(moved.kd[known] - sure.kd[known])
    assert_allclose(
        np.median(added / sure.kd[known], axis=0), np.median(off / sure.kd[known], axis=0), rtol=0.1
    )


def test_white_is_balanced_once(tmp_path: Path) -> None:
    folder = write_set(tmp_path / "set")
    change_manifest(
        folder,
        r'encoding = "linear"',
        lambda found: f'{found[0]}\ncolor = "c.json"\nwhite_balance = [1, 1, 2]',
    )
    with pytest.raises(ValueError, match="color balances white already"):
        load_photoset(folder)


def test_a_matrix_that_is_missing_is_named(tmp_path: Path) -> None:
    folder = write_set(tmp_path / "set")
    change_manifest(folder, r'encoding = "linear"', lambda found: f'{found[0]}\ncolor = "c.json"')
    with pytest.raises(ValueError, match=r"c\.json"):
        load_photoset(folder)
