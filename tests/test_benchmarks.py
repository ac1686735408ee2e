"""Coarse versions of the stability atlas: on both sides of each boundary, whether the answer is determined and covers.

Draws are of fixed seeds; a stated number may be four of its standard deviations off, by chance one in 16,000 is.
"""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

import benchmarks.__main__ as command
from benchmarks import programs, stagewatch, witness
from benchmarks.atlas import BOUNDARIES
from benchmarks.atlas.charts import atlas_table
from benchmarks.atlas.faults import (
    NOISE,
    noise_draw,
    noise_theory,
    outliers_draw,
    pose_draw,
    saturation_draw,
    saturation_theory,
)
from benchmarks.atlas.figure import sweep_figure
from benchmarks.atlas.filters import soft_draw, soft_theory
from benchmarks.atlas.light import (
    degree_draw,
    degree_theory,
    near_known_draw,
    near_unknown_draw,
    rough_body_at,
    rough_body_draw,
    rough_body_theory,
    soft_light_at,
    soft_light_draw,
    soft_light_theory,
    two_sources_draw,
)
from benchmarks.atlas.stage import Finding, Stage
from benchmarks.atlas.sweep import gathered
from benchmarks.atlas.views import steepest_draw, steepest_theory
from benchmarks.contest import Outcome
from benchmarks.kept import Kept
from benchmarks.pareto.chart import front
from benchmarks.programs import PROGRAMS
from benchmarks.race import race_figure
from benchmarks.scaling import exponent
from capture.files.imagefile import write_exr
from tests.invrender.fewforms import few_forms_tried

FAR = 4.0


def holds(finding: Finding, far: float = FAR) -> bool:
    """Whether a number is stated and its bar holds the truth."""
    assert finding.error is not None
    assert finding.std is not None
    return finding.stated and abs(finding.error) < far * finding.std


