"""`lightfactor plan` as a user meets it: a table, two recommendations, plan.json, and a sentence for what is wrong."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from lightfactor.cli import main
from synthetic.scenes.build import read_staging

Run = Callable[..., tuple[int, str, str]]

SCENE = """format = 1
name = "tiny [bench]"
[object]
shape = "sphere"
[material]
name = "teflon"
[[lighting]]
name = "lamp"
directional = [{ azimuth_deg = 0, elevation_deg = 4, irradiance = 2.0 }]
[camera]
width = 64
height = 48
focal_px = 700
[gantry]
start_deg = -6
step_deg = 3
photos = 4
held_out = [1]
"""


@pytest.fixture
def plan(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Run:
    """Run the command in this process: exit status, standard output without its line breaks, standard error."""

    def run(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["lightfactor", "plan", *map(str, arguments)])
        with pytest.raises(SystemExit) as done:
            main()
        out, err = capfd.readouterr()
        # A terminal as narrow as it happens to be breaks sentences anywhere.
        return int(done.value.code or 0), " ".join(out.split()), err

    return run


@pytest.fixture
def tiny(tmp_path: Path) -> Path:
    path = tmp_path / "tiny.toml"
    path.write_text(SCENE)
    return path


@pytest.fixture
def few_directions(monkeypatch: pytest.MonkeyPatch) -> None:
    """A tenth as many further views and lamps, where what they would bring isn't asked."""
    monkeypatch.setattr("invrender.plan.advice._DIRECTIONS", 10)


def test_a_plan_says_what_will_be_known_and_what_would_help(plan: Run, tiny: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    code, text, err = plan(tiny, "-o", out, "--samples", 1000)
    assert (code, err) == (0, "")
    assert "tiny [bench]: what will be known" in text
    assert re.search(r"│ mu +│ 1\.78[^│]*│[^│]*│ undetermined │", text)
    assert "One view more, from azimuth" in text
    assert "One lamp more, small, in addition to 'lamp', towards azimuth" in text
    found = json.loads((out / "plan.json").read_text())
    assert found["photos"] == ["000", "002", "003"]  # one is held out
    assert list(found["inputs"]) == ["tiny.toml"]
    by_name = {one["name"]: one for one in found["quantities"]}
    assert list(by_name) == ["kd", "ks", "sigma", "mu"]
    assert by_name["mu"]["truth"] == [1.78]
    assert by_name["mu"]["status"] == "undetermined"
    assert "grazing" in by_name["mu"]["reason"]
    assert len(by_name["ks"]["std"]) == 3
    assert (np.array(by_name["ks"]["noise_std"]) < by_name["ks"]["std"]).all()
    assert found["gauge"].startswith("absolute")
    advice = found["advice"]
    assert advice["target"] == "mu"
    view = advice["view"]["best"]
    azimuth, elevation = np.radians([view["azimuth_deg"], view["elevation_deg"]])
    level = np.cos(elevation)
    towards = [level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)]
    np.testing.assert_allclose(view["direction"], towards, atol=1e-12)
    assert view["distance"] == pytest.approx(0.6, abs=1e-3)
    assert {one["name"]: one["status"] for one in view["quantities"]}["mu"] == "determined"
    assert advice["view"]["best_above_horizon"]["elevation_deg"] >= 0
    lamp = advice["lamp"]["best"]
    assert lamp["photo"] in found["photos"]
    assert lamp["irradiance"] == [0.5, 0.5, 0.5]  # a source's irradiance, averaged over all orientations
    tried = advice["view"]["tried"]
    assert len(tried["direction"]) == len(tried["gain"]) > 90
    picture = cv2.imread(str(out / "plan.png"))
    assert picture is not None
    assert min(picture.shape[:2]) > 500


