"""Colour charts: found, read and fitted in drawn photographs, in a real one, and refused where they are no use."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from capture.chart.chart import Chart, read_chart
from capture.chart.chartsearch import find_chart
from capture.chart.colorfit import fit_color
from capture.chart.colormatrix import ColorMatrix, read_color
from capture.chart.colorrecovery import recover_color
from capture.chart.patches import seen_patches
from capture.files.imagefile import write_exr
from capture.radiance import RadianceImage
from capture.srgb import linear_to_srgb, srgb_to_linear

from .chartpictures import Shot, flat_chart, photographed

Command = Callable[..., tuple[int, str, str]]
Floats = NDArray[np.float64]

# Linear camera RGB of linear sRGB: a camera's channels see neighbours' light, and red and blue are weaker.
CAMERA = np.array([[0.42, 0.16, 0.04], [0.19, 0.85, 0.17], [0.04, 0.18, 0.44]])


def of_neutral_green(camera: Floats) -> Floats:
    """The matrix that undoes a camera's, scaled so that a neutral keeps its green."""
    return np.asarray(np.linalg.inv(camera) * camera[1].sum())


def image_of(picture: NDArray[np.float32]) -> RadianceImage:
    return RadianceImage(picture, np.zeros_like(picture), np.zeros(picture.shape[:2], bool))


def drawn(chart: Chart, reflectance: Floats | None = None) -> NDArray[np.float32]:
    down = chart.layout == "SG140"
    return flat_chart(chart.srgb if reflectance is None else reflectance, 14 if down else 6, down)


def one(folder: Path, shot: Shot = Shot(), name: str = "MCC24", seed: int = 0) -> Path:  # noqa: B008
    """A photograph of a chart as a file."""
    rng = np.random.default_rng(seed)
    folder.mkdir(exist_ok=True)
    write_exr(folder / "chart.exr", photographed(drawn(read_chart(name)), CAMERA, shot, rng))
    return folder / "chart.exr"


@pytest.mark.parametrize("name", ["MCC24", pytest.param("SG140", marks=pytest.mark.slow)])
def test_charts_are_found_patches_read_and_the_matrix_covered(name: str) -> None:
    chart = read_chart(name)
    off = []
    for number in range(12):
        rng = np.random.default_rng(number)
        camera = CAMERA * rng.uniform(0.9, 1.1, (3, 1))
        # No chart is as its maker says: a percent off.
        reflectance = chart.srgb * (1 + 0.01 * rng.standard_normal(chart.srgb.shape))
        slope = rng.uniform(-0.2, 0.2, 2)
        shot = Shot(
            rng.uniform(-25, 25), rng.uniform(-0.25, 0.25), rng.uniform(0.55, 0.75), (slope[0], slope[1]), 0.004,
            rng.uniform(0, 0.01),
        )  # fmt: skip
        picture = photographed(drawn(chart, reflectance), camera, shot, rng)
        seen = seen_patches(image_of(picture), find_chart(picture, chart))
        height, width = picture.shape[:2]
        place = seen.centres / width - [0.5, height / width / 2]
        shown = 0.8 * ((1 + place @ slope)[:, None] * reflectance + shot.glare) @ camera.T
        # Of codes of 8 bits, less than one.
        assert_allclose(seen.rgb, shown, atol=1 / 255)
        fit = fit_color(chart, [seen])
        assert_allclose(fit.glare[0], shot.glare, atol=0.004)  # four standard deviations
        std = np.sqrt(np.diag(fit.covariance)).reshape(3, 3)
        off.append((fit.matrix - of_neutral_green(camera)) / std)
    # 108 deviations, nine and nine of which belong together: their RMS is 1 within 0.26.
    assert 0.7 < np.sqrt(np.mean(np.square(off))) < 1.3
    assert np.mean(np.abs(off) < 2) > 0.9


def test_many_photographs_narrow_the_matrix_down() -> None:
    chart, rng = read_chart("MCC24"), np.random.default_rng(1)
    seen = []
    for turn in (-20.0, -5.0, 10.0, 160.0):
        reflectance = chart.srgb * (1 + 0.01 * rng.standard_normal(chart.srgb.shape))
        picture = photographed(
            drawn(chart, reflectance), (1 + turn / 400) * CAMERA, Shot(turn, noise=0.003), rng
        )
        seen.append(seen_patches(image_of(picture), find_chart(picture, chart)))
    fit, single = fit_color(chart, seen), fit_color(chart, seen[:1])
    assert_allclose(fit.matrix, of_neutral_green(CAMERA), atol=0.03)
    assert np.trace(fit.covariance) < 0.5 * np.trace(single.covariance)


