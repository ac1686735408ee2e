"""The command as a user meets it: results, and one clear sentence for each thing that is wrong."""

from __future__ import annotations

import json
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from html import unescape
from pathlib import Path

import numpy as np
import pytest

from capture.files.imagefile import read_pixels, write_exr
from invrender.commands.process import DEFAULT_SAMPLES as CLI_SAMPLES
from invrender.process.pipeline import DEFAULT_SAMPLES
from invrender.result.sentences import errors_in_words
from lightfactor.cli import main

pytestmark = pytest.mark.usefixtures("few_forms")

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def lightfactor(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Run:
    """Run the command in this process: exit status, standard output, standard error."""

    def run(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["lightfactor", *map(str, arguments)])
        with pytest.raises(SystemExit) as done:
            main()
        out, err = capfd.readouterr()
        return int(done.value.code or 0), out, err

    return run


def edit(folder: Path, pattern: str, replacement: str) -> None:
    """Replace what must occur in a set's manifest."""
    path = folder / "photoset.toml"
    text, count = re.subn(pattern, replacement, path.read_text(), count=1)
    assert count == 1, pattern
    path.write_text(text)


def test_help_is_parsed_before_anything_heavy_is_imported() -> None:
    code = (
        "import sys; sys.argv = ['lightfactor', '--help']\n"
        "from lightfactor.cli import main\n"
        "try:\n    main()\nexcept SystemExit:\n    pass\n"
        "print(sorted({'numpy', 'scipy', 'cv2', 'pycolmap', 'matplotlib', 'pydantic'} & set(sys.modules)))"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert "process" in out
    assert "mirrorball" in out
    assert out.strip().endswith("[]")


def test_the_default_in_the_help_is_the_pipelines() -> None:
    # The command cannot import the pipeline before parsing, so it repeats this one number.
    assert CLI_SAMPLES == DEFAULT_SAMPLES


def test_process_writes_a_whole_result(workshop: Path) -> None:
    photos, out = workshop / "set", workshop / "result"
    result = json.loads((out / "result.json").read_text())
    truth = json.loads((photos / "truth.json").read_text())["brdf"]
    brdf = result["brdf"]
    assert brdf["model"] == "microfacet"
    # 1% noise, three views: each number within four of its own standard deviations and within 2% (mu: 0.05).
    for name, allowed in (("kd", 0.005), ("ks", 0.0007), ("mu", 0.05), ("sigma", 0.002)):
        value, std = np.ravel(brdf[name]["value"]), np.ravel(brdf[name]["std"])
        off = np.abs(value - np.ravel(truth[name]))
        assert (off < np.minimum(4 * std, allowed)).all(), name
        assert brdf[name]["status"] == "determined"
    assert [photo["held_out"] for photo in result["photos"]] == [False, False, False, True]
    # The held-out photograph is predicted to the noise (1%, and 0.1% of the mean).
    assert result["fit"]["held_out_rms_relative"] < 0.012
    assert sum(model["chosen"] for model in result["models"]) == 1
    assert {"photoset.toml", "000.exr", "000_mask.png", "lighting.exr"} <= set(result["inputs"])
    # Predictions are written for every photograph, the held-out one as well.
    photo, predicted = (read_pixels(folder / "003.exr") for folder in (photos, out / "predicted"))
    inside = predicted.any(axis=2)
    ratio = photo[inside].astype(float).sum() / predicted[inside].astype(float).sum()
    assert ratio == pytest.approx(1, abs=2e-3)  # limb pixels included, where the model is not fitted


def test_the_report_is_self_contained(workshop: Path) -> None:
    page = (workshop / "result" / "report.html").read_text()
    # Every picture is in the file; nothing points to the network or to another file.
    sources = re.findall(r'(?:src|href)="([^"]*)"', page)
    assert len(sources) == 3 + 3 * 4
    assert all(source.startswith("data:image/") for source in sources)
    assert "http" not in re.sub(r"data:image/[^\"]*", "", page)
    assert "held out" in page
    assert "rejected" in page


@pytest.mark.usefixtures("no_figures")
def test_command_and_report_state_one_error(lightfactor: Run, lamp_set: Path, tmp_path: Path) -> None:
    code, out, _ = lightfactor("process", lamp_set, "-o", tmp_path / "out", "--samples", 1000)
    fit = json.loads((tmp_path / "out" / "result.json").read_text())["fit"]
    stated = errors_in_words(fit)
    share = (
        f"In held-out photographs {fit['error_in_brightest_2_percent']['held_out']:.0%} of the squared error"
    )
    assert code == 0
    assert share in stated
    assert stated in " ".join(out.split())
    assert stated in unescape((tmp_path / "out" / "report.html").read_text())


@pytest.mark.usefixtures("no_figures", "no_causes")
def test_a_second_run_replaces_the_first(
    lightfactor: Run, workshop: Path, lamp_set: Path, tmp_path: Path
) -> None:
    out = Path(shutil.copytree(workshop / "result", tmp_path / "out"))
    (out / "result.json").write_text("{}")
    code, _, _ = lightfactor("process", lamp_set, "-o", out, "--samples", 1000)
    assert code == 0
    assert json.loads((out / "result.json").read_text())["format"] == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out", "set"]


@pytest.mark.usefixtures("no_figures", "no_causes")
def test_files_of_one_name_do_not_displace_each_other(
    lightfactor: Run, lamp_set: Path, tmp_path: Path
) -> None:
    """A photo per folder, all named alike, and lightings whose names hold a slash."""
    text = (lamp_set / "photoset.toml").read_text()
    for k in range(4):
        (lamp_set / str(k)).mkdir()
        for kind in (".exr", "_mask.png"):
            (lamp_set / f"00{k}{kind}").rename(lamp_set / str(k) / f"p{kind}")
            text = text.replace(f'"00{k}{kind}"', f'"{k}/p{kind}"')
    lamp = text[text.index("[[lighting]]") : text.index("[[photo]]")]
    text = text.replace(lamp, lamp.replace('"lighting"', '"room/1"') + lamp.replace('"lighting"', '"room/2"'))
    blocks = text.split("[[photo]]")
    blocks[1:] = [f'{block}lighting = "room/{1 + k % 2}"\n' for k, block in enumerate(blocks[1:])]
    (lamp_set / "photoset.toml").write_text("[[photo]]".join(blocks))
    code, out, err = lightfactor("process", lamp_set, "-o", tmp_path / "out", "--samples", 1000)
    assert (code, err) == (0, "")
    assert "sigma" in out
    assert "report.html" in out
    assert sorted(path.name for path in (tmp_path / "out" / "predicted").iterdir()) == [
        f"{k}_p.exr" for k in range(4)
    ]
    inputs = json.loads((tmp_path / "out" / "result.json").read_text())["inputs"]
    assert {f"{k}/p{kind}" for k in range(4) for kind in (".exr", "_mask.png")} <= set(inputs)
    assert {"lighting-room_1.exr", "lighting-room_2.exr"} <= {p.name for p in (tmp_path / "out").iterdir()}


def black_photo(folder: Path) -> None:
    write_exr(folder / "001.exr", np.zeros((60, 80, 3), np.float32))


def negative_photo(folder: Path) -> None:
    write_exr(folder / "001.exr", -read_pixels(folder / "001.exr").astype(np.float32))


def black_map(folder: Path) -> None:
    write_exr(folder / "lighting.exr", np.zeros((8, 16, 3), np.float32))


def nan_photo(folder: Path) -> None:
    pixels = read_pixels(folder / "001.exr").astype(np.float32)
    pixels[5, 7] = np.nan
    write_exr(folder / "001.exr", pixels)


def truncated_photo(folder: Path) -> None:
    data = (folder / "001.exr").read_bytes()
    (folder / "001.exr").write_bytes(data[: len(data) // 2])


def other_size(folder: Path) -> None:
    write_exr(folder / "001.exr", np.ones((30, 40, 3), np.float32))


def saturated_photo(folder: Path) -> None:
    import cv2

    cv2.imwrite(str(folder / "white.png"), np.full((60, 80, 3), 255, np.uint8))
    edit(folder, r'"001\.exr"', '"white.png"')


def no_mask_and_no_sphere(folder: Path) -> None:
    text = (folder / "photoset.toml").read_text()
    (folder / "photoset.toml").write_text(re.sub(r"(?m)^mask = .*\n", "", text))
    rng = np.random.default_rng(0)
    write_exr(folder / "000.exr", rng.random((60, 80, 3)).astype(np.float32))


def single_photo(folder: Path) -> None:
    text = (folder / "photoset.toml").read_text()
    head, first, *_ = text.split("[[photo]]")
    (folder / "photoset.toml").write_text(head + "[[photo]]" + first)


def light_below_the_horizon(folder: Path) -> None:
    """Two photographs from one place, and the only light straight behind the sphere."""
    head, first, *_ = (folder / "photoset.toml").read_text().split("[[photo]]")
    (folder / "again.exr").write_bytes((folder / "000.exr").read_bytes())
    again = first.replace('"000.exr"', '"again.exr"')
    (folder / "photoset.toml").write_text("[[photo]]".join([head, first, again]))
    edit(folder, r"direction = \[[^\]]*\]", "direction = [-1.0, 0.0, 0.0]")
    edit(folder, r"(?m)^map = .*\n", "")


def swapped_pose_convention(folder: Path) -> None:
    import tomllib

    data = tomllib.loads((folder / "photoset.toml").read_text())
    text = (folder / "photoset.toml").read_text()
    blocks = re.split(r"world_to_camera = \[.*?\]\s*\]", text, flags=re.DOTALL)
    poses = [np.linalg.inv(np.array(photo["world_to_camera"])).tolist() for photo in data["photo"]]
    (folder / "photoset.toml").write_text(
        blocks[0] + "".join(f"world_to_camera = {p}{b}" for p, b in zip(poses, blocks[1:], strict=True))
    )


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        pytest.param(
            lambda f: edit(f, "maks|mask =", "maks ="), ["photoset.toml", "'maks'", "'mask'"], id="typo"
        ),
        pytest.param(lambda f: (f / "001.exr").unlink(), ["001.exr", "does not exist"], id="missing photo"),
        pytest.param(truncated_photo, ["001.exr", "truncated", "Copy"], id="truncated"),
        pytest.param(other_size, ["001.exr", "40x30", "80x60"], id="other size"),
        pytest.param(saturated_photo, ["white.png", "saturated", "expose shorter"], id="all saturated"),
        pytest.param(black_photo, ["001.exr", "black"], id="black"),
        pytest.param(nan_photo, ["001.exr", "column 7, row 5"], id="not finite"),
        pytest.param(light_below_the_horizon, ["lighting", "below the horizon", "source 1"], id="horizon"),
        pytest.param(single_photo, ["photoset.toml", "at least two"], id="single photo"),
        pytest.param(no_mask_and_no_sphere, ["000.exr", "no mask", "no sphere"], id="no mask, no sphere"),
        pytest.param(swapped_pose_convention, ["camera_to_world"], id="pose convention"),
        pytest.param(
            lambda f: edit(f, r"\[object\]", "[object]\ntexture = true"),
            ["[object]", "texture"],
            id="texture",
        ),
        pytest.param(
            lambda f: edit(f, r'shape = "sphere"', 'shape = "mesh"'), ["[object]", "has no mesh"], id="mesh"
        ),
        pytest.param(
            lambda f: edit(f, r"(?m)^map = ", "unknown = true\nmap = "),
            ["[[lighting]]", "unknown = true contradicts map"],
            id="known and unknown",
        ),
        pytest.param(black_map, ["lighting.exr", "zero everywhere"], id="black map"),
        pytest.param(
            negative_photo, ["001.exr", "100% of the object's radiances are negative"], id="negative"
        ),
    ],
)
def test_bad_input_is_one_clear_sentence(
    lightfactor: Run, small_set: Path, tmp_path: Path, damage: Callable[[Path], None], words: list[str]
) -> None:
    damage(small_set)
    code, _, err = lightfactor("process", small_set, "-o", tmp_path / "out")
    assert code == 1
    assert err.startswith("lightfactor: error: ")
    assert len(err.strip().splitlines()) == 1
    for word in words:
        assert word in err
    # No half-written result, no leftovers beside it.
    assert sorted(path.name for path in tmp_path.iterdir()) == ["set"]


def test_somebody_elses_folder_is_not_replaced(lightfactor: Run, small_set: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "thesis.tex").write_text("precious")
    code, _, err = lightfactor("process", small_set, "-o", out)
    assert code == 1
    assert "thesis.tex" in err
    assert (out / "thesis.tex").read_text() == "precious"


def test_a_failed_run_leaves_the_earlier_result(
    lightfactor: Run, workshop: Path, lamp_set: Path, tmp_path: Path
) -> None:
    out = Path(shutil.copytree(workshop / "result", tmp_path / "out"))
    before = (out / "result.json").read_bytes()
    truncated_photo(lamp_set)
    code, _, _ = lightfactor("process", lamp_set, "-o", out)
    assert code == 1
    assert (out / "result.json").read_bytes() == before


@pytest.mark.parametrize(
    ("fate", "status", "said"),
    [
        ("raise OSError(28, 'No space left on device')", 1, "error: {}: [Errno 28] No space left on device"),
        pytest.param(
            "os.kill(os.getpid(), signal.SIGTERM); time.sleep(60)",
            128 + signal.SIGTERM,
            "stopped; {}",
            marks=pytest.mark.slow,
        ),
    ],
    ids=["failed", "stopped"],
)
def test_a_finished_fit_outlives_its_predictions(
    lamp_set: Path, tmp_path: Path, fate: str, status: int, said: str
) -> None:
    out = tmp_path / "out"
    # Another process knows nothing of fixtures: it is told here to try few forms and to seek no causes.
    code = (
        "import os, signal, time\nfrom lightfactor.cli import main\nfrom invrender.result.run import Run\n"
        "from invrender.brdf.lobes import BECKMANN\nfrom invrender.estimate import forms\n"
        "from invrender.process import explained\n"
        "forms.OTHER_FORMS = (BECKMANN,)\nforms.extended = forms.tabulated = lambda _: ()\n"
        "explained.diagnose = lambda *_: None\n"
        f"def predict(run, photo): {fate}\nRun.predict = predict\nmain()"
    )
    command = [sys.executable, "-c", code, "process", str(lamp_set), "-o", str(out), "--samples", "1000"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    left = f"{out} holds the finished result but for predicted photographs and report"
    assert (done.returncode, done.stderr.strip()) == (status, f"lightfactor: {said.format(left)}")
    assert "Kd red" in done.stdout
    assert json.loads((out / "result.json").read_text())["predicted_binning"] is None
    assert sorted(path.name for path in out.iterdir()) == ["lighting.exr", "result.json"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out", "set"]


# Both have one handler.
@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_a_stopped_run_leaves_nothing_behind(small_set: Path, tmp_path: Path, number: signal.Signals) -> None:
    code = "from lightfactor.cli import main; main()"
    command = [sys.executable, "-c", code, "process", str(small_set), "-o", str(tmp_path / "out")]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    # Once the temporary folder is there, the command is at work.
    while process.poll() is None and not list(tmp_path.glob(".out-*")):
        time.sleep(0.02)
    process.send_signal(number)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 128 + number
    assert err.strip() == "lightfactor: stopped; nothing was written, an earlier result is untouched"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["set"]