@pytest.mark.usefixtures("few_directions")
def test_unknown_light_is_told_by_degree_in_a_relative_gauge(plan: Run, tiny: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    code, text, _ = plan(tiny, "-o", out, "--light", "nothing", "--degree", 3, "--samples", 1000)
    assert code == 0
    assert "Light 'lamp' is " in text
    assert "of 16 coefficients per channel" in text
    assert "relative: the total of lighting 'lamp'" in text
    found = json.loads((out / "plan.json").read_text())
    (light,) = found["lighting"]
    assert not light["known"]
    assert light["l_max"] == 3
    assert np.shape(light["sh"]["value"]) == np.shape(light["sh"]["std"]) == (16, 3)
    assert len(light["determined_shares"]) == 4
    names = {one["name"] for one in found["quantities"]}
    assert {"ks_normalised", "lamp/source 1 direction", "lamp/degrees 0 to 2"} < names
    assert "kd" not in names
    # What the scene itself says of the light: told.
    assert read_staging(tiny).scene.illuminations[0].given == "all"


@pytest.mark.sweep
@pytest.mark.usefixtures("few_directions")
def test_the_calibration_that_is_worth_improving_is_named(plan: Run, tiny: Path, tmp_path: Path) -> None:
    tiny.write_text(SCENE + "[uncertainty]\nrotation_deg = 0.01\ndirection_deg = 1.0\n")
    out = tmp_path / "out"
    code, text, _ = plan(tiny, "-o", out, "--samples", 1000)
    assert code == 0
    # A degree of the one light is a hundred times what poses are off.
    assert "Worth improving first: light directions. Twice as sure, they leave Kd (1/sr) ±" in text
    # mu stays undetermined in so few grazing pixels: no bar of it is promised.
    assert "mu ±" not in text[text.index("Worth improving") :]
    found = json.loads((out / "plan.json").read_text())
    assert [one["cause"] for one in found["calibration"]] == ["light_directions", "poses"]
    kd = found["quantities"][0]
    assert kd["variance_shares"]["light_directions"] > 0.9
    # Half of what is nearly all of it.
    improved = found["calibration"][0]["quantities"][0]
    assert improved["name"] == "kd"
    np.testing.assert_allclose(improved["std"], np.array(kd["std"]) / 2, rtol=0.1)
    # Of light that is to be found no direction is given; poses limit what is found of it.
    tiny.write_text(SCENE + "[uncertainty]\nrotation_deg = 1.0\n")
    _, text, _ = plan(tiny, "-o", out, "--light", "nothing", "--degree", 0, "--samples", 1000)
    assert re.search(r"source 1 of '\w+', direction ± [\d.]+ degrees in place of ± [\d.]+ degrees", text)
    unknown = json.loads((out / "plan.json").read_text())
    assert [one["cause"] for one in unknown["calibration"]] == ["poses"]
    assert all("poses" in one["variance_shares"] for one in unknown["quantities"] if one["std"])


@pytest.mark.usefixtures("few_directions")
def test_a_plan_without_a_folder_writes_nothing(
    plan: Run, tiny: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    code, text, _ = plan("tiny.toml", "--samples", 1000)
    assert code == 0
    assert "plan.json" not in text
    assert [path.name for path in tmp_path.iterdir()] == ["tiny.toml"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["rh01-teflonn"], "did you mean 'rh01-teflon'?"),
        (
            ["rh01-teflon", "--degree", "-1"],
            "--degree is -1; the highest degree of the light must be 0 to 30",
        ),
        (["rh01-teflon", "--samples", "10"], "--samples is 10; look at 1000 pixels or more"),
        (["anisotropic"], "an anisotropic lobe has two roughnesses"),
    ],
)
def test_what_is_wrong_is_said_in_a_sentence(plan: Run, arguments: list[str], words: str) -> None:
    code, _, err = plan(*arguments)
    assert code == 1
    assert err.startswith("lightfactor: error: ")
    assert words in err
    assert "Traceback" not in err


def test_a_folder_that_holds_something_else_is_refused_before_any_work(
    plan: Run, tiny: Path, tmp_path: Path
) -> None:
    out = tmp_path / "photos"
    out.mkdir()
    (out / "000.jpg").write_bytes(b"a photograph")
    code, _, err = plan(tiny, "-o", out)
    assert code == 1
    assert "holds '000.jpg'" in err
    assert [path.name for path in out.iterdir()] == ["000.jpg"]
