"""The `mirrorball` command: what it writes, what it refuses."""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib
from pathlib import Path

import cv2
import numpy as np
import pytest
import typer
from PIL import Image
from typer.testing import CliRunner

from capture.imagefile import write_exr
from capture.lighting import read_latlong
from capture.manifest import LightingTable
from recon.cli import mirrorball

CENTRE, RADIUS, SIZE = (82.0, 78.0), 60.0, 160
# A highlight 20 px to the right of the centre and 10 px above it, and what it mirrors from far away:
# the normal there is (20, 10, sqrt(r^2 - 500)) / r, the light is at 2 (n.z) n - z.
SPOT = (CENTRE[0] + 20, CENTRE[1] - 10)
NORMAL = np.array([20, 10, np.sqrt(RADIUS**2 - 500)]) / RADIUS
LIGHT = 2 * NORMAL[2] * NORMAL - np.array([0, 0, 1])


@pytest.fixture
def shots(tmp_path: Path) -> Path:
    """A folder with a ball in floats, the same clipped to 8 bits, and its mask."""
    y, x = np.mgrid[:SIZE, :SIZE] + 0.5
    ball = np.hypot(x - CENTRE[0], y - CENTRE[1]) < RADIUS
    spot = np.hypot(x - SPOT[0], y - SPOT[1]) < 2.6
    radiance = np.repeat((0.2 * ball + 20.0 * spot)[..., None], 3, axis=2)
    write_exr(tmp_path / "float.exr", radiance)
    cv2.imwrite(str(tmp_path / "clipped.png"), np.minimum(np.round(radiance * 255), 255).astype(np.uint8))
    cv2.imwrite(str(tmp_path / "mask.png"), ball.astype(np.uint8) * 255)
    return tmp_path


def run(*arguments: str | Path) -> str:
    app = typer.Typer()
    app.command()(mirrorball)
    result = CliRunner(env={"COLUMNS": "120"}).invoke(app, [str(argument) for argument in arguments])
    if result.exception is not None:
        raise result.exception
    return result.output


def test_results_of_an_exposed_and_a_clipped_photograph(shots: Path) -> None:
    out = shots / "out"
    text = run(
        shots / "float.exr", shots / "clipped.png", "--mask", shots / "mask.png", "--height", "16", "-o", out
    )
    names = {"float.exr", "clipped.exr", "lighting.json", "lighting.toml", "mirrorball.png"}
    assert {path.name for path in out.iterdir()} == names
    assert "lower bound" in text
    assert "≥" in text

    result = json.loads((out / "lighting.json").read_text())
    assert result["format"] == 1
    digests = result["inputs"]
    assert set(digests) == {str(shots / name) for name in ("float.exr", "clipped.png", "mask.png")}
    exposed, clipped = result["photos"]
    np.testing.assert_allclose(exposed["ball_centre_px"], CENTRE, atol=0.1)  # a binary mask
    assert exposed["ball_radius_px"] == pytest.approx(RADIUS, abs=0.2)
    for entry in (exposed, clipped):
        (source,) = entry["sources"]
        # The spot's 21 binary pixels are centred to a tenth of a pixel; a pixel mirrors 1.9 degrees.
        assert np.degrees(np.arccos(np.dot(source["direction"], LIGHT))) < 0.5
    assert not exposed["sources"][0]["clipped"]
    assert clipped["sources"][0]["clipped"]
    assert exposed["sources"][0]["relative_irradiance"] == 1
    # A pixel mirrors 4 / r^2 sr: 20 above the background in each of the spot's pixels.
    y, x = np.mgrid[:SIZE, :SIZE] + 0.5
    count = (np.hypot(x - SPOT[0], y - SPOT[1]) < 2.6).sum()
    # The fitted radius is good to 0.2 %, and enters squared; the pixels' curved edges cost another percent.
    np.testing.assert_allclose(exposed["sources"][0]["irradiance"], 20 * count * 4 / RADIUS**2, rtol=0.02)
    np.testing.assert_allclose(read_latlong(out / "float.exr"), 0.2, rtol=1e-5)  # float32

    tables = tomllib.loads((out / "lighting.toml").read_text())["lighting"]
    known, recovered = (LightingTable.model_validate(table, strict=False) for table in tables)
    assert known.map == "float.exr"
    assert known.recover is None
    assert known.directional[0].irradiance == pytest.approx(exposed["sources"][0]["irradiance"], rel=1e-4)
    assert recovered.map == "clipped.exr"
    assert recovered.recover == ("irradiance",)
    assert recovered.directional[0].irradiance is None
    assert recovered.directional[0].direction == pytest.approx(clipped["sources"][0]["direction"], abs=1e-5)


