"""New views and new light of a result, judged by brute-force photographs, draws from its covariance, and by hand."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from capture.camera import Camera
from capture.files.imagefile import read_pixels, write_exr
from capture.lighting import latlong_directions
from capture.srgb import linear_to_srgb
from invrender.brdf.microfacet import Microfacet
from invrender.output.render.light import light_element
from invrender.output.render.picture import take_picture
from invrender.output.render.subject import sphere_subject
from invrender.result.reflectance import Reflectance, reflectance
from invrender.result.saved import read_result
from synthetic.lights.arealight import AreaLight
from synthetic.lights.illumination import Illumination, latlong_map
from synthetic.lights.sources import DirectionalSource
from synthetic.materials.rh01 import RH01_MATERIALS, radiometric
from synthetic.render.photograph import photographs
from synthetic.scene import Scene, Shot
from synthetic.shapes.ball import Ball

from .renders import read, within

Command = Callable[..., tuple[int, str, str]]


@pytest.fixture
def result(workshop: Path, tmp_path: Path) -> Path:
    """A copy of the result that a test may change, the set beside it."""
    shutil.copytree(workshop / "set", tmp_path / "set")
    return Path(shutil.copytree(workshop / "result", tmp_path / "result"))


def change(result: Path, edit: Callable[[Any], None]) -> None:
    """Change a result's numbers."""
    path = result / "result.json"
    document = json.loads(path.read_text())
    edit(document)
    path.write_text(json.dumps(document))


def make_true(result: Path) -> None:
    """Put the truth of its photo set in place of what was found."""
    truth = json.loads((result.parent / "set" / "truth.json").read_text())

    def edit(document: Any) -> None:
        for name in ("kd", "ks", "mu", "sigma"):
            document["brdf"][name]["value"] = truth["brdf"][name]
        document["object"] |= {key: truth["object"][key] for key in ("centre", "radius")}

    change(result, edit)


def make_lambertian(document: Any) -> None:
    document["brdf"] |= {"model": "lambertian", "ks": None, "mu": None, "sigma": None}
    document["brdf"]["kd"]["value"] = [0.1, 0.2, 0.3]
    document["brdf"]["covariance"] = {"names": [], "values": []}


def make_undetermined(document: Any, name: str = "sigma") -> None:
    document["brdf"][name] = {"value": None, "std": None, "status": "undetermined"}
    for finding in document["identifiability"]:
        if finding["parameter"] == name:
            finding |= {"reason": "the light is soft", "remedy": "add a small source"}


def test_the_picture_of_a_photograph_is_what_brute_force_integration_says(
    lightfactor: Command, result: Path, tmp_path: Path
) -> None:
    make_true(result)
    code, _, err = lightfactor("render", result, "--photo", "001.exr", "-o", tmp_path / "x.exr")
    assert (code, err) == (0, "")
    radiance, layers = read(tmp_path / "x.exr")
    truth = read_pixels(result.parent / "set" / "truth" / "001.exr").astype(float)
    mask = cv2.imread(str(result.parent / "set" / "001_mask.png"), cv2.IMREAD_UNCHANGED) / 255
    assert radiance.shape == truth.shape
    inside = within(layers["A"])
    assert inside.sum() > 1000
    # 0.5% of full light is what the model's quadratures of a map are stated to be good to.
    assert np.abs(radiance - truth)[inside].max() < 0.005 * truth.max()
    # The outline: coverage in 36 parts, the mask's likewise coarse.
    assert np.abs(layers["A"] - mask).max() < 0.1
    assert layers["A"].sum() == pytest.approx(mask.sum(), rel=2e-3)
    edge = (layers["A"] > 0) & ~inside
    assert radiance[edge].sum() == pytest.approx(truth[edge].sum(), rel=0.03)
    # Of several lightings a photograph's camera comes with its own.
    path = result / "result.json"
    document = json.loads(path.read_text())
    document["lighting"].insert(0, document["lighting"][0] | {"name": "other", "directional": []})
    path.write_text(json.dumps(document))
    code, said, _ = lightfactor("render", result, "--photo", "001.exr", "-o", tmp_path / "again.exr")
    assert code == 0
    assert f"under {document['lighting'][1]['name']}" in said
    assert (read(tmp_path / "again.exr")[0] == radiance).all()