@contextmanager
def few_samples() -> Iterator[None]:
    """Fewer samples of faulty photographs than the atlas takes."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("benchmarks.atlas.faults.Stage", partial(Stage, samples=600))
        yield


@pytest.fixture(scope="module")
def plain() -> dict[str, Finding]:
    """Unknown light, 1% noise, nothing wrong; few samples."""
    with few_samples():
        return noise_draw(0.01, 1)


@pytest.fixture(scope="module")
def noise() -> dict[str, Finding]:
    """What theory says of it."""
    with few_samples():
        return noise_theory(0.01)


def test_time_is_of_the_innermost_stage() -> None:
    def read_samples() -> str:
        return stagewatch.stage(sys._getframe())

    def explain() -> str:
        return read_samples()

    assert explain() == stagewatch.STAGES["read_samples"] != stagewatch.STAGES["explain"]
    assert stagewatch.stage(sys._getframe()) == stagewatch.REST


@pytest.mark.sweep
def test_roughness_shows_in_known_light_that_the_lobe_can_blur() -> None:
    assert soft_light_at(0.8) < 1 < soft_light_at(0.17)
    assert soft_light_draw(0.8, 0)["sigma"].status == soft_light_theory(0.8)["sigma"].status == "undetermined"
    sharp = soft_light_draw(0.17, 0)
    assert soft_light_theory(0.17)["sigma"].status == "determined"
    assert holds(sharp["sigma"])
    assert sharp["sigma"].status == "determined"


@pytest.mark.sweep
def test_roughness_shows_in_unknown_light_of_frequencies_above_its_own() -> None:
    assert rough_body_at(0.05) < 1 < rough_body_at(0.25)
    assert (
        rough_body_draw(0.05, 0)["sigma"].status == rough_body_theory(0.05)["sigma"].status == "undetermined"
    )
    assert holds(rough_body_draw(0.25, 1)["sigma"])


@pytest.mark.parametrize(("sharpness", "told", "hidden"), [(0.0, 2, 3), (2.0, 2, 12), (8.0, 8, None)])
def test_light_is_recovered_up_to_what_the_lobe_passes(
    sharpness: float, told: int, hidden: int | None
) -> None:
    found, theory = degree_draw(sharpness, 0), degree_theory(sharpness)
    assert found[f"degree {told}"].status == theory[f"degree {told}"].status == "determined"
    if hidden is not None:
        assert found[f"degree {hidden}"].status != "determined"
        assert theory[f"degree {hidden}"].status != "determined"
    assert all(holds(finding) for finding in found.values() if finding.stated)


@pytest.mark.slow
def test_mu_needs_grazing_views() -> None:
    assert not steepest_draw(25, 0)["mu"].stated
    assert steepest_theory(25)["mu"].status == "undetermined"
    assert holds(steepest_draw(70, 0)["mu"])
    assert steepest_theory(70)["mu"].status == "determined"


def test_bars_grow_with_noise_and_still_hold(plain: dict[str, Finding], noise: dict[str, Finding]) -> None:
    with few_samples():
        loud = noise_draw(0.1, 1)
    for name, expected in noise.items():
        assert holds(plain[name])
        assert holds(loud[name])
        # As theory has it, from 1500 other samples: to a third.
        assert_allclose(plain[name].std or 0, expected.std or 0, rtol=0.4)
        assert_allclose((loud[name].std or 0) / (plain[name].std or 1), 10, rtol=0.4)


def test_bars_hold_what_wrong_poses_do(noise: dict[str, Finding]) -> None:
    with few_samples():
        found = pose_draw(1.0, 1)
    assert all(holds(finding) for finding in found.values())
    assert (found["sigma"].std or 0) > 2 * (noise["sigma"].std or 0)


def test_saturated_highlights_cost_what_theory_says() -> None:
    with few_samples():
        found, theory = saturation_draw(0.1, 0), saturation_theory(0.1)
    assert all(holds(finding) for finding in found.values())
    assert_allclose(found["mu"].std or 0, theory["mu"].std or 0, rtol=0.4)


@pytest.mark.sweep
def test_bars_hold_what_a_few_outliers_do() -> None:
    assert all(holds(finding) for finding in outliers_draw(0.01, 1).values())


@pytest.mark.sweep
def test_bars_hold_what_many_outliers_do() -> None:
    found = outliers_draw(0.06, 0)
    assert all(holds(finding) for finding in found.values() if finding.stated)


@pytest.mark.parametrize(
    "draw",
    [
        pytest.param(near_known_draw, marks=pytest.mark.sweep),
        pytest.param(near_unknown_draw, marks=pytest.mark.sweep),
    ],
    ids=["known light", "unknown light"],
)
def test_a_near_lamp_costs_little_more_than_one_far_away(
    draw: Callable[[float, int], dict[str, Finding]],
) -> None:
    noise = noise_theory(0.01)
    for name, found in draw(0.1, 1).items():
        assert holds(found)
        assert (found.std or 0) < 3 * (noise[name].std or 0)


def test_crossed_filters_tell_what_soft_light_hides() -> None:
    with few_forms_tried():
        plain, pairs = soft_draw(90, 0), soft_draw(90, 0, polarised=True)
    assert plain["Ks share"].status == "undetermined"
    assert plain["mu"].status == "absent"
    assert pairs["Ks share"].status == pairs["mu"].status == "determined"
    assert holds(pairs["Ks share"])
    assert holds(pairs["mu"])
    assert soft_theory(90, polarised=True)["Ks share"].status == "determined"
    assert soft_theory(120)["Ks share"].status == "weak"


@pytest.mark.sweep
def test_two_sources_are_told_apart_beyond_the_width_of_the_lobe() -> None:
    together, apart = two_sources_draw(0.5, 0), two_sources_draw(2.0, 0)
    assert together["sources"].status == "undetermined"
    assert apart["sources"].status == "determined"
    for findings in (together, apart):
        assert all(holds(findings[name]) for name in ("Ks share", "mu", "sigma"))


def test_sweeps_count_what_is_stated_and_what_holds(tmp_path: Path) -> None:
    boundary = replace(NOISE, values=(0.01, 0.1), quantities=("sigma",))

    def kept(error: float | None, status: str) -> Mapping[str, object]:
        return {"sigma": asdict(Finding(error, 0.1, status))}

    found = {
        "0.01 theory": kept(None, "determined"),
        "0.01 draw 0": kept(0.19, "determined"),
        "0.01 draw 1": kept(-0.5, "weak"),
        "0.1 theory": kept(None, "undetermined"),
        "0.1 draw 0": kept(0.9, "undetermined"),
        "0.1 draw 1": kept(None, "absent"),
    }
    sweep = gathered(boundary, boundary.values, 2, found)
    assert_allclose(sweep.covered, [[0.5], [np.nan]])
    assert_allclose(sweep.scores[0, :, 0], [1.9, -5])
    text = "\n".join(atlas_table([sweep]))
    assert "sigma is off by -0.5 +- 0.1 (weak)" in text
    assert "| 0.01 | sigma | 0.34 | 0.1 | 0.1 (determined) | 1 of 2 | determined 1, weak 1 |" in text
    sweep_figure(sweep).savefig(tmp_path / "sweep.png")


def test_measurements_are_kept_and_those_of_other_settings_are_not(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "chart.json"
    Kept(path, {"seed": 1})["one"] = [1.5]
    again = Kept(path, {"seed": 1})
    assert again["one"] == [1.5]
    assert "seed 1" in again.caption
    assert "one" not in Kept(path, {"seed": 2})


def test_the_front_is_what_nothing_beats() -> None:
    seconds, errors = np.array([3.0, 1.0, 2.0, 4.0]), np.array([0.1, 0.5, 0.6, 0.1])
    assert front(seconds, errors).tolist() == [1, 0]
    assert exponent([1, 2, 4, 8], [9, 2, 8, 32]) == pytest.approx(2)


def test_the_race_is_drawn_without_mitsuba_too(tmp_path: Path) -> None:
    outcome = Outcome(
        "lightfactor", True, "500 samples", 1.0, {"Ks share": 0.1, "mu": None, "sigma": 0.1}, 0.1
    )
    race_figure([outcome, replace(outcome, known_light=False)]).savefig(tmp_path / "race.png")


def test_the_command_draws_what_is_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    drawn: list[tuple[str, Path, bool]] = []
    charts = {name: lambda out, quick, name=name: drawn.append((name, out, quick)) for name in command.CHARTS}
    monkeypatch.setattr(command, "CHARTS", charts)
    command.main(["--quick", "--only", "race", "--out", str(tmp_path)])
    assert drawn == [("race", tmp_path, True)]
    command.main(["--out", str(tmp_path)])
    assert [name for name, _, quick in drawn[1:] if not quick] == list(charts)
    with pytest.raises(SystemExit, match="is a file"):
        command.main(["--out", __file__])
    with pytest.raises(SystemExit):
        command.main(["--only", "rece"])
    assert "invalid choice: 'rece'" in capsys.readouterr().err


def test_a_part_that_fails_fails_the_command_and_no_other_part(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    # A program of its own, with arguments that it can't read, and a chart after it.
    monkeypatch.setitem(programs._PROGRAMS, "statistics", ("", "none"))
    drawn: list[bool] = []
    charts = {"statistics": PROGRAMS["statistics"], "next": lambda out, quick: drawn.append(quick)}
    monkeypatch.setattr(command, "CHARTS", charts)
    with pytest.raises(SystemExit, match="failed: statistics"):
        command.main(["--quick", "--out", str(tmp_path)])
    assert drawn == [True]
    assert "invalid literal for int() with base 10: 'none'" in capsys.readouterr().err
    assert not (tmp_path / "statistics.txt").exists()


def test_every_boundary_has_a_name_of_its_own_and_two_coarse_values() -> None:
    assert len({boundary.name for boundary in BOUNDARIES}) == len(BOUNDARIES)
    assert all(max(boundary.quick) < len(boundary.values) for boundary in BOUNDARIES)
    # Of one alone no figure can be drawn.
    assert all(len(boundary.quick) > 1 for boundary in BOUNDARIES)


# A program that shows a scene, and writes how wide it is, a picture and a material.
_FAKE = """
import json, pathlib, sys
verb, scene, option, out = [*sys.argv[1:], ""][:4]
if option == "--show":
    print("width = 320\\nname = 'ball'")
