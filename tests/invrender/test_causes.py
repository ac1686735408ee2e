"""Each cause of bad residuals is named first on a set that has it, with its size; sets without a fault have none."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from capture.files.imagefile import read_pixels
from capture.photoset import load_photoset
from invrender.diagnostics.altered import turned
from invrender.diagnostics.named import NamedCause
from invrender.output.report.run import run_process
from invrender.process.pipeline import process
from invrender.result.run import Run

from .faultysets import (
    BRUSHED,
    GLOSSY,
    LAMPS,
    MATTE,
    RADIUS,
    change_manifest,
    change_pixels,
    surface_normals,
    write_set,
)

SAMPLES = 1000


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Sets of a glossy and of a matte sphere in which nothing is wrong."""
    folder = tmp_path_factory.mktemp("sound")
    return {
        name: write_set(folder / name, material) for name, material in (("glossy", GLOSSY), ("matte", MATTE))
    }


def result_of(folder: Path, samples: int = SAMPLES) -> Run:
    return process(load_photoset(folder), samples=samples)


def cause_of(folder: Path, samples: int = SAMPLES) -> NamedCause:
    result = result_of(folder, samples)
    cause = result.causes[0]
    # It is the first thing that is said, and the first thing that it says.
    assert result.warnings[0] == cause.text
    return cause


def misdirected(folder: Path, turns_deg: dict[int, float]) -> Path:
    """Some lamps are given in directions that are off by so much."""
    numbers = iter(range(len(LAMPS)))

    def wrong(match: re.Match[str]) -> str:
        towards = np.array(json.loads(match.group(1)))
        turn = np.radians([turns_deg.get(next(numbers), 0.0), 0.0])
        return f"direction = {json.dumps(turned(towards, turn).tolist())}"

    return change_manifest(folder, r"direction = (\[[^\]]*\])", wrong)


def stained(folder: Path) -> Path:
    """Paint that varies by a tenth (RMS) over the sphere, in patches of about a seventh of its width."""
    seen, normals = surface_normals(folder)
    rng = np.random.default_rng(3)
    waves = np.cos(6 * normals @ rng.standard_normal((3, 40)) + rng.uniform(0, 2 * np.pi, 40))
    paint = np.ones(seen.shape)
    paint[seen] += 0.1 * waves.sum(axis=1) / np.sqrt(20)
    return change_pixels(folder, lambda _, pixels: pixels * paint[..., None])


# The cause, the surface, and what is done to its set. A constant added is in the last test.
FAULTS: dict[str, tuple[str, str, Callable[[Path], Path]]] = {
    "black subtracted twice": ("offset", "glossy", lambda f: change_pixels(f, lambda _, p: p - 0.006)),
    "a weak curve": ("curve", "glossy", lambda f: change_pixels(f, lambda _, p: np.maximum(p, 0) ** 1.15)),
    # Half of what is black is cut off at zero: its noise is none that a median shows.
    "sRGB as linear": (
        "curve",
        "matte",
        lambda f: change_pixels(f, lambda _, p: np.maximum(p, 0) ** (1 / 2.2)),
    ),
    "two lamps of other strength": (
        "brightness",
        "glossy",
        lambda f: change_pixels(f, lambda k, p: p * {2: 1.25, 4: 0.85}.get(k, 1.0)),
    ),
    # Glossy surfaces show where lamps are (test_lamp_directions.py).
    "two lamps elsewhere": ("direction", "matte", lambda f: misdirected(f, {2: 4.0, 5: 3.0})),
    "stains": ("stains", "glossy", stained),
    "the sphere elsewhere": (
        "place",
        "matte",
        lambda f: change_manifest(f, r"centre = \[[^\]]*\]", lambda _: "centre = [0, 0.0005, 0.0003]"),
    ),
}


# What the others show of another surface, or of a stronger fault.
FURTHER = ("black subtracted twice", "a weak curve")


@pytest.mark.parametrize(
    "fault", [pytest.param(f, marks=[pytest.mark.slow] if f in FURTHER else []) for f in FAULTS]
)
def test_the_fault_of_a_set_is_named_first(
    sound: dict[str, Path], tmp_path: Path, few_forms: None, fault: str
) -> None:
    expected, surface, spoil = FAULTS[fault]
    cause = cause_of(spoil(Path(shutil.copytree(sound[surface], tmp_path / "set"))))
    assert cause.name == expected
    # Stains blur between the cells that they are seen in; of two photographs among eight the noise is less certain.
    assert cause.share > {"stains": 0.5, "brightness": 0.6}.get(expected, 0.8)


@pytest.mark.slow
def test_lamps_elsewhere_are_put_right_where_a_glossy_surface_shows_them(
    sound: dict[str, Path], tmp_path: Path, few_forms: None
) -> None:
    folder = Path(shutil.copytree(sound["glossy"], tmp_path / "set"))
    result = result_of(misdirected(folder, {k: 2.5 - 5 * (k % 2) for k in range(len(LAMPS))}))
    assert result.causes == ()
    assert "Sources were turned by 2.5 degrees (median of 8)" in result.warnings[0]


