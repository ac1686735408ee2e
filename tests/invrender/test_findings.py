"""The demonstration's numbers, and what is said when photographs are not what the model takes them for."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from capture.files.imagefile import read_pixels, write_exr
from capture.photoset import load_photoset
from invrender.factorization import Factorization
from invrender.pipeline import Run, process
from invrender.result import identifiability

SAMPLES = 6_000
TRUTH = {"kd": 0.243634, "ks": 0.030112, "mu": 1.78, "sigma": 0.12}


def run(folder: Path) -> Factorization:
    return process(load_photoset(folder), samples=SAMPLES).result


def assert_truth_is_covered(result: Factorization) -> None:
    for name, truth in TRUTH.items():
        quantity = result.quantities[name]
        assert quantity.value is not None
        assert quantity.std is not None
        # Four standard deviations: eight numbers a run, a dozen runs.
        assert (np.abs(quantity.value - truth) < 4 * quantity.std).all(), name


@pytest.fixture(scope="module")
def demo(demo_set_original: Path) -> tuple[Run, dict[str, object]]:
    truth = json.loads((demo_set_original / "truth.json").read_text())["brdf"]
    return process(load_photoset(demo_set_original), samples=15_000), truth


@pytest.mark.parametrize(
    ("name", "relative", "absolute"),
    [
        ("kd", 0.02, 0.0),
        ("ks", 0.02, 0.0),
        ("mu", 0.0, 0.05),
        ("sigma", 0.0, 0.005),
    ],
)
def test_the_demo_recovers_the_truth(
    demo: tuple[Run, dict[str, object]], name: str, relative: float, absolute: float
) -> None:
    # What is promised of the demo at 1% noise; the error bars claim far less, and must hold as well.
    run, truth = demo
    quantity = run.result.quantities[name]
    assert quantity.value is not None
    assert quantity.std is not None
    expected = np.broadcast_to(np.ravel(truth[name]), quantity.value.shape)
    off = np.abs(quantity.value - expected)
    assert (off <= relative * expected + absolute).all()
    assert (off <= 4 * quantity.std).all()


def test_the_demo_needs_the_whole_model_and_is_predicted_to_the_noise(
    demo: tuple[Run, dict[str, object]],
) -> None:
    result = demo[0].result
    assert result.model.estimate.model.name == "neutral microfacet"
    # 1% of radiance and a floor of 0.1% of its mean.
    assert result.model.error == pytest.approx(0.01, rel=0.05)
    assert result.rms(held_out=True) == pytest.approx(0.01, rel=0.05)
    assert result.noise_relative == pytest.approx(0.01, rel=0.05)


def test_good_photographs_need_no_words(demo: tuple[Run, dict[str, object]]) -> None:
    result = demo[0].result
    assert result.warnings == ()
    assert result.structured < 1e-3  # 1% noise, and nothing else
    assert_truth_is_covered(result)


def test_a_wrong_photograph_is_named_and_does_little_harm(demo_set: Path) -> None:
    (demo_set / "007.exr").write_bytes((demo_set / "006.exr").read_bytes())
    result = run(demo_set)
    (warning,) = [text for text in result.warnings if "far worse than the others" in text]
    assert warning.startswith("007.exr")
    assert not any("is brightness" in text for text in result.warnings)
    assert result.model.estimate.model.name == "neutral microfacet"
    assert_truth_is_covered(result)


def test_photographs_of_another_exposure_are_named_with_their_brightness(demo_set: Path) -> None:
    for name, factor in (("003.exr", 1.2), ("005.exr", 0.9)):
        write_exr(demo_set / name, read_pixels(demo_set / name).astype(np.float32) * np.float32(factor))
    result = run(demo_set)
    (warning,) = [text for text in result.warnings if "is brightness" in text]
    assert "are 0.90 (005.exr) to 1.20 (003.exr) times as bright as the fit has them" in warning
    assert "exposure (now 'equal')" in warning
    assert_truth_is_covered(result)


def test_stray_pixels_fade(demo_set: Path) -> None:
    rng = np.random.default_rng(1)
    for path in sorted(demo_set.glob("0??.exr")):
        pixels = read_pixels(path).astype(np.float32)
        stray = rng.random(pixels.shape[:2]) < 0.05
        pixels[stray] *= rng.uniform(0.2, 4.0, (stray.sum(), 1)).astype(np.float32)
        write_exr(path, pixels)
    result = run(demo_set)
    assert any("stray from the fit" in text for text in result.warnings)
    assert_truth_is_covered(result)


def test_a_wrong_black_level_widens_the_error_bars(demo_set: Path) -> None:
    for path in demo_set.glob("0??.exr"):
        write_exr(path, read_pixels(path).astype(np.float32) + np.float32(0.01))
    result = run(demo_set)
    assert any("not only noise" in text for text in result.warnings)
    assert_truth_is_covered(result)


def test_a_light_from_the_wrong_side_gives_no_numbers(demo_set: Path) -> None:
    path = demo_set / "photoset.toml"
    x, y, z = re.search(r"direction = \[([^,]*), ([^,]*), ([^\]]*)\]", path.read_text()).groups()  # type: ignore[union-attr]
    flipped = f"direction = [{-float(x)}, {-float(y)}, {-float(z)}]"
    path.write_text(re.sub(r"direction = \[[^\]]*\]", flipped, path.read_text()))
    result = run(demo_set)
    assert result.misfits
    assert all(quantity.value is None for quantity in result.quantities.values())
    assert any("No model explains" in text for text in result.warnings)
    assert any("if its lamps were pointing the other way" in text for text in result.warnings)
    for row in identifiability(result):
        assert row["status"] == "undetermined"
        assert "need no" not in row["reason"]
        assert "direction" in row["remedy"]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda sky: np.roll(sky, sky.shape[1] // 4, axis=1), "its map were turned by -90 degrees about +Z"),
        (lambda sky: sky[::-1], "its map were upside down"),
    ],
)
def test_a_map_in_other_axes_is_named(
    demo_set: Path, change: Callable[[np.ndarray], np.ndarray], said: str
) -> None:
    path = demo_set / "lighting.exr"
    write_exr(path, np.ascontiguousarray(change(read_pixels(path).astype(np.float32))))
    assert any(said in text for text in run(demo_set).warnings)


def test_floats_that_were_cut_off_are_left_out_and_told(demo_set: Path) -> None:
    # At a level that half of the photographs pass: taken at their word, these would make the lobe wider.
    photos = sorted(demo_set.glob("0??.exr"))
    level = np.float32(np.quantile([read_pixels(path).max() for path in photos], 0.5))
    for path in photos:
        write_exr(path, np.minimum(read_pixels(path).astype(np.float32), level))
    result = run(demo_set)
    (warning,) = [text for text in result.warnings if text.startswith("Saturated pixels are left out")]
    assert "export floats that are not cut off" in warning
    assert_truth_is_covered(result)