@pytest.mark.parametrize(("name", "table"), [("MCC24-2005", "MACBETH"), ("SG140", "DIGITAL_SG")])
def test_references_are_those_of_opencv(name: str, table: str) -> None:
    count = len(read_chart(name).names)
    model = cv2.ccm.ColorCorrectionModel(
        np.full((count, 1, 3), 0.5), getattr(cv2.ccm, f"COLORCHECKER_{table}")
    )
    model.compute()
    # OpenCV's Lab of a few patches are rounded to two digits.
    assert_allclose(read_chart(name).srgb, np.asarray(model.getRefLinearRGB()).reshape(-1, 3), atol=5e-4)


def test_a_white_is_white_and_a_chart_of_ones_own_is_read(tmp_path: Path) -> None:
    known = read_chart("MCC24")
    flat = tmp_path / "flat.csv"
    lines = [f"{name},{0.2},{0.2},{0.2}" for name in known.names]
    flat.write_text("\n".join(["patch,400,550,700", *lines]))
    assert_allclose(read_chart(str(flat)).srgb, 0.2)
    own = tmp_path / "own.csv"
    own.write_text("\n".join(["patch,L*,a*,b*", *(f"{name},50,0,0" for name in known.names)]))
    # L* = 50 is Y = 0.184 [CIE 15].
    assert_allclose(read_chart(str(own)).srgb, 0.1842, atol=2e-4)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("patch,L,a,b\nwhite,50,0,0", "has 1 patches; 24"),
        ("patch,x,y\n" + "white,1,2\n" * 24, "its headings are patch, x, y"),
        ("patch,L,a,b\n" + "white,50,zero,0\n" * 24, "line 2, column a: 'zero' is no number"),
        ("patch,400,700\n" + "white,50,60\n" * 24, "divide percentages by 100"),
    ],
)
def test_bad_references_are_named(tmp_path: Path, content: str, message: str) -> None:
    path = tmp_path / "own.csv"
    path.write_text(content)
    with pytest.raises(ValueError, match=message):
        read_chart(str(path))


def test_a_real_chart(lightfactor: Command, data_dir: Path, tmp_path: Path) -> None:
    out = tmp_path / "color.json"
    # Of the two vintages the older one fits its colours better.
    shot = data_dir / "raw" / "CRW_0101.CRW"
    code, told, err = lightfactor("calibrate", "color", shot, "--chart", "MCC24-2005", "-o", out)
    assert (code, err) == (0, "")
    assert "light varies by 2" in told
    document = json.loads(out.read_text())
    (photo,) = document["photos"]
    assert abs(document["exponent"] - 1) < 3 * document["exponent_std"] < 0.2
    greys = photo["patches"][18:]
    # Within 1% of white.
    shown, reference = (np.array([grey[key] for grey in greys]) for key in ("corrected", "reference"))
    assert_allclose(shown @ [0.2126, 0.7152, 0.0722], reference @ [0.2126, 0.7152, 0.0722], atol=0.005)
    assert_allclose(shown, reference, atol=0.01)
    # Cameras see some colours otherwise than people: matrices of compact cameras leave 2 in the mean.
    assert document["delta_e_2000"]["mean"] < 2.5
    assert (tmp_path / "color-figure.png").is_file()


def test_faults_of_photographs_are_named(tmp_path: Path) -> None:
    def refused(picture: NDArray[np.float32], message: str, named: str = "MCC24") -> None:
        path = tmp_path / "photo.exr"
        write_exr(path, picture)
        with pytest.raises(ValueError, match=f"photo.exr: .*{message}"):
            recover_color([path], named)

    rng, chart = np.random.default_rng(0), read_chart("MCC24")
    whole = photographed(drawn(chart), CAMERA, Shot(), rng)
    refused(np.full_like(whole, 0.4), "no MCC24 chart is found")
    refused(whole, "laid out like MCC24", "SG140")
    small = photographed(drawn(chart), CAMERA, Shot(size=0.4, shift=(-0.24, 0)), rng)
    refused(np.hstack([small[:, :300], small[:, :300]]), "2 charts are found")
    refused(photographed(drawn(chart), CAMERA, Shot(shift=(0.35, 0)), rng), "chart")
    cut = np.minimum(whole, 0.6 * whole.max(axis=(0, 1)))
    refused(cut, "patches, 'orange' among them, are saturated")
    wrong = drawn(chart, chart.srgb[np.random.default_rng(3).permutation(24)])
    refused(photographed(wrong, CAMERA, Shot(), rng), "chart")


