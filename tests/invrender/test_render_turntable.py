"""Turntables: what turns, and what the pictures become."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose

from capture.files.imagefile import write_exr
from capture.srgb import linear_to_srgb
from invrender.output.render.light import turned
from invrender.transport.transfer import LightElement
from recon.mesh.trianglemesh import read_mesh

from .renders import plates, read, write_result

Command = Callable[..., tuple[int, str, str]]

SMALL = ("--size", "48x36", "--fov", "20")


@pytest.fixture
def lit(tmp_path: Path) -> tuple[object, ...]:
    """A command that renders plates, whose smaller one is off the middle of what turns, under a room and a lamp."""
    write_result(tmp_path / "result")
    plates(tmp_path / "plates.ply")
    room = np.random.default_rng(0).uniform(0.5, 1, (8, 16, 3)).astype(np.float32)
    write_exr(tmp_path / "room.exr", room)
    pose = np.eye(4)
    pose[:3, :3] = [[1, 0, 0], [0, 0.8, -0.6], [0, 0.6, 0.8]]
    place(tmp_path / "place.json", pose)
    mesh = ("--mesh", tmp_path / "plates.ply", "--mesh-to-world", tmp_path / "place.json")
    light = ("--light", tmp_path / "room.exr", "--source", "20,30,2")
    return "render", tmp_path / "result", *mesh, *light, *SMALL, "--view", "10,25,9"


def place(path: Path, mesh_to_world: np.ndarray) -> None:
    path.write_text(json.dumps({"mesh_to_world": mesh_to_world.tolist()}))


def test_a_light_that_turns_is_a_light_further_round(
    lightfactor: Command, lit: tuple[object, ...], tmp_path: Path
) -> None:
    turning = (*lit, "--turntable", 8, "--turn", "light", "-o", tmp_path / "turn")
    assert lightfactor(*turning)[0] == 0
    views = json.loads((tmp_path / "turn" / "views.json").read_text())["views"]
    assert [view["light_turn_deg"] for view in views] == [45.0 * k for k in range(8)]
    assert len({str(view["world_to_camera"]) for view in views}) == 1
    # By hand: the lamp 45 degrees on, and the room's map an eighth of its columns.
    write_exr(tmp_path / "further.exr", np.roll(read(tmp_path / "room.exr")[0], 2, axis=1))
    index = lit.index("--light")
    by_hand = (*lit[:index], "--light", tmp_path / "further.exr", "--source", "65,30,2", *lit[index + 4 :])
    assert lightfactor(*by_hand, "-o", tmp_path / "x.exr")[0] == 0
    assert_allclose(read(tmp_path / "turn" / "001.exr")[0], read(tmp_path / "x.exr")[0], rtol=1e-5)
    assert lightfactor(*lit, "--rotate-light", 45, "-o", tmp_path / "x.exr")[0] == 0
    assert_allclose(read(tmp_path / "turn" / "001.exr")[0], read(tmp_path / "x.exr")[0], rtol=1e-5)


def test_an_object_that_turns_is_the_mesh_turned(
    lightfactor: Command, lit: tuple[object, ...], tmp_path: Path
) -> None:
    assert lightfactor(*lit, "--turntable", 4, "--turn", "object", "-o", tmp_path / "turn")[0] == 0
    # By hand: a quarter turn of the mesh about the vertical through its middle.
    pose = np.array(json.loads((tmp_path / "place.json").read_text())["mesh_to_world"])
    quarter = np.eye(4)
    quarter[:2, :2] = [[0, -1], [1, 0]]
    middle = middle_of(tmp_path / "plates.ply", pose)
    quarter[:3, 3] = middle - quarter[:3, :3] @ middle
    place(tmp_path / "place.json", quarter @ pose)
    assert lightfactor(*lit, "-o", tmp_path / "x.exr")[0] == 0
    (first, _), (second, layers), (by_hand, other) = (
        read(path) for path in (tmp_path / "turn/000.exr", tmp_path / "turn/001.exr", tmp_path / "x.exr")
    )
    assert np.abs(first - second).max() > 0.1
    # Rays that just meet an edge, or just miss it, by rounding.
    off = np.abs(second - by_hand).max(axis=2) > 1e-4
    assert off.mean() < 0.01
    assert np.abs(layers["A"] - other["A"]).max() < 0.1


def middle_of(path: Path, pose: np.ndarray) -> np.ndarray:
    """The middle of the box around a mesh in its place."""
    vertices = read_mesh(path).vertices @ pose[:3, :3].T + pose[:3, 3]
    return np.asarray((vertices.min(axis=0) + vertices.max(axis=0)) / 2)


CENTRE = np.array([0.1, -0.2, 0.3])


def test_turning_a_light_by_any_angle_keeps_all_of_it() -> None:
    room = np.random.default_rng(0).uniform(0, 1, (4, 8, 3)).astype(np.float32)
    element = LightElement("room", np.array([[0.6, 0, 0.8]]), np.ones((1, 3)), room)
    by_steps = turned(turned(element, CENTRE, 50), CENTRE, 40)
    whole = turned(element, CENTRE, 90)
    assert_allclose(by_steps.directions, [[0, 0.6, 0.8]], atol=1e-15)
    assert whole.slow_map is not None
    assert by_steps.slow_map is not None
    np.testing.assert_array_equal(whole.slow_map, np.roll(room, 2, axis=1))
    assert_allclose(by_steps.slow_map.sum(axis=1), room.sum(axis=1), rtol=1e-6)
    assert turned(element, CENTRE, -360) is element


def test_a_strip_and_a_video_are_the_folders_pictures(
    lightfactor: Command, lit: tuple[object, ...], tmp_path: Path
) -> None:
    turning = (*lit, "--turntable", 10, "--turn", "light")
    code, out, _ = lightfactor(*turning, "-o", tmp_path / "turn")
    assert code == 0
    exposure = float(out.split("--exposure ")[1].split()[0])
    stated = ("--exposure", exposure)
    assert lightfactor(*turning, *stated, "-o", tmp_path / "strip.png")[0] == 0
    assert lightfactor(*turning, *stated, "--fps", 12, "-o", tmp_path / "turn.mp4")[0] == 0
    strip = cv2.imread(str(tmp_path / "strip.png"), cv2.IMREAD_UNCHANGED)
    assert strip.shape == (2 * 36, 5 * 48, 4)
    video = cv2.VideoCapture(str(tmp_path / "turn.mp4"))
    assert video.get(cv2.CAP_PROP_FPS) == pytest.approx(12)
    brightest = 0.0
    for k in range(10):
        radiance, layers = read(tmp_path / "turn" / f"{k:03d}.exr")
        tile = strip[36 * (k // 5) :, 48 * (k % 5) :][:36, :48]
        picture = cv2.imread(str(tmp_path / "turn" / f"{k:03d}.png"), cv2.IMREAD_UNCHANGED)
        # The exposure is printed to two digits.
        assert np.abs(tile.astype(int) - picture).max() <= 1
        there, frame = video.read()
        assert there
        expected = 255 * linear_to_srgb(np.clip(radiance * 2**exposure, 0, 1))
        # What compression leaves of 48 by 36 pixels.
        assert np.abs(frame[..., ::-1] - expected).mean() < 6
        brightest = max(brightest, np.percentile(radiance.max(axis=2)[layers["A"] > 0], 99.5))
    assert not video.read()[0]
    # All are exposed as the brightest needs it.
    assert brightest * 2**exposure == pytest.approx(1, rel=0.01)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--turntable", 3, "-o", "x.exr"), ["x.exr", "--turntable", "folder"]),
        (("--turntable", 3, "-o", "x.avi"), ["x.avi", ".mp4"]),
        (("-o", "x.mp4"), ["x.mp4", "--turntable"]),
        (("--turn", "light", "-o", "x.png"), ["--turn", "give --turntable"]),
        (("--turntable", 3, "--turn", "lihgt", "-o", "x"), ["--turn lihgt", "did you mean 'light'?"]),
        (("--turntable", 3, "--turn", "object", "-o", "x"), ["a sphere looks the same"]),
        (("--turntable", 3, "--photo", "1.exr", "-o", "x"), ["--photo", "--turn light"]),
        (("--turntable", 3, "--std", "-o", "x.mp4"), ["--std", ".mp4"]),
        (("--turntable", 3, "--fps", 5, "-o", "x"), ["--fps", ".mp4"]),
        (("--turntable", 3, "--fps", 0, "-o", "x.mp4"), ["--fps is 0"]),
        (("--turntable", 999, "--size", "4000x3000", "-o", "x.png"), ["999 pictures", "too many"]),
        (("--rotate-light", "nan", "-o", "x.png"), ["--rotate-light is nan"]),
        (("--mean", "-o", "x.png"), ["--mean", "leave it out"]),
    ],
)
def test_bad_options_are_one_clear_sentence(
    lightfactor: Command,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    options: tuple[object, ...],
    words: list[str],
) -> None:
    write_result(tmp_path / "result")
    monkeypatch.chdir(tmp_path)
    code, _, err = lightfactor("render", "result", *options)
    assert code == 1
    assert err.startswith("lightfactor: error: ")
    assert len(err.strip().splitlines()) == 1
    for word in words:
        assert word in err
    assert [path.name for path in tmp_path.iterdir()] == ["result"]
