from __future__ import annotations

import json

import cv2
import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from capture.commands.noise import noise
from capture.sensor.noise import read_noise_model
from synthetic.sensing.sensor import Sensor, expose


@pytest.fixture
def run(monkeypatch, tmp_path):
    app = typer.Typer(pretty_exceptions_enable=False)
    app.command()(noise)
    monkeypatch.chdir(tmp_path)
    return lambda *arguments: CliRunner().invoke(app, list(arguments))


def photographs(folder, bits: int, response: str, count: int) -> list[str]:
    rng = np.random.default_rng(1)
    scene = np.broadcast_to(np.linspace(0.005, 0.9, 240)[None, :, None], (160, 240, 3))
    sensor = Sensor(full_well=[3000, 4000, 5000], read_noise=10, bits=bits, response=response)
    names = [f"{number}.png" for number in range(count)]
    for name in names:
        assert cv2.imwrite(str(folder / name), expose(scene, 1.0, sensor, rng)[..., ::-1])
    return names


@pytest.mark.parametrize(
    ("bits", "encoding"), [pytest.param(16, "linear", marks=pytest.mark.slow), (8, "srgb")]
)
def test_writes_numbers_and_figure(run, tmp_path, bits, encoding):
    names = photographs(tmp_path, bits, encoding, 3)
    result = run(*names, "--encoding", encoding, "-o", "cal/noise.json")
    assert result.exit_code == 0, result.output
    assert {path.name for path in (tmp_path / "cal").iterdir()} == {"noise.json", "noise-figure.png"}
    document = json.loads((tmp_path / "cal/noise.json").read_text())
    assert set(document["inputs"]) == set(names)
    well, read = document["full_well_electrons"], document["read_noise_electrons"]
    assert (np.abs(np.subtract(well["value"], [3000, 4000, 5000])) < 3.5 * np.array(well["std"])).all()
    assert (np.abs(np.subtract(read["value"], 10)) < 3.5 * np.array(read["std"])).all()
    model = read_noise_model(tmp_path / "cal/noise.json")
    assert model.shot.tolist() == document["shot"]["value"]
    assert "±" in result.output


def test_warns_of_jpeg(run, tmp_path):
    names = [name.replace("png", "jpg") for name in photographs(tmp_path, 8, "srgb", 2)]
    for name in names:
        cv2.imwrite(str(tmp_path / name), cv2.imread(str(tmp_path / name.replace("jpg", "png"))))
    result = run(*names, "--encoding", "srgb")
    assert result.exit_code == 0, result.output
    assert "JPEG compression takes the finest noise away" in " ".join(result.output.split())


def test_nothing_is_written_if_there_is_no_pair(run, tmp_path):
    names = photographs(tmp_path, 16, "linear", 1)
    result = run(*names)
    assert isinstance(result.exception, ValueError)
    assert "0.png: no second photograph has its exposure" in str(result.exception)
    assert [path.name for path in tmp_path.iterdir()] == names
