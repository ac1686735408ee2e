"""Two results side by side: numbers, gauges, lightings, and the truth as one of them."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from capture.files.imagefile import read_pixels, write_exr
from invrender.output.compare.lightings import light_pairs
from invrender.output.compare.sides import read_side
from invrender.output.compare.verdicts import number_rows, verdict

Command = Callable[..., tuple[int, str, str]]


@pytest.fixture
def other(workshop: Path, tmp_path: Path) -> Path:
    """A copy of the result that a test may change."""
    return Path(shutil.copytree(workshop / "result", tmp_path / "other"))


def change(path: Path, edit: Callable[[Any], None]) -> None:
    """Change a JSON file, of a result if a folder is given."""
    path = path / "result.json" if path.is_dir() else path
    document = json.loads(path.read_text())
    edit(document)
    path.write_text(json.dumps(document))


def make_relative(document: Any) -> None:
    document["gauge"] = "relative: the mean source irradiance is 1"


def test_a_result_agrees_with_itself(lightfactor: Command, workshop: Path) -> None:
    code, out, err = lightfactor("compare", workshop / "result", workshop / "result" / "result.json")
    assert (code, err) == (0, "")
    assert "All 8 numbers agree within 2 standard deviations." in out
    assert "coefficients differ by 0.00%; source 1: 0.00 degrees apart, irradiance B / A 1, 1, 1" in out
    assert "made from some of the same files" in out
    side = read_side(workshop / "result")
    rows = number_rows(side, side)
    assert [row.z for row in rows] == [0.0] * 8
    assert [row.difference for row in rows] == [0.0] * 8


def test_a_result_agrees_with_the_truth_as_its_errors_say(lightfactor: Command, workshop: Path) -> None:
    code, out, err = lightfactor("compare", workshop / "result", workshop / "set" / "truth.json")
    assert (code, err) == (0, "")
    rows = number_rows(read_side(workshop / "result"), read_side(workshop / "set" / "truth.json"))
    truth = json.loads((workshop / "set" / "truth.json").read_text())["brdf"]
    found = json.loads((workshop / "result" / "result.json").read_text())["brdf"]
    # By hand, in the order of the table.
    z = [
        (expected - value) / std
        for name in ("kd", "ks", "mu", "sigma")
        for expected, value, std in zip(
            *(np.ravel(x) for x in (truth[name], found[name]["value"], found[name]["std"])), strict=True
        )
    ]
    assert [row.z for row in rows] == pytest.approx(z)
    # Eight numbers with 1% noise: four standard deviations would be 1 in 2000.
    assert 0 < np.abs(z).max() < 4
    assert "Photographs' errors in A, relative RMS:" in out
    assert "(3 fitted)" in out
    assert "(1 held out)" in out


def test_a_number_that_is_moved_differs_by_as_many_standard_deviations(
    lightfactor: Command, workshop: Path, other: Path
) -> None:
    def move(document: Any) -> None:
        quantity = document["brdf"]["sigma"]
        quantity["value"] += 7 * np.sqrt(2) * quantity["std"]

    change(other, move)
    rows = {row.label: row for row in number_rows(read_side(workshop / "result"), read_side(other))}
    assert rows["sigma (rad)"].z == pytest.approx(7)
    assert rows["sigma (rad)"].verdict == "differ"
    assert rows["mu"].verdict == "agree"
    _, out, _ = lightfactor("compare", workshop / "result", other)
    assert "1 of 8 numbers differ by more than 2 standard deviations: sigma (rad)" in out


def test_undetermined_and_missing_numbers_are_said_not_compared(workshop: Path, other: Path) -> None:
    def damage(document: Any) -> None:
        document["brdf"]["sigma"] = {"value": None, "std": None, "status": "undetermined"}
        document["brdf"]["mu"] = None

    change(other, damage)
    first, second = read_side(workshop / "result"), read_side(other)
    rows = {row.label: row for row in number_rows(first, second)}
    assert (rows["sigma (rad)"].verdict, rows["mu"].verdict) == ("undetermined in B", "not in its model in B")
    assert verdict(number_rows(first, second)) == "All 6 numbers agree within 2 standard deviations."


def test_a_relative_gauge_is_compared_by_shares_and_up_to_a_factor_of_light(
    lightfactor: Command, workshop: Path, other: Path
) -> None:
    factor = np.array([2.0, 0.5, 3.0])

    def rescale(document: Any) -> None:
        make_relative(document)
        for name in ("kd", "ks"):
            document["brdf"][name]["value"] = list(np.array(document["brdf"][name]["value"]) / factor)
        for source in document["lighting"][0]["directional"]:
            source["irradiance"] = list(np.array(source["irradiance"]) * factor)

    change(other, rescale)
    write_exr(other / "lighting.exr", read_pixels(other / "lighting.exr") * factor.astype(np.float32))
    first, second = read_side(workshop / "result"), read_side(other)
    rows = number_rows(first, second)
    assert [row.label for row in rows][:2] == ["Kd / (Kd + Ks) red", "Kd / (Kd + Ks) green"]
    assert [row.z for row in rows] == [0.0] * 8
    (pair,) = light_pairs(first, second)
    assert pair.factor == pytest.approx(1 / factor, rel=1e-5)  # the map is float32
    assert pair.difference < 1e-5
    _, out, _ = lightfactor("compare", workshop / "result", other)
    assert "The gauge of B is relative" in out


def test_lightings_differ_by_what_was_changed(workshop: Path, other: Path) -> None:
    turn = Rotation.from_rotvec([0, 0, np.radians(3.0)]).as_matrix()

    def brighten(document: Any) -> None:
        (source,) = document["lighting"][0]["directional"]
        source["irradiance"] = [1.1 * value for value in source["irradiance"]]

    change(other, brighten)
    write_exr(other / "lighting.exr", read_pixels(other / "lighting.exr") * np.float32(1.1))
    first = read_side(workshop / "result")
    (pair,) = light_pairs(first, read_side(other))
    assert pair.difference == pytest.approx(0.1 / 1.05, rel=1e-5)
    assert pair.sources[0].ratio == pytest.approx([1.1] * 3)
    assert pair.sources[0].z is None  # both are given: there is no error to measure by

    def rotate(document: Any) -> None:
        (source,) = document["lighting"][0]["directional"]
        lone = {**source, "direction": [0.0, 0.0, -1.0]}
        source["direction"] = list(turn @ source["direction"])
        source["irradiance_std"] = [0.01 * value for value in source["irradiance"]]
        document["lighting"][0]["directional"] = [lone, source]

    direction = np.array(
        json.loads((other / "result.json").read_text())["lighting"][0]["directional"][0]["direction"]
    )
    change(other, rotate)
    (pair,) = light_pairs(first, read_side(other))
    (source,) = pair.sources
    assert source.numbers == (1, 2)
    assert pair.lone == (0, 1)
    assert source.angle_deg == pytest.approx(np.degrees(np.arccos(direction @ turn @ direction)), abs=1e-6)
    assert source.z == pytest.approx(0.1 / (0.01 * 1.1))  # 1.1 against 1, known to 1% of 1.1


def test_a_cameras_unit_of_radiance_is_taken_into_account(workshop: Path, tmp_path: Path) -> None:
    truth = Path(shutil.copytree(workshop / "set", tmp_path / "set")) / "truth.json"
    plain = read_side(truth)
    change(truth, lambda document: document["sensor"].update(radiance_factor=4.0))
    scaled = read_side(truth)
    assert scaled.numbers["kd"].value == pytest.approx(4 * np.array(plain.numbers["kd"].value))
    assert scaled.numbers["ks_normalised"].value == pytest.approx(plain.numbers["ks_normalised"].value)
    assert "Kd and Ks are multiplied" in scaled.notes[0]


def test_the_page_is_self_contained_and_shows_both(
    lightfactor: Command, workshop: Path, tmp_path: Path
) -> None:
    page = tmp_path / "page.html"
    code, out, err = lightfactor("compare", workshop / "result", workshop / "set" / "truth.json", "-o", page)
    assert (code, err) == (0, "")
    assert str(page) in out
    text = page.read_text()
    sources = re.findall(r'(?:src|href)="([^"]*)"', text)
    # A figure of both lightings, a sphere from three sides, four photographs: A, B and difference each.
    assert len(sources) == 1 + 3 * 3 + 3 * 4
    assert all(source.startswith("data:image/") for source in sources)
    assert "http" not in re.sub(r"data:image/[^\"]*", "", text)
    # Fit and truth differ by next to nothing in pictures: far less than the noise, 1%.
    shares = [float(share) for share in re.findall(r"they differ by ([\d.]+)%", text)]
    assert len(shares) == 7
    assert 0 < max(shares) < 0.5


@pytest.mark.parametrize(
    ("second", "options", "words"),
    [
        ("nowhere", (), ["nowhere", "does not exist"]),
        ("set", (), ["holds no result.json", "photo set"]),
        ("set/photoset.toml", (), ["photoset.toml", "not valid JSON"]),
        ("result", ("-o", "page.pdf"), ["page.pdf", ".html"]),
    ],
)
def test_bad_input_is_one_clear_sentence(
    lightfactor: Command, workshop: Path, second: str, options: tuple[str, ...], words: list[str]
) -> None:
    code, _, err = lightfactor("compare", workshop / "result", workshop / second, *options)
    assert code == 1
    assert err.startswith("lightfactor: error: ")
    assert len(err.strip().splitlines()) == 1
    for word in words:
        assert word in err
