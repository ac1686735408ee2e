"""The `mirrorball` command: what it writes, what it refuses."""

from __future__ import annotations

import json
import re
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

from capture.files.imagefile import read_pixels, write_exr
from capture.lighting import Lighting, read_latlong
from capture.manifest import LightingTable
from capture.photoset import load_photoset
from recon.commands.mirrorball import mirrorball
from recon.lighting import read_lighting

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
    script = "import sys, recon.commands.mirrorball; print({'numpy', 'cv2', 'scipy', 'matplotlib'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


def test_a_bracket_is_one_view(shots: Path) -> None:
    radiance = np.asarray(cv2.imread(str(shots / "mask.png")), float) / 255 * 0.2
    y, x = np.mgrid[:SIZE, :SIZE] + 0.5
    radiance[np.hypot(x - SPOT[0], y - SPOT[1]) < 2.6] = 20.0
    times = {"long": 1.0, "middle": 1 / 8, "short": 1 / 40}
    for name, seconds in times.items():
        codes = np.clip(np.round(radiance * seconds * 65535), 0, 65535).astype(np.uint16)
        cv2.imwrite(str(shots / f"{name}.png"), codes)
    photos = [shots / f"{name}.png" for name in times]
    common = ("--mask", shots / "mask.png", "--height", "8", "--bracket", "3")
    out = shots / "out"
    # The order of a bracket's photos doesn't matter.
    run(*photos[::-1], *common, "--times", "1/40,1/8,1", "--reflectance", "0.5", "-o", out)
    result = json.loads((out / "lighting.json").read_text())
    (entry,) = result["photos"]
    assert entry["photo"] == str(photos[2])
    assert set(result["inputs"]) == {str(path) for path in (*photos, shots / "mask.png")}
    (source,) = entry["sources"]
    assert not source["clipped"]
    count = (np.hypot(x - SPOT[0], y - SPOT[1]) < 2.6).sum()
    # Light is twice what the ball shows; the rest as for a single photograph.
    np.testing.assert_allclose(source["irradiance"], 2 * 20 * count * 4 / RADIUS**2, rtol=0.02)
    np.testing.assert_allclose(read_latlong(out / "short.exr"), 0.4, rtol=1e-3)  # 16 bits of a fortieth
    with pytest.raises(ValueError, match=r"long\.png: its EXIF holds no exposure time; give --times"):
        run(*photos, *common, "-o", shots / "none")
    with pytest.raises(ValueError, match="3 photos cannot be brackets of 2"):
        run(*photos, "--bracket", "2", "-o", shots / "none")


def test_views_are_merged_where_the_camera_went(shots: Path) -> None:
    y, x = np.mgrid[:SIZE, :SIZE] + 0.5
    ball = np.hypot(x - CENTRE[0], y - CENTRE[1]) < RADIUS
    # A lamp to the right of the ball as the first camera sees it: mirrored where the normal leans by 45 degrees;
    # and by the middle of the ball for a camera that went there.
    places = {"front": CENTRE[0] + RADIUS * np.sqrt(0.5), "right": CENTRE[0]}
    for name, column in places.items():
        spot = np.hypot(x - column, y - CENTRE[1]) < 2.6
        write_exr(shots / f"{name}.exr", np.repeat((0.2 * ball + 20.0 * spot)[..., None], 3, axis=2))
    photos = (shots / "front.exr", shots / "right.exr")
    common = ("--mask", shots / "mask.png", "--height", "16")
    text = run(*photos, *common, "--view-angle-deg", "0,90", "-o", shots / "angle")
    result = json.loads((shots / "angle" / "lighting.json").read_text())
    assert "of front.exr" in result["frame"]
    (source,) = result["merged"]["sources"]
    assert source["photos"] == ["front.exr", "right.exr"]
    # The spot's binary pixels are centred to a fifth of one; a pixel mirrors 2.7 degrees there.
    np.testing.assert_allclose(source["direction"], [1, 0, 0], atol=0.01)
    assert result["merged"]["uncovered_share"] < 0.002
    assert all(entry["uncovered_share"] > 0.02 for entry in result["photos"])
    assert result["merged"]["warnings"] == []
    assert "0.0% of all directions not seen" in text
    (table,) = tomllib.loads((shots / "angle" / "lighting.toml").read_text())["lighting"]
    assert table["map"] == "lighting.exr"
    np.testing.assert_allclose(read_latlong(shots / "angle" / "lighting.exr"), 0.2, rtol=1e-5)  # float32

    poses = [entry["world_to_camera"] for entry in result["photos"]]
    (shots / "poses.json").write_text(json.dumps({"world_to_camera": poses}))
    run(*photos, *common, "--poses", shots / "poses.json", "-o", shots / "file")
    again = json.loads((shots / "file" / "lighting.json").read_text())
    assert again["merged"]["sources"] == result["merged"]["sources"]
    assert str(shots / "poses.json") in again["inputs"]
    # The other way round, the second view looks for the lamp where there is none.
    text = run(*photos, *common, "--view-angle-deg", "0,-90", "-o", shots / "wrong")
    assert "check the poses" in " ".join(text.split())


