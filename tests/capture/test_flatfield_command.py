from __future__ import annotations

import json

import cv2
import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from capture.commands.flatfield import flatfield
from capture.sensor.flatfield import read_flat_field
from synthetic.sensing.sensor import Sensor, expose, vignetting


@pytest.fixture
def run(monkeypatch, tmp_path):
    app = typer.Typer(pretty_exceptions_enable=False)
    app.command()(flatfield)
    monkeypatch.chdir(tmp_path)
    return lambda *arguments: CliRunner().invoke(app, list(arguments))


@pytest.mark.parametrize("pixelwise", [False, True])
def test_writes_numbers_figure_and_map(run, tmp_path, pixelwise):
    rng = np.random.default_rng(1)
    lens = Sensor(focal_px=150.0)
    names = []
    for number in range(2):
        names.append(f"{number}.png")
        codes = expose(np.full((120, 180, 3), 0.7), 1.0, lens, rng)
        assert cv2.imwrite(str(tmp_path / names[-1]), codes[..., ::-1])
    result = run(*names, "-o", "out/flat.json", *(["--map"] if pixelwise else []))
    assert result.exit_code == 0, result.output
    files = {path.name for path in (tmp_path / "out").iterdir()}
    assert files == {"flat.json", "flat-figure.png"} | ({"flat.exr"} if pixelwise else set())
    document = json.loads((tmp_path / "out/flat.json").read_text())
    assert document["kind"] == ("map" if pixelwise else "radial")
    assert set(document["inputs"]) == set(names)
    gain = read_flat_field(tmp_path / "out/flat.json").gain(180, 120)
    truth = vignetting(lens, 180, 120)[..., None]
    ratio = gain / truth
    assert np.abs(ratio / np.median(ratio) - 1).max() < 0.02  # a map's pixels: 5 standard deviations
    assert "Illumination in the corners" in result.output
    assert "± " in result.output


def test_says_what_one_photograph_leaves_open(run, tmp_path):
    rng = np.random.default_rng(2)
    codes = expose(np.full((120, 180, 3), 0.7), 1.0, Sensor(full_well=2000, focal_px=4000.0), rng)
    assert cv2.imwrite(str(tmp_path / "a.png"), codes[..., ::-1])
    result = run("a.png", "-o", "flat.json")
    assert result.exit_code == 0, result.output
    said = " ".join(result.output.split())
    assert "Centre: undetermined: " in said
    assert "One photograph hardly separates a gradient of the light from a shifted lens" in said


def test_nothing_is_written_if_a_photograph_is_bad(run, tmp_path):
    assert cv2.imwrite(str(tmp_path / "white.png"), np.full((60, 80, 3), 255, np.uint8))
    result = run("white.png")
    assert isinstance(result.exception, ValueError)
    assert "white.png: 100.0% of it is saturated" in str(result.exception)
    assert [path.name for path in tmp_path.iterdir()] == ["white.png"]
    result = run("white.png", "-o", "white.png")
    assert "is one of the inputs" in str(result.exception)