elif verb == "synth":
    folder = pathlib.Path(out)
    folder.mkdir()
    width = pathlib.Path(scene).read_text().split("\\n")[0].split()[-1]
    found = {"width": int(width), "timing_s": 1.0, "models": [{"name": "GGX", "error": 0.1}], "kd": [0.5, 1e-9]}
    (folder / "result.json").write_text(json.dumps(found))
    (folder / "scene.xml").write_text('<scene><rgb value="0.25, 0.5 1"/></scene>')
elif verb == "compare":
    pathlib.Path(out).write_text("page")
    print("all agree")
else:
    sys.exit(f"no command {verb}")
"""


def test_the_witness_keeps_what_commands_write_print_and_fail_with(tmp_path: Path) -> None:
    fake, out = tmp_path / "fake.py", tmp_path / "out.json"
    fake.write_text(_FAKE)
    lines = ["synth scene.toml -o synth", "compare a -o page.html", "proces a -o none"]
    program = shlex.join([sys.executable, str(fake)])
    witness.keep(out, program, {"ball": {"scene": {"width": "96"}, "lines": lines}})
    assert json.loads(out.read_text()) == {
        "ball/none/error": "no command proces",
        "ball/none/status": 1,
        "ball/page.html": "a file",
        "ball/page.html/printed/000": "all agree",
        "ball/page.html/status": 0,
        "ball/synth/result.json/kd/000": 0.5,
        "ball/synth/result.json/kd/001": 1e-9,
        "ball/synth/result.json/models/GGX/error": 0.1,
        "ball/synth/result.json/models/GGX/name": "GGX",
        "ball/synth/result.json/width": 96,
        "ball/synth/scene.xml/rgb 000/value/000": 0.25,
        "ball/synth/scene.xml/rgb 000/value/001": 0.5,
        "ball/synth/scene.xml/rgb 000/value/002": 1.0,
        "ball/synth/status": 0,
    }
    with pytest.raises(RuntimeError, match="no command -c"):
        witness.keep(out, shlex.join([sys.executable, str(fake), "-c"]), {"ball": {}})


def test_the_witness_keeps_mean_and_rms_of_pictures(tmp_path: Path) -> None:
    pixels = np.zeros((1, 2, 3))
    pixels[0, :, 1] = 3, -1
    write_exr(tmp_path / "x.exr", pixels, layers={"A": pixels[..., 1]})
    kept = witness.read_file(tmp_path / "x.exr", "x")
    assert kept["x/RGB/mean/001"] == kept["x/A/mean/000"] == 1
    assert kept["x/RGB/rms/001"] == pytest.approx(np.sqrt(5))
    assert kept["x/RGB/rms/002"] == 0


def test_the_witness_names_every_difference_by_run_worst_first(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = {"a/x/kd/000": 1.0, "a/x/kd/001": 1e-9, "a/x/mu": 1.5, "a/x/word": "weak", "b/y/gone": None}
    after = {"a/x/kd/000": 1.001, "a/x/kd/001": 2e-9, "a/x/mu": 1.8, "a/x/word": "weak", "b/y/new": True}
    for name, kept in (("before", before), ("after", after)):
        (tmp_path / name).write_text(json.dumps(kept))
    paths = [str(tmp_path / name) for name in ("before", "after")]
    with pytest.raises(SystemExit) as ended:
        witness.main(["compare", *paths])
    assert ended.value.code == 1
    # The second Kd moved by a millionth of a thousandth of the first.
    assert capsys.readouterr().out.splitlines() == [
        "a/x: 2 differ",
        "  a/x/mu: 1.7e-01, 1.5 -> 1.8",
        "  a/x/kd/000: 1.0e-03, 1.0 -> 1.001",
        "b/y: 2 differ",
        "  b/y/gone: gone, was None",
        "  b/y/new: new, True",
        "4 of 6 values differ by more than 1e-06",
    ]
    with pytest.raises(SystemExit) as ended:
        witness.main(["compare", paths[0], paths[0]])
    assert ended.value.code == 0
