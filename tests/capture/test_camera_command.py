"""The commands `calibrate camera` and `board`: what they write, what they refuse."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from capture.boards.board import parse_board
from capture.camera import Camera
from capture.commands.board import board
from capture.commands.camera import camera
from capture.manifest import CameraTable
from capture.photoset import build_camera
from synthetic.sensing.boardphotos import board_photo, board_poses

SPEC = "chessboard:9x6:0.025"
TRUE = Camera("SIMPLE_RADIAL", [500, 205, 148, -0.1], 400, 300, np.eye(4))


def run(command, *arguments: str | Path) -> str:
    app = typer.Typer()
    app.command()(command)
    result = CliRunner(env={"COLUMNS": "120"}).invoke(app, [str(argument) for argument in arguments])
    if result.exception is not None:
        raise result.exception
    return result.output


@pytest.fixture(scope="module")
def shots(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six photographs of a chessboard in a folder whose name has a space and an umlaut."""
    folder = tmp_path_factory.mktemp("shots") / "Schachbrett für später"
    folder.mkdir()
    rng = np.random.default_rng(0)
    printed = parse_board(SPEC)
    for k, pose in enumerate(board_poses(printed, TRUE, 6, rng, fill=0.7)):
        picture = board_photo(TRUE.posed(pose), printed, rng, samples=2)
        cv2.imencode(".png", picture)[1].tofile(folder / f"ansicht {k}.png")
    return folder


def photos(folder: Path) -> list[Path]:
    return sorted(folder.glob("ansicht *.png"))