def test_what_is_wrong_with_the_light_is_said(tmp_path: Path) -> None:
    assert recover_color([one(tmp_path / "good", Shot(noise=0.002))], "MCC24").warnings == []
    for shot, said in (
        (Shot(slope=(0.3, 0.0)), "light varies by"),
        (Shot(glare=0.03), "glare adds 3.0% of white"),
    ):
        (warning,) = recover_color([one(tmp_path / "bad", shot)], "MCC24").warnings
        assert said in warning
    old = recover_color([one(tmp_path / "old", Shot(), "MCC24-2005")], "MCC24")
    assert any("--chart MCC24-2005" in warning for warning in old.warnings)


def test_a_curve_that_is_taken_for_linear_is_noticed(tmp_path: Path) -> None:
    picture = photographed(drawn(read_chart("MCC24")), CAMERA, Shot(), np.random.default_rng(0))
    codes = np.round(255 * linear_to_srgb(np.clip(picture, 0, 1))).astype(np.uint8)
    path = tmp_path / "photo.png"
    cv2.imwrite(str(path), codes[..., ::-1])
    assert any("aren't linear" in warning for warning in recover_color([path], "MCC24").warnings)
    found = recover_color([path], "MCC24", "srgb")
    assert found.warnings == []
    # Of the curve's 8 bits.
    assert_allclose(found.fit.matrix, of_neutral_green(CAMERA), atol=0.03)


def test_a_photograph_in_linear_srgb() -> None:
    rng = np.random.default_rng(0)
    camera = rng.uniform(0.1, 1, (8, 6, 3)).astype(np.float32)
    variance = rng.uniform(1e-5, 1e-4, (8, 6, 3)).astype(np.float32)
    matrix = ColorMatrix(np.linalg.inv(CAMERA), np.zeros((9, 9)))
    found = matrix.applied(RadianceImage(camera, variance, np.zeros((8, 6), bool)))
    assert_allclose(found.radiance @ CAMERA.T, camera, rtol=1e-5, atol=1e-6)
    # Against draws of the noise.
    draws = (camera[3, 2] + np.sqrt(variance[3, 2]) * rng.standard_normal((200_000, 3))) @ matrix.matrix.T
    assert_allclose(found.variance[3, 2], draws.var(axis=0), rtol=0.02)
    rows, columns = np.array([3, 5]), np.array([2, 1])
    assert_allclose(found.variance_at(rows, columns), found.variance[rows, columns], rtol=1e-6)


def test_a_matrix_that_was_written_is_read_and_faults_of_it_named(tmp_path: Path) -> None:
    matrix = ColorMatrix(np.linalg.inv(CAMERA), 1e-4 * np.eye(9))
    path = tmp_path / "color.json"
    document = {"format": 1, "matrix": matrix.matrix.tolist(), "covariance": matrix.covariance.tolist()}
    path.write_text(json.dumps(document))
    assert_allclose(read_color(path).matrix, matrix.matrix)
    # dM M^-1 of a matrix whose entries are off independently: rows are, too.
    draws = np.random.default_rng(0).standard_normal((100_000, 3, 3)) * 1e-2 @ CAMERA
    assert_allclose(
        np.cov(draws.reshape(-1, 9).T),
        matrix.relative_covariance,
        atol=0.02 * matrix.relative_covariance.max(),
    )
    for change, message in (
        ({"format": 2}, "format is 2"),
        ({"covariance": [[1.0]]}, "nine rows of nine"),
        ({"matrix": [[1, 0, 0], [1, 0, 0], [0, 0, 1]]}, "singular"),
    ):
        path.write_text(json.dumps(document | change))
        with pytest.raises(ValueError, match=f"color.json: .*{message}"):
            read_color(path)


def test_codes_of_srgb_go_both_ways() -> None:
    codes = np.linspace(0, 1, 256)
    assert_allclose(linear_to_srgb(srgb_to_linear(codes)), codes, atol=1e-6)
