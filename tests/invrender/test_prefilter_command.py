"""lightfactor prefilter: a map of light in; maps, coefficients and errors out."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from typer.testing import CliRunner, Result

from capture.files.imagefile import read_exr_layers, read_pixels, write_exr
from capture.lighting import latlong_directions, latlong_solid_angles
from lightfactor.cli import app

from .renders import KD, write_result


def prefilter(light: Path, out: Path, brdf: str, *options: str) -> Result:
    return CliRunner().invoke(app, ["prefilter", str(light), "-o", str(out), "--brdf", brdf, *options])


@pytest.fixture(scope="module")
def light(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sky that is brighter above, and a lamp in one pixel."""
    path = tmp_path_factory.mktemp("light") / "sky.exr"
    radiance = 1 + latlong_directions(16)[..., [2]].repeat(3, axis=-1)
    radiance[5, 7] = 30
    write_exr(path, radiance)
    return path


@pytest.fixture(scope="module")
def written(light: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a glossy result makes of it for two viewers."""
    folder = tmp_path_factory.mktemp("prefilter")
    result = write_result(folder / "result", "half-angle microfacet", 1.5, 0.4)
    done = prefilter(light, folder / "out", str(result), "--view", "30,20", "--view", "0,90")
    assert done.exit_code == 0, done.output
    assert "A ball in this light is off by" in done.output
    return folder / "out"


def test_each_lobe_has_its_maps_and_all_is_listed(written: Path):
    found = json.loads((written / "prefilter.json").read_text())
    assert [(lobe["name"], lobe["centre"]) for lobe in found["lobes"]] == [
        ("diffuse", "axis"),
        ("specular", "mirrored view"),
    ]
    listed = {"prefilter.json", "prefilter.png"}
    for lobe in found["lobes"]:
        files = lobe["files"]
        listed |= {files["local"], files["world"], *files["views"]}
        rows, terms = lobe["rows"], (lobe["p"] + 1) ** 2
        assert rows == max(10 * lobe["f"], 20)
        assert len(files["views"]) == 2
        for kind in ("local", "world"):
            assert read_pixels(written / files[kind]).shape == (rows, 2 * rows, 3)
            assert len(read_exr_layers(written / files[kind])) == terms - 1
        assert lobe["energy_left_out"] < 0.03
    assert {path.name for path in written.iterdir()} == listed
    assert [view["elevation_deg"] for view in found["views"]] == [20, 90]


def test_the_diffuse_map_is_the_irradiance_of_the_light(written: Path, light: Path):
    shown = read_pixels(written / "diffuse-view-1.exr")
    wi = latlong_directions(16).reshape(-1, 3)
    power = (read_pixels(light) * latlong_solid_angles(16)[..., None]).reshape(-1, 3)
    normals = latlong_directions(len(shown))
    truth = np.maximum(normals @ wi.T, 0) @ power * KD
    found = json.loads((written / "prefilter.json").read_text())["lobes"][0]["error"]
    # Pixels of 11 degrees as points, which moves irradiance by less than 1%.
    assert (np.abs(shown - truth) < np.max(found["largest"]) + 0.01 * truth.max()).all()
    # A Lambertian lobe looks alike from everywhere.
    assert_allclose(read_pixels(written / "diffuse-view-2.exr"), shown, rtol=1e-5)


def test_the_maps_of_a_viewer_are_the_sum_of_the_terms_in_the_world(written: Path):
    """[R02, eq. 5.35], from the files alone."""
    lobe = json.loads((written / "prefilter.json").read_text())["lobes"][1]
    layers = read_exr_layers(written / lobe["files"]["world"])
    total = read_pixels(written / lobe["files"]["world"]) * np.sqrt(1 / (4 * np.pi))
    # Seen from above, harmonics of the view are 0 but for q = 0: sqrt((2 p + 1) / 4 pi).
    for p in range(1, lobe["p"] + 1):
        total = total + layers[f"p{p}q0"] * np.sqrt((2 * p + 1) / (4 * np.pi))
    up = latlong_directions(lobe["rows"])[..., 2]
    factor = np.interp(np.sqrt((1 + up) / 2), lobe["view_factor"]["cos"], lobe["view_factor"]["value"])
    assert_allclose(read_pixels(written / lobe["files"]["views"][1]), total * factor[..., None], atol=1e-4)


@pytest.mark.slow
def test_a_panorama_is_mirrored(light: Path, tmp_path: Path):
    pixels = read_pixels(light)
    write_exr(tmp_path / "panorama.exr", pixels[:, ::-1])
    maps = []
    for name, path, options in (("own", light, ()), ("other", tmp_path / "panorama.exr", ("--panorama",))):
        done = prefilter(path, tmp_path / name, "lambertian", *options)
        assert done.exit_code == 0, done.output
        maps.append(read_pixels(tmp_path / name / "diffuse-view-1.exr"))
    assert_allclose(*maps, rtol=1e-6)


def test_relative_results_and_steep_views_are_warned_of(light: Path, tmp_path: Path):
    result = write_result(tmp_path / "result", "microfacet", 1.3, 0.4, gauge="relative: Kd + Ks = 1")
    done = prefilter(light, tmp_path / "out", str(result), "--orders", "4,1", "--rows", "12")
    assert done.exit_code == 0, done.output
    found = json.loads((tmp_path / "out" / "prefilter.json").read_text())
    assert "relative gauge" in " ".join(found["warnings"])
    assert (found["lobes"][1]["f"], found["lobes"][1]["p"], found["lobes"][1]["rows"]) == (4, 1, 12)
    assert found["epsilon"] is None
    absolute = write_result(tmp_path / "absolute", "microfacet", 1.3, 0.4)
    done = prefilter(light, tmp_path / "out", str(absolute), "--orders", "4,1", "--rows", "12")
    assert done.exit_code == 0, done.output
    assert "times the light that it receives; its formula does" in done.output


@pytest.mark.parametrize(
    ("brdf", "options", "message"),
    [
        ("phnog:32", [], "no BRDF of that name: did you mean 'phong'?"),
        ("phong", [], "give its exponent, 0.1 to 1e\\+06, as phong:NUMBER"),
        ("phong:-3", [], "--brdf phong:-3: give its exponent"),
        ("microfacet:nan", [], "give its sigma in radians"),
        ("lambertian:3", [], "leave ':3' out"),
        ("microfacet:0.002", [], "the lobe 'specular' is too narrow for maps"),
        ("phong:8", ["--epsilon", "1.5"], "--epsilon is 1.5"),
        ("phong:8", ["--orders", "4"], "--orders 4: cannot be read; give F,P"),
        ("phong:8", ["--orders", "4.5,1"], "--orders 4.5,1: cannot be read"),
        ("phong:8", ["--orders", "900,20"], "takes .* GB, more than 2"),
        ("phong:8", ["--rows", "1"], "--rows is 1"),
        ("phong:8", ["--view", "3"], "--view 3: cannot be read"),
        ("phong:8", ["--view", "3,95"], "the elevation is 95 degrees"),
        ("phong:8", ["--assume", "mu=1.5"], "only a result can leave mu or sigma open"),
    ],
)
def test_what_is_wrong_with_the_options_is_said(light, tmp_path, brdf, options, message):
    done = prefilter(light, tmp_path / "out", brdf, *options)
    with pytest.raises(ValueError, match=message):
        raise done.exception
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("pixels", "message"),
    [
        (np.ones((4, 6, 3)), "6x4 pixels; a lat-long map is RGB and twice as wide as high"),
        (np.full((4, 8, 3), -1.0), "holds negative radiance"),
        (np.full((4, 8, 3), np.nan), "96 values that are not finite"),
        (np.zeros((4, 8, 3)), "zero everywhere"),
    ],
)
def test_maps_that_are_no_light_are_refused(tmp_path, pixels, message):
    write_exr(tmp_path / "map.exr", pixels)
    done = prefilter(tmp_path / "map.exr", tmp_path / "out", "lambertian")
    with pytest.raises(ValueError, match=message):
        raise done.exception


def test_a_result_that_reflects_more_than_it_receives_is_refused(light, tmp_path):
    result = write_result(tmp_path / "result", "microfacet", None, 0.2)
    document = json.loads((result / "result.json").read_text())
    document["brdf"]["kd"]["value"] = [0.5, 0.5, 0.5]
    (result / "result.json").write_text(json.dumps(document))
    done = prefilter(light, tmp_path / "out", str(result))
    with pytest.raises(
        ValueError, match=r"by hand \(microfacet\): reflects 1.6\S* times the light that it receives"
    ):
        raise done.exception
