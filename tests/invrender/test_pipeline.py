"""The main job through the Python interface, on sets with known truth."""

from __future__ import annotations

import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from capture.photoset import load_photoset
from invrender.process.pipeline import process
from invrender.result import run as solved
from invrender.result.document import result_document
from invrender.result.run import Run
from recon.mesh.bodies import body_window

from .fewforms import few_forms_tried, no_causes_sought

pytestmark = pytest.mark.usefixtures("few_forms", "no_causes")


@pytest.fixture(scope="module")
def lamp_run(lamp_set_original: Path) -> Run:
    """What `process` finds of the set as it was written."""
    with few_forms_tried(), no_causes_sought():
        return process(load_photoset(lamp_set_original), samples=2000)


def test_threads_and_repetition_change_nothing(
    lamp_run: Run, lamp_set: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("capture.parallel.cores", lambda: 3)
    first, second = lamp_run, process(load_photoset(lamp_set), samples=2000)
    assert first.solution.model.estimate.cost == second.solution.model.estimate.cost
    assert first.solution.model.photo_errors.tolist() == second.solution.model.photo_errors.tolist()


def test_large_photographs_are_predicted_in_means_over_several_pixels(
    lamp_run: Run, lamp_set: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = lamp_run
    assert run.binning == 1
    fine = next(run.predictions())
    top, left, bottom, right = body_window(run.geometry.body, fine.photo.camera)
    monkeypatch.setattr(solved, "_PREDICTED", (bottom - top) * (right - left) / 9)
    large = process(load_photoset(lamp_set), samples=2000)
    assert large.binning == 3
    coarse = next(large.predictions())
    height, width = coarse.inside.shape

    def means(radiance: np.ndarray) -> np.ndarray:
        return radiance[: 3 * height, : 3 * width].reshape(height, 3, width, 3, 3).mean(axis=(1, 3))

    np.testing.assert_allclose(coarse.observed.radiance, means(fine.observed.radiance), rtol=1e-5)
    # What few rays a pixel leave of a highlight, in large pixels and in small ones.
    error = (coarse.predicted - means(fine.predicted))[coarse.inside]
    assert np.sqrt((error**2).mean() / (coarse.predicted[coarse.inside] ** 2).mean()) < 0.001


def test_unmeasured_irradiance_is_recovered(matte_lamp_set: Path) -> None:
    """The source's irradiance left out: recovered against the known map, which fixes the scale."""
    path = matte_lamp_set / "photoset.toml"
    text = re.sub(r", irradiance = \[[^\]]*\] \}", " }", path.read_text())
    path.write_text(text.replace("[[lighting]]", '[[lighting]]\nrecover = ["irradiance"]'))
    result = process(load_photoset(matte_lamp_set), samples=6000)
    (entry,) = result.solution.lightings
    assert result.solution.is_absolute
    off = entry.lighting.irradiances[0] - [1.5, 1.4, 1.3]
    # The map's share of the light is what the scale hangs on: half a percent at 1% noise.
    assert (np.abs(off) < np.minimum(4 * entry.irradiance_std[0], 0.03)).all()


def test_scaling_the_exposure_scales_nothing_but_kd_and_ks(lamp_run: Run, lamp_set: Path) -> None:
    """Gauge: photographs twice as exposed, so stated, give the same BRDF."""
    once = lamp_run
    path = lamp_set / "photoset.toml"
    text = path.read_text().replace('exposure = "equal"', 'exposure = "manual"')
    path.write_text(text.replace("[[photo]]", "[[photo]]\nexposure_s = 0.5"))
    twice = process(load_photoset(lamp_set), samples=2000)
    np.testing.assert_allclose(twice.solution.brdf.kd, 2 * once.solution.brdf.kd, rtol=1e-6, equal_nan=False)
    assert twice.solution.brdf.sigma == pytest.approx(once.solution.brdf.sigma, rel=1e-4)


def test_a_held_out_photograph_may_have_a_light_of_its_own_to_recover(lamp_set: Path) -> None:
    """Its strength can come from nowhere but itself: it is fitted to score the photograph, without an error bar."""
    path = lamp_set / "photoset.toml"
    text = path.read_text()
    own = """
[[lighting]]
name = "own"
recover = ["irradiance", "ambient"]
directional = [{ direction = [0.85, -0.31, 0.42] }]
"""
    # The lamp is behind what the last photograph shows.
    head, held_out, *others, _ = text.replace("held_out = true", "").split("[[photo]]")
    fitted = [head, *(block + '\nlighting = "lighting"\n' for block in others)]
    path.write_text("[[photo]]".join([*fitted, held_out + '\nheld_out = true\nlighting = "own"\n']) + own)
    result = process(load_photoset(lamp_set), samples=2000)
    known, scored = result.solution.lightings
    assert (known.lighting.name, scored.lighting.name) == ("lighting", "own")
    # What lights it is the lamp, whose strength isn't told here.
    np.testing.assert_allclose(scored.lighting.irradiances[0], [1.5, 1.4, 1.3], rtol=0.01)
    assert np.isnan(scored.irradiance_std).all()
    document = result_document(result, {"lighting": "a.exr", "own": "b.exr"}, {})
    json.dumps(document, allow_nan=False)
    assert document["lighting"][1]["directional"][0]["irradiance_std"] == [None] * 3
    # What is only scored is no evidence: the answer is the same as without that photograph, but for its mask,
    # which helps to find the sphere.
    path.write_text("[[photo]]".join(fitted))
    alone = process(load_photoset(lamp_set), samples=2000)
    assert alone.solution.brdf.sigma == pytest.approx(result.solution.brdf.sigma, rel=1e-3)


def test_masks_not_quite_white_lose_nothing_and_speckled_ones_are_told(lamp_run: Run, lamp_set: Path) -> None:
    """A renderer's alpha or a JPEG mask may hold 252 of 255 inside; where it is grey, samples go, and it is said."""
    clean = lamp_run
    rng = np.random.default_rng(1)
    masks = {path: cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in lamp_set.glob("*_mask.png")}
    for path, mask in masks.items():
        cv2.imwrite(str(path), np.where(mask == 255, 252, mask))
    nearly = process(load_photoset(lamp_set), samples=2000)
    # The sphere's place moves by a thousandth of a pixel with the mask's levels, and with it which pixels are drawn.
    assert abs(_samples(nearly) - _samples(clean)) < 0.01 * _samples(clean)
    assert not any("masks" in text for text in (*clean.warnings, *nearly.warnings))
    for path, mask in masks.items():
        cv2.imwrite(str(path), np.where(rng.random(mask.shape) < 0.2, 0.95 * mask, mask))
    grey = process(load_photoset(lamp_set), samples=2000)
    assert _samples(grey) < 0.6 * _samples(clean)
    assert any("masks call only partly the object's" in text for text in grey.warnings)


def _samples(result: Run) -> int:
    return sum(photo.samples for photo in result.scores)