def test_a_camera_from_nearby_sees_the_light_elsewhere(shots: Path) -> None:
    common = (shots / "float.exr", "--mask", shots / "mask.png", "--height", "8")
    camera = {"model": "PINHOLE", "params": [300.0, 300.0, 80.0, 80.0], "width": SIZE, "height": SIZE}
    (shots / "camera.json").write_text(json.dumps(camera))
    run(*common, "--focal-px", "300", "-o", shots / "focal")
    run(*common, "--camera", shots / "camera.json", "-o", shots / "camera")
    run(*common, "-o", shots / "far")
    focal, file, far = (
        json.loads((shots / name / "lighting.json").read_text())["photos"][0]["sources"][0]["direction"]
        for name in ("focal", "camera", "far")
    )
    assert focal == file
    # The ray through the spot is atan(22 / 300) = 4 degrees off the axis.
    assert 2 < np.degrees(np.arccos(np.dot(focal, far))) < 10


def test_exposures_are_divided_out(shots: Path) -> None:
    picture = cv2.imread(str(shots / "clipped.png"))
    exif = Image.Exif()
    exif[34665] = {33434: 0.25, 34855: 200}  # seconds and ISO: an exposure of a half
    Image.fromarray(picture).save(shots / "exif.png", exif=exif)
    run(
        shots / "exif.png",
        "--mask",
        shots / "mask.png",
        "--exposure",
        "exif",
        "--height",
        "8",
        "-o",
        shots / "out",
    )
    np.testing.assert_allclose(read_latlong(shots / "out" / "exif.exr"), 51 / 255 / 0.5, rtol=1e-5)  # float32
    with pytest.raises(
        ValueError, match=r"clipped\.png: its EXIF holds no exposure time; .* --exposure equal"
    ):
        run(shots / "clipped.png", "--mask", shots / "mask.png", "--exposure", "exif", "-o", shots / "none")


def test_an_earlier_result_is_replaced_and_nothing_else(shots: Path) -> None:
    out = shots / "out"
    common = ("--mask", shots / "mask.png", "--height", "8", "-o", out)
    run(shots / "clipped.png", *common)
    run(shots / "float.exr", *common)
    assert not (out / "clipped.exr").exists()
    assert not [path for path in shots.iterdir() if path.name.startswith(".out")]
    (out / "photoset.toml").write_text("mine")
    with pytest.raises(ValueError, match=r"out: holds 'photoset\.toml', which is no result of this command"):
        run(shots / "float.exr", *common)
    assert (out / "photoset.toml").read_text() == "mine"
    with pytest.raises(ValueError, match="is a file; give the name of a folder"):
        run(shots / "float.exr", "--mask", shots / "mask.png", "-o", shots / "mask.png")


def test_contradictions_are_refused(shots: Path) -> None:
    mask = ("--mask", shots / "mask.png")
    with pytest.raises(ValueError, match="--camera and --focal-px both give the camera"):
        run(shots / "float.exr", "--camera", shots / "camera.json", "--focal-px", "300")
    with pytest.raises(ValueError, match="2 masks for 3 photos"):
        run(*[shots / "float.exr"] * 3, *mask, *mask)
    with pytest.raises(ValueError, match="two photos are named 'float'"):
        run(*[shots / "float.exr"] * 2, *mask)
    with pytest.raises(ValueError, match=r"nowhere\.png: does not exist"):
        run(shots / "nowhere.png", *mask, "-o", shots / "out")
    assert not (shots / "out").exists()


def test_help_needs_no_heavy_import() -> None:
    script = "import sys, recon.cli; print({'numpy', 'cv2', 'scipy', 'matplotlib'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"
