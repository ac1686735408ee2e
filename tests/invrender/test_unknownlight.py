"""The main job under light that nobody measured, end to end."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from capture.photoset import load_photoset
from invrender.pipeline import process
from invrender.run import run_process


def without_light(folder: Path) -> str:
    """The manifest of the set, rewritten to say nothing of the light."""
    manifest = folder / "photoset.toml"
    text = manifest.read_text()
    head, photos = text.split("[[lighting]]")[0], text[text.index("[[photo]]") :]
    manifest.write_text(f'{head}[[lighting]]\nname = "lighting"\nunknown = true\n\n{photos}')
    return manifest.read_text()


def test_three_photographs_tell_brdf_and_light(small_set: Path, tmp_path: Path):
    without_light(small_set)
    truth = json.loads((small_set / "truth.json").read_text())
    run = run_process(small_set, tmp_path / "out", samples=4000)
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
    assert "albedo" not in run.result.quantities
    # The photograph that was held out is predicted to its noise of 1%.
    assert run.result.rms(held_out=True) < 0.0115
    assert "lighting" in (tmp_path / "out" / "report.html").read_text()


def test_an_unknown_light_among_others_is_refused(small_set: Path):
    text = without_light(small_set)
    *fitted, last = text.split("[[photo]]")
    other = (
        '\n[[lighting]]\nname = "other"\ndirectional = [{ direction = [0, 0, 1], irradiance = [1, 1, 1] }]\n'
    )
    fitted = [part + 'lighting = "lighting"\n' if k else part for k, part in enumerate(fitted)]
    (small_set / "photoset.toml").write_text(
        "[[photo]]".join([*fitted, last + 'lighting = "other"\n']) + other
    )
    with pytest.raises(ValueError, match="under 2 lightings, one of them unknown"):
        process(load_photoset(small_set))
