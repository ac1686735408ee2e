"""The main job under light that nobody measured, end to end."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from capture.photoset import load_photoset
from invrender.output.report.run import run_process
from invrender.process.pipeline import process

pytestmark = pytest.mark.usefixtures("few_forms", "no_causes")


def without_light(folder: Path) -> str:
    """The manifest of the set, rewritten to say nothing of the light."""
    manifest = folder / "photoset.toml"
    text = manifest.read_text()
    head, photos = text.split("[[lighting]]")[0], text[text.index("[[photo]]") :]
    manifest.write_text(f'{head}[[lighting]]\nname = "lighting"\nunknown = true\n\n{photos}')
    return manifest.read_text()


def test_three_photographs_tell_brdf_and_light(small_set: Path, tmp_path: Path, few_forms: None):
    without_light(small_set)
    truth = json.loads((small_set / "truth.json").read_text())
    run = run_process(small_set, tmp_path / "out", samples=900)
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    share = truth["brdf"]["ks"][0] / (truth["brdf"]["ks"][0] + truth["brdf"]["kd"][0])
    found = {name: result["brdf"][name] for name in ("ks", "mu", "sigma")}
    # Three standard deviations of six numbers: one set in fifty would be outside.
    for value, std in zip(found["ks"]["value"], found["ks"]["std"], strict=True):
        assert abs(value - share) < 3 * std < 0.01
    for name in ("mu", "sigma"):
        assert abs(found[name]["value"] - truth["brdf"][name]) < 3 * found[name]["std"] < 0.02
    (light,) = result["lighting"]
    assert (light["known"], light["recovered"]) == (False, ["all"])
    (source,) = light["directional"]
    (told,) = truth["lighting"][0]["directional"]
    assert np.degrees(np.arccos(np.dot(source["direction"], told["direction"]))) < 0.1
    # Light comes in units of its own; its colour doesn't.
    ratio = np.array(source["irradiance"]) / told["irradiance"]
    np.testing.assert_allclose(ratio / ratio.mean(), 1, atol=0.01)
    assert result["gauge"].startswith("no light is known")
    assert "albedo" not in run.solution.quantities
    # The photograph that was held out is predicted to its noise of 1%.
    assert run.rms(held_out=True) < 0.0115
    assert "lighting" in (tmp_path / "out" / "report.html").read_text()


@pytest.mark.slow
def test_of_a_matte_object_without_lamps_light_is_all_that_is_told(
    matte_set: Path, tmp_path: Path, no_pictures: None
):
    without_light(matte_set)
    result = run_process(matte_set, tmp_path / "out", samples=900)
    assert result.solution.model.estimate.model.name.startswith("lambertian")
    assert (result.solution.quantities["kd"].status, result.solution.covariance.shape) == (
        "undetermined",
        (0, 0),
    )
    assert (tmp_path / "out" / "result.json").exists()


def under(folder: Path, lightings: str, names: Sequence[str], held_out: bool = False) -> None:
    """Rewrite the manifest of the set: its lightings, and whose light each photograph is under."""
    text = without_light(folder)
    head, *photos = text.split("[[photo]]")
    photos = [f'{photo.strip()}\nlighting = "{name}"\n' for photo, name in zip(photos, names, strict=True)]
    if not held_out:
        photos = [photo.replace("held_out = true", "") for photo in photos]
    head = head.split("[[lighting]]")[0] + lightings
    (folder / "photoset.toml").write_text("\n[[photo]]\n".join([head, *photos]))


def unknown(*names: str, also: str = "") -> str:
    return "".join(f'[[lighting]]\nname = "{name}"\nunknown = true\n{also}' for name in names)


@pytest.mark.slow
def test_two_unknown_lightings_yield_one_brdf_and_a_map_each(
    small_set: Path, tmp_path: Path, few_forms: None
):
    truth = json.loads((small_set / "truth.json").read_text())
    under(small_set, unknown("day", "evening"), ["day", "evening", "day", "evening"])
    run_process(small_set, tmp_path / "out", samples=900)
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    for name in ("mu", "sigma"):
        assert (
            abs(result["brdf"][name]["value"] - truth["brdf"][name]) < 3 * result["brdf"][name]["std"] < 0.04
        )
    assert [light["name"] for light in result["lighting"]] == ["day", "evening"]
    # The same lamp under two names: it is where it is, and as strong, in both.
    (day,), (evening,) = (light["directional"] for light in result["lighting"])
    (told,) = truth["lighting"][0]["directional"]
    for found in (day, evening):
        assert np.degrees(np.arccos(np.dot(found["direction"], told["direction"]))) < 0.2
    np.testing.assert_allclose(day["irradiance"], evening["irradiance"], rtol=0.03)
    assert {light["map"] for light in result["lighting"]} == {"lighting-day.exr", "lighting-evening.exr"}
    assert all((tmp_path / "out" / light["map"]).exists() for light in result["lighting"])
    page = (tmp_path / "out" / "report.html").read_text()
    assert "day" in page
    assert "evening" in page


KNOWN = '[[lighting]]\nname = "b"\ndirectional = [{ direction = [0, 0, 1], irradiance = [1, 1, 1] }]\n'


@pytest.mark.parametrize(
    ("lightings", "message"),
    [
        (KNOWN + unknown("a"), "some photographs are under unknown light, others under 'b', of which"),
        (unknown("a", "b"), r"is held out, and no fitted photograph is under its lighting 'b'"),
        (unknown("a", also="dark = true\n") + unknown("b"), "dark = true is said of some .* but not of 'b'"),
    ],
)
def test_sets_that_are_not_solved_together_are_refused(small_set: Path, lightings: str, message: str):
    fitted = "dark" in lightings or lightings.startswith(KNOWN)
    under(small_set, lightings, ["a", "a", "b" if fitted else "a", "b"], held_out=True)
    with pytest.raises(ValueError, match=message):
        process(load_photoset(small_set))


def test_a_dark_room_is_said_of_unknown_light_only(small_set: Path):
    under(small_set, KNOWN + "dark = true\n", ["b"] * 4)
    with pytest.raises(ValueError, match="dark = true is said of unknown light"):
        load_photoset(small_set)