def test_new_views_under_new_light_are_what_brute_force_integration_says(
    lightfactor: Command, result: Path, tmp_path: Path
) -> None:
    make_true(result)
    area = AreaLight(np.array([0.5, -0.4, 0.77]), np.array([0.8, 1.0, 1.3]), width_rad=0.5)
    lamp = np.radians([200.0, 35.0])
    toward = np.array([np.cos(lamp[1]) * np.cos(lamp[0]), np.cos(lamp[1]) * np.sin(lamp[0]), np.sin(lamp[1])])
    write_exr(tmp_path / "room.exr", latlong_map([area], 128))
    code, _, err = lightfactor(
        *("render", result, "--light", tmp_path / "room.exr", "--source", "200,35,1,0.8,0.6"),
        *("--view", "70,25", "--turntable", 2, "--size", "64x64", "-o", tmp_path / "turn"),
    )
    assert (code, err) == (0, "")
    views = json.loads((tmp_path / "turn" / "views.json").read_text())["views"]
    keys = ("model", "params", "width", "height", "world_to_camera")
    cameras = [Camera(*(view[key] for key in keys)) for view in views]
    # As far away as in the photographs, where it says, the second from the other side.
    ball = Ball(np.array([0.001, 0.0, -0.001]), 0.02)
    for camera, azimuth in zip(cameras, (70, 250), strict=True):
        offset = camera.centre - ball.centre
        assert np.linalg.norm(offset) == pytest.approx(0.6, abs=2e-3)
        assert np.degrees(np.arctan2(offset[1], offset[0])) % 360 == pytest.approx(azimuth, abs=1e-6)
        assert np.degrees(np.arcsin(offset[2] / np.linalg.norm(offset))) == pytest.approx(25, abs=1e-6)
        assert camera.project(ball.centre[None])[0] == pytest.approx([32, 32], abs=1e-6)
        above = camera.project(ball.centre[None] + [0, 0, 0.01])[0]
        assert above[0] == pytest.approx(32, abs=1e-6)
        assert above[1] < 27
    light = Illumination("new", (area,), (DirectionalSource(toward, np.array([1, 0.8, 0.6])),))
    material = radiometric(RH01_MATERIALS["delrin"])
    scene = Scene("new", ball, material, tuple(Shot(camera, light) for camera in cameras))
    for view, (truth, _) in zip(views, photographs(scene), strict=True):
        radiance, layers = read(tmp_path / "turn" / view["file"])
        inside = within(layers["A"])
        assert inside.sum() > 800
        assert np.abs(radiance - truth)[inside].max() < 0.005 * truth.max()
        assert (tmp_path / "turn" / view["file"].replace(".exr", ".png")).is_file()


