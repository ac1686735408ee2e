"""The command `synth` as a user meets it: sets, and one clear sentence for each thing that is wrong."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from capture.photoset import load_photoset
from lightfactor.cli import main
from synthetic.scenes.builtin import scene_names, scene_path

Run = Callable[..., tuple[int, str, str]]

SCENE = """format = 1
name = "tiny"
description = "A small matte sphere."
[object]
shape = "sphere"
[material]
model = "lambertian"
kd = [0.1, 0.15, 0.2]
[[lighting]]
name = "lab"
area = [{ azimuth_deg = 60, elevation_deg = 40, radiance = [1.5, 1.6, 1.8] }]
directional = [{ azimuth_deg = -20, elevation_deg = 25, irradiance = 1.5 }]
[camera]
width = 32
height = 24
focal_px = 260
[gantry]
photos = 2
step_deg = 20
[render]
directions = 64
per_side = 2
"""


@pytest.fixture
def synth(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Run:
    """Run the command in this process: exit status, standard output, standard error."""
    monkeypatch.setenv("COLUMNS", "300")

    def run(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["lightfactor", "synth", *map(str, arguments)])
        with pytest.raises(SystemExit) as done:
            main()
        out, err = capfd.readouterr()
        return int(done.value.code or 0), out, err

    return run


@pytest.fixture
def tiny(tmp_path: Path) -> Path:
    path = tmp_path / "tiny.toml"
    path.write_text(SCENE)
    return path


def test_a_scene_becomes_a_photo_set(synth: Run, tiny: Path, tmp_path: Path) -> None:
    out = tmp_path / "new" / "set"
    code, text, err = synth(tiny, "-o", out)
    assert (code, err) == (0, "")
    assert sorted(path.name for path in out.iterdir()) == [
        "000.exr",
        "000_mask.png",
        "001.exr",
        "001_mask.png",
        "contact.png",
        "lighting.exr",
        "photoset.toml",
        "scene.toml",
        "truth",
        "truth.json",
    ]
    assert load_photoset(out).name == "tiny"
    assert (out / "contact.png").read_bytes().startswith(b"\x89PNG")
    error = json.loads((out / "truth.json").read_text())["integration"]["relative_rms_error"]
    assert f"tiny: 2 photographs, light summed over directions to {100 * error:.1g}% (relative RMS)." in text
    assert str(out / "photoset.toml") in text
    assert str(out / "contact.png") in text
    # Nothing else is left beside it.
    assert [path.name for path in out.parent.iterdir()] == ["set"]


def test_a_scene_replaces_its_earlier_set_and_the_seed_counts(synth: Run, tiny: Path, tmp_path: Path) -> None:
    out = tmp_path / "set"
    assert synth(tiny, "-o", out)[0] == 0
    first = (out / "000.exr").read_bytes()
    assert synth(tiny, "-o", out, "--seed", 0)[0] == 0
    assert (out / "000.exr").read_bytes() == first
    assert synth(tiny, "-o", out, "--seed", 1)[0] == 0
    assert (out / "000.exr").read_bytes() != first
    assert json.loads((out / "truth.json").read_text())["seed"] == 1
    # Fewer photographs: none of the earlier ones stays behind.
    tiny.write_text(SCENE.replace("photos = 2", "photos = 1"))
    assert synth(tiny, "-o", out)[0] == 0
    assert not (out / "001.exr").exists()


def everything(folder: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_another_scenes_set_is_refused_and_untouched(synth: Run, tiny: Path, tmp_path: Path) -> None:
    out = tmp_path / "set"
    assert synth(tiny, "-o", out)[0] == 0
    before = everything(tmp_path / "set")
    tiny.write_text(SCENE.replace('name = "tiny"', 'name = "other"'))
    code, _, err = synth(tiny, "-o", out)
    assert code == 1
    assert f"lightfactor: error: {out}: holds the photo set of another scene, 'tiny'" in err
    assert everything(out) == before
    # A set that this command didn't make has no truth beside it, or another program's.
    for truth in ("", "[]", '{"title": 3}'):
        (out / "truth.json").write_text(truth)
        code, _, err = synth(tiny, "-o", out)
        assert code == 1
        assert "holds a photo set that this command didn't make" in err


def test_other_folders_and_files_are_refused_and_untouched(synth: Run, tiny: Path, tmp_path: Path) -> None:
    photos = tmp_path / "holiday"
    photos.mkdir()
    (photos / "beach.jpg").write_bytes(b"precious")
    code, _, err = synth(tiny, "-o", photos)
    assert code == 1
    assert "'beach.jpg', which is no result of this command and would be lost" in err
    assert (photos / "beach.jpg").read_bytes() == b"precious"
    code, _, err = synth(tiny, "-o", tiny)
    assert code == 1
    assert "is a file; give the name of a folder" in err
    assert tiny.read_text() == SCENE


def test_a_failure_leaves_an_earlier_set_as_it_was(synth: Run, tiny: Path, tmp_path: Path) -> None:
    out = tmp_path / "set"
    assert synth(tiny, "-o", out)[0] == 0
    before = everything(out)
    # Found out late: the room is black wherever no light falls, and outliers are relative to that.
    tiny.write_text(
        SCENE.replace("azimuth_deg = -20", "azimuth_deg = 180").replace("area =", "# area =")
        + '[faults]\noutliers = 0.1\n[sensor]\nfile = "png"\n'
    )
    code, _, err = synth(tiny, "-o", out)
    assert (code, err.count("\n")) == (1, 1)
    assert everything(out) == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["set", "tiny.toml"]


def test_the_light_is_told_as_the_command_says(synth: Run, tiny: Path, tmp_path: Path) -> None:
    assert synth(tiny, "-o", tmp_path / "set", "--light", "nothing")[0] == 0
    (table,) = load_photoset(tmp_path / "set").lightings
    assert table.unknown
    assert (tmp_path / "set" / "truth" / "lighting.exr").exists()
    assert synth(tiny, "-o", tmp_path / "set", "--light", "ball")[0] == 0
    (table,) = load_photoset(tmp_path / "set").lightings
    assert table.mirror_ball is not None
    assert all((tmp_path / "set" / name).exists() for name in table.mirror_ball.files)


def test_list_shows_every_built_in_scene(synth: Run) -> None:
    code, text, err = synth("--list")
    assert (code, err) == (0, "")
    for name in scene_names():
        assert name in text
    assert "Anisotropic metal, brushed along the parallels." in text


def test_show_prints_a_file_that_makes_the_same_scene(synth: Run, tmp_path: Path) -> None:
    code, text, err = synth("rh01-cat", "--show")
    assert (code, err) == (0, "")
    assert text == scene_path("rh01-cat").read_text(encoding="utf-8")
    (tmp_path / "mine.toml").write_text(text)
    assert synth(tmp_path / "mine.toml", "--show")[1] == text


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "which scene? Give the name of a built-in one (--list shows them), or a scene file"),
        (("demo",), "where to? Give a folder for the photo set: -o SET"),
        (
            ("rh01-kat", "-o", "x"),
            "'rh01-kat' is no built-in scene and no scene file (NAME.toml); did you mean 'rh01-cat'?",
        ),
        (("none.toml", "-o", "x"), "none.toml: cannot be read (No such file or directory)"),
        (("none.toml", "--show"), "none.toml: cannot be read (No such file or directory)"),
        (("demo", "--list"), "--list prints and stops: remove SCENE, or remove --list"),
        (("demo", "--show", "-o", "x"), "--show prints and stops: remove --out, or remove --show"),
        (("demo", "--show", "--seed", "1", "--light", "all"), "remove --light and --seed, or remove --show"),
    ],
)
def test_errors_are_one_sentence(
    arguments: tuple[str, ...], message: str, synth: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    code, _, err = synth(*arguments)
    assert code == 1
    assert err.startswith("lightfactor: error: ")
    assert message in err
    assert err.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_all_that_is_wrong_with_a_file_is_said_at_once(synth: Run, tiny: Path, tmp_path: Path) -> None:
    tiny.write_text(SCENE.replace("focal_px", "focal_pix").replace("kd =", "kd = true #"))
    code, _, err = synth(tiny, "-o", tmp_path / "set")
    assert code == 1
    assert "[camera] has an unknown key 'focal_pix'; did you mean 'focal_px'?" in err
    assert "[material.kd] is True: give one number" in err
    assert "Traceback" not in err
    assert not (tmp_path / "set").exists()


def test_options_out_of_range_are_refused(synth: Run) -> None:
    code, _, err = synth("demo", "-o", "x", "--light", "none")
    assert code == 2
    assert "'none' is not one of 'all', 'distant', 'ball', 'nothing'" in err
    assert synth("demo", "-o", "x", "--seed", "-1")[0] == 2


def test_help_needs_nothing_heavy() -> None:
    code = (
        "import sys; sys.argv = ['lightfactor', 'synth', '--help']\n"
        "from lightfactor.cli import main\n"
        "try:\n    main()\nexcept SystemExit:\n    pass\n"
        "print(sorted({'numpy', 'scipy', 'cv2', 'embreex', 'matplotlib', 'skimage'} & set(sys.modules)))"
    )
    environment = os.environ | {"COLUMNS": "200"}
    out = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment
    ).stdout
    for word in ("SCENE", "--list", "--show", "--light", "--seed", "radians", "1/sr"):
        assert word in out
    assert out.strip().endswith("[]")