def test_what_says_nothing_is_refused(shots: Path) -> None:
    photo, mask = shots / "float.exr", ("--mask", shots / "mask.png")
    (shots / "poses.json").write_text('{"world_to_camera": [[[1, 0, 0, 0]]]}')
    refused = [
        (("--reflectance", "1.5"), "--reflectance 1.5: must be one number, or R,G,B, above 0 and at most 1"),
        (("--reflectance", "grey"), "--reflectance grey: must be one number"),
        (("--ball", "80,80"), "--ball 80,80: must be column, row and radius"),
        (("--ball", "80,80,-4"), "--ball 80,80,-4: the radius must be above 0"),
        ((*mask, "--ball", "80,80,60"), "--mask and --ball both give the ball's place"),
        ((*mask, "--view-angle-deg", "0,90"), "2 angles for 1 views: give one for each"),
        ((*mask, "--view-angle-deg", "east"), "must be angles in degrees"),
        (
            (*mask, "--view-angle-deg", "0", "--register"),
            "--view-angle-deg and --register both give the poses",
        ),
        ((*mask, "--poses", shots / "poses.json"), "poses.json: pose 1: world_to_camera has 1 rows"),
        ((*mask, "--register"), "float.exr: is one view only; merging takes at least two"),
    ]
    for options, message in refused:
        with pytest.raises(ValueError, match=re.escape(message)):
            run(photo, *options, "-o", shots / "out")
    assert not (shots / "out").exists()


MANIFEST = """
format = 1
name = "set"
[camera]
model = "ORTHOGRAPHIC"
width = 160
height = 160
[radiometry]
exposure = "manual"
[object]
centre = [0, 0, 0]
radius = 1
[[lighting]]
name = "lamp"
mirror_ball = {ball}
[[photo]]
file = "float.exr"
exposure_s = 1
world_to_camera = [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]
"""
POSE = "world_to_camera = [[1,0,0,0],[0,-1,0,0],[0,0,-1,0],[0,0,0,1]]"


def lit_by(shots: Path, ball: str) -> Lighting:
    (shots / "photoset.toml").write_text(MANIFEST.replace("{ball}", ball))
    photoset = load_photoset(shots)
    return read_lighting(photoset, photoset.lightings[0])


def test_a_photo_set_names_brackets_views_and_reflectance(shots: Path) -> None:
    at = f'mask = "mask.png", {POSE}'
    single = lit_by(shots, f'{{ photo = "float.exr", exposure_s = 2, {at} }}')
    np.testing.assert_allclose(single.directions[0], LIGHT, atol=0.01)  # half a degree, as for the command
    dim = lit_by(shots, f'{{ photo = "float.exr", exposure_s = 2, reflectance = [0.5, 0.25, 1], {at} }}')
    np.testing.assert_allclose(dim.irradiances, single.irradiances * [2, 4, 1], rtol=1e-6)  # float32
    # A dim copy of the same photograph, exposed a tenth as long, is the same light.
    write_exr(shots / "tenth.exr", read_pixels(shots / "float.exr") / 10)
    bracket = lit_by(shots, f'{{ photo = ["tenth.exr", "float.exr"], exposure_s = [0.2, 2], {at} }}')
    np.testing.assert_allclose(bracket.irradiances, single.irradiances, rtol=1e-5)  # float32
    view = f'{{ photo = "float.exr", exposure_s = 2, {at} }}'
    views = lit_by(shots, f"{{ views = [{view}, {view}] }}")
    np.testing.assert_allclose(views.irradiances, single.irradiances, rtol=1e-6)


def test_a_photo_set_refuses_what_a_mirror_ball_cannot_be(shots: Path) -> None:
    refused = [
        ("{ photo = 3 }", "mirror_ball key photo is 3"),
        ("{ mask = 'mask.png' }", "mirror_ball needs photo, or views = "),
        (
            "{ photo = 'float.exr', reflectance = 0 }",
            "mirror_ball.reflectance must be one number, or [r, g, b]",
        ),
        ("{ photo = 'float.exr', reflectance = [0.5, 0.5] }", "mirror_ball.reflectance must be one number"),
        ("{ photo = 'float.exr', exposure_s = 0 }", "mirror_ball.exposure_s must be seconds above 0"),
        ("{ photo = ['a.exr', 'b.exr'], exposure_s = 1 }", "has 1 numbers in exposure_s for 2 in photo"),
        ("{ photo = 'float.exr', camera_mask_deg = 120 }", "camera_mask_deg is 120"),
        (
            "{ photo = 'float.exr', mask = 'a.png', background = 'b.png' }",
            "mask and background both say where",
        ),
        ("{ views = [{ photo = 'a.exr' }, { photo = 'b.exr' }] }", "view 1 needs photo, and world_to_camera"),
        ("{ views = [{ photoo = 'a.exr' }] }", "did you mean 'photo'?"),
        ("{ mask = 'a.png', views = [{ photo = 'a.exr' }] }", "mask is each view's: write it in views"),
    ]
    for ball, message in refused:
        with pytest.raises(ValueError, match=re.escape(message)):
            lit_by(shots, ball)