@pytest.mark.sweep
def test_standard_deviations_are_the_scatter_of_draws_from_the_covariance(
    result: Path, rng: np.random.Generator
) -> None:
    names = ("kd.r", "kd.g", "kd.b", "ks.r", "ks.g", "ks.b", "mu", "sigma")
    # One percent of everything, strongly correlated one way or the other: signs matter.
    signs = np.array([1, 1, 1, -1, -1, -1, 1, -1])
    correlation = np.where(np.eye(8, dtype=bool), 1, 0.8 * np.outer(signs, signs))
    saved = read_result(result).content.brdf
    mean = np.concatenate([np.ravel(getattr(saved, name).value) for name in ("kd", "ks", "mu", "sigma")])
    covariance = correlation * np.outer(0.01 * mean, 0.01 * mean)
    table = {"names": names, "values": covariance.tolist()}
    change(result, lambda document: document["brdf"].update(covariance=table))
    known = reflectance(read_result(result), {})
    element = light_element(read_result(result).read_lighting(read_result(result).lighting(None)))
    subject = sphere_subject(np.zeros(3), 1.0)
    pose = np.array([[0, 1, 0, 0], [0, 0, -1, 0], [-1, 0, 0, 0], [0, 0, 0, 1.0]])
    # Its middle with the highlight, not its outline, which takes many more rays.
    camera = Camera("ORTHOGRAPHIC", np.array([20.0, 6, 6]), 12, 12, pose)
    predicted = take_picture(subject, camera, known, element, with_std=True)
    drawn = []
    for values in rng.multivariate_normal(mean, covariance, 60):
        brdf = Microfacet(values[:3], values[3:6], values[6], values[7])
        material = Reflectance(brdf, known.covariance, {}, ())
        drawn.append(take_picture(subject, camera, material, element).radiance)
    scatter = np.std(np.array(drawn, float), axis=0, ddof=1)
    assert predicted.std is not None
    ratio = predicted.std[predicted.coverage > 0] / scatter[predicted.coverage > 0]
    # The scatter of 60 draws is itself uncertain by 9%; no pixel is off by more than four times as much.
    assert ratio.min() > 0.7
    assert ratio.max() < 1.5
    assert np.median(ratio) == pytest.approx(1, abs=0.2)


def test_std_is_written_beside_radiance(lightfactor: Command, result: Path, tmp_path: Path) -> None:
    code, _, _ = lightfactor("render", result, "--size", "40x30", "--std", "-o", tmp_path / "x.exr")
    assert code == 0
    radiance, layers = read(tmp_path / "x.exr")
    assert set(layers) == {"A", "std"}
    inside = layers["A"] == 1
    assert (layers["std"][inside] > 0).all()
    assert (layers["std"][inside] < 0.2 * radiance[inside].max()).all()


def test_a_png_is_the_exr_through_the_srgb_curve(lightfactor: Command, result: Path, tmp_path: Path) -> None:
    common = ("render", result, "--size", "60x60", "--view", "30,10")
    lightfactor(*common, "-o", tmp_path / "x.exr")
    lightfactor(*common, "-o", tmp_path / "x.png", "--exposure", "-1")
    radiance, layers = read(tmp_path / "x.exr")
    codes = cv2.imread(str(tmp_path / "x.png"), cv2.IMREAD_UNCHANGED)
    inside = layers["A"] == 1
    expected = 255 * linear_to_srgb(np.clip(radiance[inside] / 2, 0, 1))
    assert np.abs(codes[inside][:, 2::-1] - expected).max() <= 0.51  # rounding
    assert np.abs(codes[..., 3] - 255 * layers["A"]).max() <= 0.51
    # Left to itself it says what it did, and the brightest is just short of clipping.
    _, out, _ = lightfactor(*common, "-o", tmp_path / "auto.png")
    assert "Exposed automatically: --exposure" in out
    automatic = cv2.imread(str(tmp_path / "auto.png"), cv2.IMREAD_UNCHANGED)
    assert automatic[..., :3].max() == 255
    assert (automatic[inside][:, :3].max(axis=1) == 255).mean() < 0.01


def test_a_lambertian_sphere_in_a_white_room_is_pi_kd_everywhere(
    lightfactor: Command, result: Path, tmp_path: Path
) -> None:
    change(result, make_lambertian)
    write_exr(tmp_path / "white.exr", np.full((64, 128, 3), 2.0, np.float32))
    # Straight from above, where "up" is no direction in the picture, and of another size.
    code, out, _ = lightfactor(
        *("render", result, "--light", tmp_path / "white.exr", "--view", "0,90", "--radius", "0.5"),
        *("--size", "50x50", "--std", "-o", tmp_path / "x.exr"),
    )
    assert code == 0
    assert "no highlights" not in out  # a determined result says no reason
    radiance, layers = read(tmp_path / "x.exr")
    expected = 2 * np.pi * np.array([0.1, 0.2, 0.3])
    # Sums over the map's pixels are good to 1e-4.
    assert radiance[layers["A"] == 1] == pytest.approx(
        np.tile(expected, ((layers["A"] == 1).sum(), 1)), rel=2e-4
    )
    assert (layers["std"] == 0).all()


