"""lightfactor light: a photo set in, its light with standard deviations, maps and a figure out."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from capture.files.imagefile import read_pixels, write_exr
from invrender.inverse_lighting.known_brdf import read_brdf
from lightfactor.cli import app
from synthetic.materials.rh01 import RH01_MATERIALS, radiometric

DELRIN = radiometric(RH01_MATERIALS["delrin"])
BRDF = [
    "--kd",
    f"{DELRIN.kd[0]}",
    "--ks",
    f"{DELRIN.ks[0]}",
    "--mu",
    f"{DELRIN.mu}",
    "--sigma",
    f"{DELRIN.sigma}",
]


def light(source: Path, out: Path, *options: str) -> Result:
    return CliRunner().invoke(app, ["light", str(source), "-o", str(out), *options])


@pytest.fixture(scope="module")
def result(small_set_original: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The small set's light, which its manifest knows, so that the result is held against it."""
    out = tmp_path_factory.mktemp("light") / "out"
    done = light(small_set_original, out, *BRDF, "--samples", "3000", "--degree", "6")
    assert done.exit_code == 0, done.output
    assert "Against the truth" in done.output
    assert "held-out" in done.output
    return out


def test_the_result_holds_coefficients_maps_and_a_figure(result: Path):
    names = {"lighting.json", "lighting.png"} | {
        f"lighting-{kind}.exr" for kind in ("sh", "std", "dual", "dual-std")
    }
    assert {path.name for path in result.iterdir()} == names
    for kind in ("sh", "std", "dual", "dual-std"):
        pixels = read_pixels(result / f"lighting-{kind}.exr")
        assert pixels.shape[1] == 2 * pixels.shape[0]
        assert np.isfinite(pixels).all()


def test_the_document_tells_what_is_determined_and_what_is_off(result: Path):
    found = json.loads((result / "lighting.json").read_text())["lighting"][0]
    count = (found["degree"] + 1) ** 2
    assert np.shape(found["sh"]["std"]) == (count, 3)
    assert found["degrees"][0]["status"] == "determined"
    assert len(found["degrees"]) == found["degree"] + 1
    # Three small photographs and a lamp, whose light no degree holds.
    assert found["truth"]["first_nine_error"] < 0.03
    assert 0.9 < found["dual"]["coverage"] <= 1
    held_out = [photo for photo in found["photos"] if photo["held_out"]]
    assert len(held_out) == 1
    assert held_out[0]["rms_relative"] < 0.2


def test_a_black_photograph_has_no_relative_error_and_black_ones_alone_no_light(
    small_set: Path, tmp_path: Path, no_figures: None
):
    photos = sorted(small_set.glob("0*.exr"))
    for every, photo in enumerate(photos):
        write_exr(photo, np.zeros_like(read_pixels(photo)))
        done = light(small_set, tmp_path / "out", *BRDF, "--samples", "2000", "--degree", "4")
        if every == 0:
            assert done.exit_code == 0, done.output
            found = json.loads((tmp_path / "out" / "lighting.json").read_text())["lighting"][0]
            errors = {photo["file"]: photo["rms_relative"] for photo in found["photos"]}
            assert errors.pop(photo.name) is None
            assert max(*errors.values(), found["fit"]["rms_relative"]) < 10
    assert done.exit_code == 1
    assert "black in every photograph" in str(done.exception)


def test_a_diffuse_object_yields_nulls_for_odd_degrees_and_no_dual_map(
    small_set: Path, tmp_path: Path, no_figures: None
):
    done = light(small_set, tmp_path / "out", "--kd", "0.3", "--samples", "2000", "--degree", "3")
    assert done.exit_code == 0, done.output
    assert "degree 3 is undetermined" in " ".join(done.output.split())
    found = json.loads((tmp_path / "out" / "lighting.json").read_text())["lighting"][0]
    assert found["dual"] is None
    assert found["sh"]["value"][9:] == [[None] * 3] * 7
    assert not (tmp_path / "out" / "lighting-dual.exr").exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ([], "BRDF isn't given"),
        (["--kd", "0", "--ks", "0"], "reflects nothing"),
        (["--kd", "a"], "--kd is 'a'"),
        (["--ks", "0.2"], "sigma isn't given"),
        (["--ks", "0.2", "--sigma", "2"], "roughnesses are 0.005 to 0.7"),
        ([*BRDF, "--brdf", "x"], "both give the BRDF"),
        (["--brdf", "nowhere.json"], "there is no such file"),
        ([*BRDF, "--degree", "-1"], "--degree is -1; it must be 0 to 30"),
        ([*BRDF, "--degree", "30", "--samples", "500"], "961 unknown coefficients per channel"),
        ([*BRDF, "--rung", "best"], "--rung is 'best'"),
        ([*BRDF, "--samples", "5"], "take 100 or more"),
        ([*BRDF, "--truth", "nowhere.exr"], "nowhere.exr"),
    ],
)
def test_what_is_wrong_with_the_options_is_said(
    small_set: Path, tmp_path: Path, options: Sequence[str], message: str
):
    done = light(small_set, tmp_path / "out", *options)
    assert isinstance(done.exception, ValueError | OSError)
    assert message in str(done.exception)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('shape = "sphere"', 'shape = "sphere"\ntexture = true', "objects of one BRDF only"),
        ('file = "', 'held_out = true\nfile = "', "every photo is held out"),
    ],
)
def test_sets_out_of_scope_are_refused(small_set: Path, tmp_path: Path, old: str, new: str, message: str):
    manifest = small_set / "photoset.toml"
    text = manifest.read_text().replace("held_out = true\n", "")
    manifest.write_text(text.replace(old, new))
    done = light(small_set, tmp_path / "out", *BRDF)
    assert message in str(done.exception)