@pytest.mark.parametrize("surface", ["glossy", pytest.param("matte", marks=pytest.mark.sweep)])
def test_a_sound_set_has_no_cause(sound: dict[str, Path], surface: str) -> None:
    result = result_of(sound[surface])
    assert result.causes == ()
    assert result.warnings == ()


@pytest.mark.sweep
def test_lamps_that_are_near_are_found_each_at_its_distance(tmp_path: Path) -> None:
    folder = write_set(tmp_path / "set", distance=25 * RADIUS)
    # Nearly all pixels: of fewer, scores would go by which are drawn.
    result = process(load_photoset(folder), samples=3000)
    # The lamps are no cause any more of what is left.
    assert result.causes == ()
    assert "The lamps were given as distant, but are near" in result.warnings[0]
    scores = []
    for entry in result.solution.lightings:
        lighting = entry.lighting
        assert lighting.closeness is not None
        assert lighting.closeness_std is not None
        scores.append(float(lighting.closeness[0] - 1 / (25 * RADIUS)) / float(lighting.closeness_std[0]))
        assert lighting.closeness_std[0] < 0.1 * lighting.closeness[0]
    # Of eight lamps: chance leaves 0.7 to 1.3 in 80% of the draws.
    assert 0.5 < float(np.sqrt(np.mean(np.square(scores)))) < 1.6


def test_brushed_metal_is_named_with_its_widths(tmp_path: Path, few_forms: None) -> None:
    folder = write_set(tmp_path / "set", BRUSHED)
    # About the true axis its lobe is found, and there is nothing to be named.
    change_manifest(folder, r'shape = "sphere"', lambda found: f"{found.group()}\nbrushed_about = [2, 0, 0]")
    cause = cause_of(folder)
    assert cause.name == "brushed about z"
    # Facets' slopes are 0.1 wide along the sphere's horizontal circles, 0.3 across them.
    assert np.exp(-cause.numbers[0]) == pytest.approx(3, rel=0.1)
    assert "across circles about the world's Z axis" in cause.text
    assert "Give brushed_about = [0.0, 0.0, 1.0] in [object]" in cause.text


@pytest.mark.sweep
def test_highlights_of_another_form_are_named(sound: dict[str, Path], tmp_path: Path) -> None:
    # A haze with a ring around the core, which is neither monotone nor a sum of lobes. Of one half as bright
    # a distribution without a formula leaves too little to name.
    folder = Path(shutil.copytree(sound["glossy"], tmp_path / "set"))
    wide, narrow = (
        write_set(tmp_path / str(sigma), f'model = "microfacet"\nkd = 0\nks = 0.06\nsigma = {sigma}')
        for sigma in (0.3, 0.2)
    )

    def ring(k: int, pixels: np.ndarray) -> np.ndarray:
        outer, inner = (read_pixels(other / f"{k:03d}.exr").astype(float) for other in (wide, narrow))
        return pixels + 2 * (2.25 * outer - inner)

    cause = cause_of(change_pixels(folder, ring))
    assert cause.name == "lobe"


@pytest.mark.sweep
def test_a_curve_is_named_where_the_light_is_unknown(sound: dict[str, Path], tmp_path: Path) -> None:
    folder = Path(shutil.copytree(sound["glossy"], tmp_path / "set"))
    change_pixels(folder, lambda _, pixels: np.abs(pixels) ** 1.15)
    change_manifest(folder, r"directional = .*", lambda _: "unknown = true\ndark = true")
    cause = process(load_photoset(folder), samples=640).causes[0]
    # Where light is looked for, a coat on the base may bend what a curve bends; the rest of it is one or the other.
    assert cause.name in ("curve", "shading")
    assert cause.name == "shading" or cause.numbers[0] == pytest.approx(0.15, abs=0.03)


def test_a_constant_added_is_named_first_and_report_and_result_show_it(
    sound: dict[str, Path], tmp_path: Path, few_forms: None
) -> None:
    folder = Path(shutil.copytree(sound["matte"], tmp_path / "set"))
    change_pixels(folder, lambda _, pixels: pixels + 0.01)
    run = run_process(folder, tmp_path / "result", SAMPLES)
    first = run.causes[0]
    assert run.warnings[0] == first.text
    assert first.name == "offset"
    assert first.share > 0.8
    (cause,) = json.loads((tmp_path / "result" / "result.json").read_text())["causes"]
    assert cause["cause"] == "offset"
    assert cause["numbers"] == pytest.approx([0.01] * 3, rel=0.05)
    page = (tmp_path / "result" / "report.html").read_text()
    assert f'alt="Cause of the difference in {cause["photo"]}"' in page
    shown = run.causes[0]
    # What the cause doesn't explain of the picture is noise.
    assert np.std(shown.difference - shown.explained) < 0.3 * np.std(shown.difference)