def test_a_panorama_is_read_mirrored(lightfactor: Command, result: Path, tmp_path: Path) -> None:
    change(result, make_lambertian)
    room = np.maximum(latlong_directions(16)[..., 1:2], 0) * np.ones(3)
    write_exr(tmp_path / "room.exr", room)  # light from +Y only
    common = ("render", result, "--light", tmp_path / "room.exr", "--view", "0,0", "--size", "40x40")
    sides = []
    for name, options in (("as it is", ()), ("mirrored", ("--panorama",))):
        lightfactor(*common, *options, "-o", tmp_path / f"{name}.exr")
        radiance, _ = read(tmp_path / f"{name}.exr")
        sides.append(radiance[:, 20:].sum() / radiance[:, :20].sum())
    # From +X, with +Z up, +Y is on the right.
    assert sides[0] > 3
    assert sides[0] * sides[1] == pytest.approx(1, rel=1e-3)


def test_an_undetermined_roughness_is_refused_or_assumed_by_name(
    lightfactor: Command, result: Path, tmp_path: Path
) -> None:
    change(result, make_undetermined)
    common = ("render", result, "--size", "30x30", "-o", tmp_path / "x.exr", "--std")
    code, _, err = lightfactor(*common)
    assert code == 1
    assert "sigma is undetermined" in err
    assert "the light is soft. To settle it: add a small source" in err
    assert "--assume sigma=VALUE" in err
    code, out, _ = lightfactor(*common, "--assume", "sigma=0.1", "--source", "30,30,1")
    assert code == 0
    assert "sigma = 0.1 is assumed" in out
    assert "sharp enough" in out
    soft = 1 + 0.2 * latlong_directions(16)[..., :1] * np.ones(3)
    write_exr(tmp_path / "soft.exr", soft)
    code, out, _ = lightfactor(*common, "--assume", "sigma=0.1", "--light", tmp_path / "soft.exr")
    assert code == 0
    assert "so soft" in out


def test_a_relative_gauge_is_said(lightfactor: Command, result: Path, tmp_path: Path) -> None:
    change(result, lambda document: document.update(gauge="relative: the mean source irradiance is 1"))
    code, out, _ = lightfactor("render", result, "--size", "30x30", "-o", tmp_path / "x.exr")
    assert code == 0
    assert "only ratios of radiance" in out


def test_a_result_without_its_set_makes_its_camera_up_and_says_so(
    lightfactor: Command, result: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "far").mkdir()
    (tmp_path / "set").rename(tmp_path / "far" / "away")
    code, out, _ = lightfactor("render", result, "--size", "100x80", "-o", tmp_path / "x.exr")
    assert code == 0
    assert "made up" in out
    _, layers = read(tmp_path / "x.exr")
    # A disk of three quarters of the shorter side.
    assert layers["A"].sum() == pytest.approx(np.pi * 30**2, rel=5e-3)
    code, _, err = lightfactor("render", result, "--photo", "001.exr", "-o", tmp_path / "y.exr")
    assert code == 1
    assert "--set" in err
    code, _, _ = lightfactor(
        "render", result, "--set", tmp_path / "far" / "away", "--photo", "001.exr", "-o", tmp_path / "y.exr"
    )
    assert code == 0


def not_two_to_one(folder: Path) -> None:
    write_exr(folder / "map.exr", np.ones((20, 30, 3), np.float32))


def dark(folder: Path) -> None:
    write_exr(folder / "map.exr", np.zeros((16, 32, 3), np.float32))


def nothing(folder: Path) -> None:
    """Leave all as it is."""