def forget_light(folder: Path) -> None:
    """Leave out of a set's manifest what it says of the light."""
    manifest = folder / "photoset.toml"
    manifest.write_text(re.sub(r"(?ms)^\[\[lighting\]\].*?(?=^\[\[photo\]\])", "", manifest.read_text()))


@pytest.mark.usefixtures("no_figures")
@pytest.mark.parametrize("given", ["truth.json", "."])
def test_the_truth_that_lies_beside_a_set_gives_the_brdf_and_judges_the_light(
    small_set: Path, tmp_path: Path, given: str
):
    forget_light(small_set)
    options = ["--brdf", str(small_set / given), "--samples", "2000", "--degree", "3"]
    done = light(small_set, tmp_path / "out", *options)
    assert done.exit_code == 0, done.output
    printed = " ".join(done.output.split())
    assert "Against the truth (truth.json)" in printed
    for heading in ("given", "off"):
        assert heading in printed
    document = json.loads((tmp_path / "out" / "lighting.json").read_text())
    assert document["brdf"]["kd"] == pytest.approx(DELRIN.kd.tolist())
    (found,) = document["lighting"]
    assert found["truth"]["given_by"] == "truth.json"
    # A lamp and a window by degree 3, of a light that the manifest does not say.
    assert found["truth"]["first_nine_error"] < 0.05
    assert found["truth"]["dual_first_nine_error"] < 0.05


def test_a_truth_whose_lamps_are_near_judges_no_distant_light(
    small_set: Path, tmp_path: Path, no_figures: None
):
    forget_light(small_set)
    path = small_set / "truth.json"
    truth = json.loads(path.read_text())
    truth["lighting"][0]["lamps"] = [{"position": [0, 0, 1], "intensity": [1, 1, 1]}]
    path.write_text(json.dumps(truth))
    done = light(small_set, tmp_path / "out", *BRDF, "--samples", "1000", "--degree", "1")
    assert done.exit_code == 0, done.output
    assert "Against the truth" not in done.output


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"model": "table", "sigma": None}, "its material is 'table', which none of our forms describes"),
        ({"kd_map": "kd.exr", "ks_map": "ks.exr"}, "its object is textured"),
        ({"sigma": 0.9}, "sigma is 0.9; roughnesses are"),
    ],
)
def test_a_true_brdf_that_is_none_of_ours_is_refused(
    small_set: Path, change: dict[str, object], message: str
):
    path = small_set / "truth.json"
    truth = json.loads(path.read_text())
    truth["brdf"] |= change
    truth["object"] = {"mesh": "object.obj"}
    path.write_text(json.dumps(truth))
    with pytest.raises(ValueError, match=re.escape(f"{path}: {message}")):
        read_brdf(path)


def quantity(value: object, status: str = "determined") -> dict[str, object]:
    return {"value": value, "std": None if value is None else 0.01, "status": status}


def test_the_brdf_of_a_result_is_read(tmp_path: Path):
    table = {
        "model": "microfacet",
        "kd": quantity([0.1, 0.2, 0.3]),
        "ks": quantity([0.2] * 3),
        "mu": quantity(1.5),
        "sigma": quantity(0.1),
    }
    path = tmp_path / "result.json"
    path.write_text(json.dumps({"brdf": table}))
    for given in (path, tmp_path):
        brdf = read_brdf(given)
        assert (brdf.kd.tolist(), brdf.ks.tolist(), brdf.mu, brdf.sigma) == (
            [0.1, 0.2, 0.3],
            [0.2] * 3,
            1.5,
            0.1,
        )
    path.write_text(json.dumps({"brdf": {**table, "ks": None, "mu": None, "sigma": None}}))
    assert not read_brdf(path).ks.any()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{}", "holds no BRDF"),
        ("no json", "holds no BRDF"),
        ('{"brdf": {"kd": 1, "ks": 1, "mu": 1, "sigma": 1}}', "holds no BRDF"),
    ],
)
def test_files_that_hold_no_brdf_are_refused(tmp_path: Path, text: str, message: str):
    (tmp_path / "result.json").write_text(text)
    with pytest.raises(ValueError, match=message):
        read_brdf(tmp_path)


def test_an_undetermined_brdf_is_refused(tmp_path: Path):
    table = {
        "model": "microfacet",
        "kd": quantity([0.1] * 3),
        "ks": quantity([0.2] * 3),
        "mu": None,
        "sigma": quantity(None, "undetermined"),
    }
    (tmp_path / "result.json").write_text(json.dumps({"brdf": table}))
    with pytest.raises(ValueError, match="sigma is undetermined there, so the BRDF isn't known"):
        read_brdf(tmp_path)