@pytest.fixture(scope="module")
def calibrated(shots: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The camera file of these photographs, and what the command printed."""
    out = tmp_path_factory.mktemp("calibrated") / "Käme ra.json"
    return out, run(camera, *photos(shots), "--board", SPEC, "-o", out)


def test_a_camera_file_with_its_figure(shots: Path, calibrated: tuple[Path, str]) -> None:
    out, text = calibrated
    assert {path.name for path in out.parent.iterdir()} == {"Käme ra.json", "Käme ra-figure.png"}
    assert "held out" in text or "left out" in text
    document = json.loads(out.read_text(encoding="utf-8"))
    assert document["format"] == 1
    assert document["board"] == SPEC
    assert set(document["inputs"]) == {path.name for path in photos(shots)}
    assert len(document["views"]) == 6
    assert sum(candidate["chosen"] for candidate in document["ladder"]) == 1
    assert document["rms_px"]["fitted"] < document["rms_px"]["held_out"]
    covariance = np.array(document["covariance"])
    assert np.linalg.eigvalsh(covariance).min() > -1e-12
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), document["std"], rtol=1e-12)
    assert abs(document["params"][0] - 500) < 3 * document["std"][0]
    picture = cv2.imdecode(np.fromfile(out.parent / "Käme ra-figure.png", np.uint8), cv2.IMREAD_COLOR)
    assert picture.shape[1] > 1000


def test_colmap_and_opencv_project_alike_through_the_saved_camera(calibrated: tuple[Path, str]) -> None:
    out = calibrated[0]
    saved = build_camera(out.parent / "photoset.toml", (CameraTable(file=out.name),), np.eye(4), "[camera]")
    document = json.loads(out.read_text())
    values = dict(zip(document["param_names"], document["params"], strict=True))
    fx, fy = values.get("fx", values.get("f")), values.get("fy", values.get("f"))
    # OpenCV's own convention: centres at integers, so half a pixel less.
    matrix = np.array([[fx, 0, values["cx"] - 0.5], [0, fy, values["cy"] - 0.5], [0, 0, 1]])
    order = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
    points = np.random.default_rng(1).uniform([-0.3, -0.2, 0.9], [0.3, 0.2, 1.5], (200, 3))
    theirs, _ = cv2.projectPoints(
        points, np.zeros(3), np.zeros(3), matrix, np.array([values.get(name, 0.0) for name in order])
    )
    np.testing.assert_allclose(saved.project(points), theirs[:, 0] + 0.5, atol=1e-6, rtol=0)


def test_bad_photographs_are_named_and_leave_nothing_behind(shots: Path, tmp_path: Path) -> None:
    good = photos(shots)
    cut, text = tmp_path / "cut off.png", tmp_path / "text.jpg"
    cut.write_bytes(good[0].read_bytes()[:5000])
    text.write_text("no picture")
    out = tmp_path / "out" / "camera.json"
    cases = {cut: "truncated", text: "not an image", tmp_path / "no.png": "not exist"}
    for bad, says in cases.items():
        with pytest.raises(ValueError, match=says) as caught:
            run(camera, *good, bad, "--board", SPEC, "-o", out)
        assert bad.name in str(caught.value)
        assert not out.exists()


def test_photographs_of_another_size_are_left_out_and_named(
    shots: Path, calibrated: tuple[Path, str], tmp_path: Path
) -> None:
    wide = [tmp_path / f"wide {k}.png" for k in range(2)]
    for path in wide:
        # The board itself shows: without a word it would be one more view of another lens.
        picture = cv2.imdecode(np.fromfile(photos(shots)[0], np.uint8), cv2.IMREAD_UNCHANGED)
        cv2.imwrite(str(path), cv2.resize(picture, (800, 600)))
    both = tmp_path / "both.json"
    text = run(camera, *wide, *photos(shots), "--board", SPEC, "-o", both)
    assert "wide 0.png: left out because its size is 800x600 pixels, and 6 of 8 photos have 400x300" in text
    documents = [json.loads(path.read_text(encoding="utf-8")) for path in (calibrated[0], both)]
    # Sums in another order: rounding.
    np.testing.assert_allclose(documents[0]["params"], documents[1]["params"], rtol=1e-5, atol=1e-5)
    dropped = [view["photo"] for view in documents[1]["views"] if view["dropped"] is not None]
    assert dropped == [path.name for path in wide]
    with pytest.raises(ValueError, match=r"2 of 800x600, 2 of 400x300 pixels"):
        run(camera, *wide, *photos(shots)[:2], "--board", SPEC, "-o", both)


def test_a_photograph_without_a_board_is_named_and_does_no_harm(shots: Path, tmp_path: Path) -> None:
    empty = tmp_path / "empty.png"
    cv2.imwrite(str(empty), np.full((300, 400), 90, np.uint8))
    text = run(camera, *photos(shots), empty, "--board", SPEC, "-o", tmp_path / "camera.json")
    assert "empty.png: the board was not found" in text
    assert "?." not in text
    views = json.loads((tmp_path / "camera.json").read_text())["views"]
    assert {view["photo"]: view["dropped"] is None for view in views}["empty.png"] is False


def test_a_board_that_is_hardly_seen_or_another_one_is_told(shots: Path, tmp_path: Path) -> None:
    out = tmp_path / "camera.json"
    cv2.imwrite(str(tmp_path / "empty.png"), np.full((300, 400), 90, np.uint8))
    few = [*photos(shots)[:2], tmp_path / "empty.png"]
    with pytest.raises(ValueError, match="found in 2 of 3 photos"):
        run(camera, *few, "--board", SPEC, "-o", out)
    with pytest.raises(ValueError, match="9x6 inner corners were seen in 3 of 3"):
        run(camera, *photos(shots)[:3], "--board", "chessboard:8x5:0.025", "-o", out)
    with pytest.raises(ValueError, match="is written as JSON"):
        run(camera, *photos(shots), "--board", SPEC, "-o", tmp_path / "camera.toml")
    assert not out.exists()


def test_an_input_is_never_overwritten(shots: Path, tmp_path: Path) -> None:
    taken = tmp_path / "camera-figure.png"
    shutil.copy(photos(shots)[0], taken)
    with pytest.raises(ValueError, match="one of the inputs"):
        run(camera, *photos(shots), taken, "--board", SPEC, "-o", tmp_path / "camera.json")


def test_a_board_is_printed_and_says_what_it_is(tmp_path: Path) -> None:
    out = tmp_path / "board.pdf"
    text = run(board, "charuco", "7x5", "--square-mm", "30", "--marker-mm", "22", "--paper", "a4", "-o", out)
    assert "--board charuco:7x5:0.03:0.022:DICT_5X5_100" in text
    content = out.read_bytes()
    assert content.startswith(b"%PDF")
    # A4 lying: 297 x 210 mm in points.
    assert b"/MediaBox [ 0 0 841.88" in content
    run(board, "chessboard", "9x6", "--square-mm", "24", "-o", out)
    for arguments, says in (
        (("chessboard", "9x6", "--marker-mm", "20"), "no markers"),
        (("chessboard", "9x6", "--square-mm", "40"), "doesn't fit"),
        (("charuco", "7by5"), "COLUMNSxROWS"),
        (("charco", "7x5"), "did you mean 'charuco'"),
        (("charuco", "7x5", "--paper", "a9"), "a4, a3"),
    ):
        with pytest.raises(ValueError, match=says):
            run(board, *arguments, "-o", tmp_path / "other.pdf")
    with pytest.raises(ValueError, match=r"ends in \.pdf"):
        run(board, "charuco", "7x5", "-o", tmp_path / "board.png")
    assert {path.name for path in tmp_path.iterdir()} == {"board.pdf"}