@pytest.mark.parametrize(
    ("options", "prepare", "words"),
    [
        (("--light", "map.exr"), not_two_to_one, ["map.exr", "30x20", "twice as wide"]),
        (("--light", "map.exr"), dark, ["map.exr", "zero everywhere"]),
        (("--light", "none.exr"), nothing, ["none.exr", "does not exist"]),
        (("--lighting", "lihgting"), nothing, ["'lihgting'", "did you mean 'lighting'?"]),
        (("--photo", "01.exr"), nothing, ["'01.exr'", "did you mean '001.exr'?"]),
        (("--view", "0,20,0.01"), nothing, ["0.01 m", "inside", "0.02"]),
        (("--view", "0"), nothing, ["--view 0", "AZIMUTH,ELEVATION"]),
        (("--view", "north,20"), nothing, ["--view north,20", "AZIMUTH,ELEVATION"]),
        (("--view", "0,120"), nothing, ["elevation is 120", "-90 to 90"]),
        (("--view", "nan,0"), nothing, ["--view nan,0"]),
        (("--source", "0,20"), nothing, ["--source 0,20", "IRRADIANCE"]),
        (("--source", "0,20,1,1"), nothing, ["--source 0,20,1,1", "one number or three"]),
        (("--source", "0,20,-1"), nothing, ["irradiance is negative"]),
        (("--source", "0,20,0"), nothing, ["dark"]),
        (("--source", "0,20,1", "--lighting", "lighting"), nothing, ["--lighting", "excludes"]),
        (("--panorama",), nothing, ["--panorama", "--light"]),
        (("--size", "640"), nothing, ["--size 640", "640x480"]),
        (("--size", "0x10"), nothing, ["--size 0x10"]),
        (("--fov", "200"), nothing, ["--fov is 200"]),
        (("--radius", "-1"), nothing, ["--radius is -1"]),
        (("--photo", "001.exr", "--fov", "20"), nothing, ["--photo", "--fov"]),
        (("--mesh-to-world", "a.json"), nothing, ["give --mesh"]),
        (("--mesh", "none.ply"), nothing, ["none.ply", "no such file"]),
        (("--assume", "sigma=0.1"), nothing, ["sigma", "determined by the photographs"]),
        (("--assume", "sigam=0.1"), nothing, ["'sigam'", "did you mean 'sigma'?"]),
        (("--exposure", "1"), nothing, ["--exposure", ".exr"]),
        (("--turntable", "3"), nothing, ["--turntable", "folder"]),
        (("--set", "elsewhere"), nothing, ["elsewhere", "does not exist", "photo set"]),
    ],
)
def test_bad_options_are_one_clear_sentence(
    lightfactor: Command,
    workshop: Path,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    options: tuple[str, ...],
    prepare: Callable[[Path], None],
    words: list[str],
) -> None:
    prepare(tmp_path)
    named = [
        str(tmp_path / option) if option.endswith((".exr", ".ply")) and "0" not in option else option
        for option in options
    ]
    monkeypatch.chdir(tmp_path)
    before = sorted(tmp_path.iterdir())
    code, _, err = lightfactor("render", workshop / "result", *named, "-o", tmp_path / "out.exr")
    assert code == 1
    assert err.startswith("lightfactor: error: ")
    assert len(err.strip().splitlines()) == 1
    for word in words:
        assert word in err
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize(
    ("where", "words"),
    [
        ("nowhere", ["nowhere", "does not exist", "lightfactor process"]),
        ("set", ["holds no result.json", "it is a photo set"]),
        ("", ["holds no result.json"]),
        ("set/truth.json", ["truth.json", "lacks the key"]),
    ],
)
def test_what_is_no_result_is_said(
    lightfactor: Command, workshop: Path, tmp_path: Path, where: str, words: list[str]
) -> None:
    code, _, err = lightfactor("render", workshop / where, "-o", tmp_path / "out.exr")
    assert code == 1
    for word in words:
        assert word in err


def test_an_input_is_not_overwritten(lightfactor: Command, workshop: Path, tmp_path: Path) -> None:
    write_exr(tmp_path / "room.exr", np.ones((16, 32, 3), np.float32))
    code, _, err = lightfactor(
        "render", workshop / "result", "--light", tmp_path / "room.exr", "-o", tmp_path / "room.exr"
    )
    assert code == 1
    assert "one of the inputs" in err
