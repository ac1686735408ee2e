"""Poses of rendered photographs with exact truth, found by features, a board, and both; and where they can't be found.

Looking for features takes up to a second a photograph, so that this file takes most of a minute: fewer photographs, or
coarser ones, would not show the accuracy that is asked for.
"""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import typer
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from capture.boards.board import parse_board
from capture.photoset import load_photoset
from capture.progress import silent
from recon.commands.register import register
from recon.poses.register.features import likely_pairs
from recon.poses.register.posesfile import Registration
from recon.poses.register.registration import register_by_features

Floats = NDArray[np.float64]

_SPEC = importlib.util.spec_from_file_location("texturedset", Path(__file__).with_name("texturedset.py"))
assert _SPEC is not None
assert _SPEC.loader is not None
sets: ModuleType = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(sets)

PHOTOS = 5
POSES = sets.ring(PHOTOS, 18)


def _register(folder: Path, work: Path, masked: bool = True, board: str | None = None) -> Registration:
    work.mkdir()
    parsed = None if board is None else parse_board(board)
    return register_by_features(load_photoset(folder, find_poses=True), work, masked, parsed, silent)


def _centres(poses: Floats) -> Floats:
    return np.asarray(-np.einsum("nji,nj->ni", poses[:, :3, :3], poses[:, :3, 3]))


def _errors(found: Floats, truth: Floats) -> tuple[Floats, Floats]:
    """Radians, and shares of the cameras' distance from the origin, that poses are off."""
    turns = Rotation.from_matrix(truth[:, :3, :3] @ found[:, :3, :3].transpose(0, 2, 1)).magnitude()
    off = np.linalg.norm(_centres(found) - _centres(truth), axis=1)
    return turns, off / np.linalg.norm(_centres(truth), axis=1)


def _z(found: Registration, truth: Floats) -> Floats:
    """Errors (c, 6) over the standard deviations that are stated, in [exp(w) R | t + s]."""
    turns = Rotation.from_matrix(truth[:, :3, :3] @ found.poses[:, :3, :3].transpose(0, 2, 1)).as_rotvec()
    shifts = truth[:, :3, 3] - found.poses[:, :3, 3]
    covariances = found.pose_covariances
    assert covariances is not None
    return np.concatenate([turns, shifts], axis=1) / np.sqrt(np.einsum("nii->ni", covariances))


@pytest.fixture(scope="module")
def textured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five photographs with masks before nothing, three of which state their pose."""
    folder: Path = tmp_path_factory.mktemp("sets") / "textured"
    sets.write_set(folder, POSES, given=(0, 2, 4))
    return folder


def test_features_place_a_textured_body(textured: Path, tmp_path: Path) -> None:
    found = _register(textured, tmp_path / "work")
    assert (found.method, found.scale_from, len(found.names)) == ("features", "poses", PHOTOS)
    assert not found.unregistered
    assert not found.warnings
    truth = np.array(POSES)
    # What is asked of poses: 0.05 degrees and 0.1% of the distance. The three given poses fix the frame.
    turns, shifts = _errors(found.poses, truth)
    assert np.degrees(turns).max() < 0.05
    assert shifts.max() < 0.001
    # Poses that are given exactly don't make the structure exact: errors stay about as large as stated.
    assert 0.4 < np.sqrt((_z(found, truth) ** 2).mean()) < 1.6
    # The cloud lies on the body: its hills end between 0.73 and 1.27 of its radius.
    reach = np.linalg.norm(found.points, axis=1) / sets.RADIUS
    assert len(found.points) > 300
    assert np.quantile(reach, 0.02) > 0.7
    assert np.quantile(reach, 0.98) < 1.3


def _first_of(textured: Path, folder: Path, count: int) -> Path:
    """The manifest of the first photographs alone, in a new folder."""
    folder.mkdir()
    for path in textured.glob("*.png"):
        (folder / path.name).symlink_to(path)
    manifest = (textured / "photoset.toml").read_text(encoding="utf-8").split("[[photo]]")
    (folder / "photoset.toml").write_text("[[photo]]".join(manifest[: 1 + count]), encoding="utf-8")
    return folder / "photoset.toml"


@pytest.mark.sweep
def test_equal_photos_give_equal_poses(textured: Path, tmp_path: Path) -> None:
    # Of two alone, poses are equal whatever the random numbers are.
    folder = _first_of(textured, tmp_path / "three", 3).parent
    first, second = (_register(folder, tmp_path / name) for name in ("first", "second"))
    np.testing.assert_array_equal(first.poses, second.poses)
    np.testing.assert_array_equal(first.points, second.points)


# Of few photographs poses are less certain.
@pytest.mark.parametrize(
    ("count", "turned_deg", "shifted"),
    [
        pytest.param(3, 0.2, 0.004, marks=pytest.mark.slow),
        pytest.param(5, 0.15, 0.003, marks=pytest.mark.sweep),
    ],
)
def test_a_board_in_some_photos_fixes_place_and_size(
    count: int, turned_deg: float, shifted: float, tmp_path: Path
) -> None:
    sets.write_set(tmp_path / "set", POSES[:count], boards=range(count // 3, count), masks=False)
    found = _register(tmp_path / "set", tmp_path / "work", masked=False, board=sets.BOARD.spec)
    assert (found.method, found.scale_from, len(found.names)) == ("features", "board", count)
    truth = np.array(POSES[:count]) @ sets.BOARD_TO_WORLD
    turns, shifts = _errors(found.poses, truth)
    # No similarity is fitted here: the first photos, which don't show the board, hang on the others.
    assert np.degrees(turns).max() < turned_deg
    assert shifts.max() < shifted
    assert np.sqrt((_z(found, truth) ** 2).mean()) < 1.5
    assert found.relative_std is not None
    assert found.relative_std < 0.001


def test_a_board_in_all_photos_needs_no_features(tmp_path: Path) -> None:
    poses = sets.ring(4, 40)
    sets.write_set(tmp_path / "set", poses, surface="plain", boards=range(4))
    found = _register(tmp_path / "set", tmp_path / "work", board=sets.BOARD.spec)
    assert (found.method, found.scale_from, found.metric) == ("board", "board", True)
    truth = np.array(poses) @ sets.BOARD_TO_WORLD
    turns, shifts = _errors(found.poses, truth)
    assert np.degrees(turns).max() < 0.15  # some twenty corners of a board that the body covers in part
    assert shifts.max() < 0.003
    # 24 numbers; corners at the body's edge are off by more than noise.
    assert np.sqrt((_z(found, truth) ** 2).mean()) < 1.8


@pytest.mark.parametrize(
    ("surface", "poses", "says"),
    [
        (
            "plain",
            sets.ring(2, 18),
            r"features within the masks, and 0 of 1 pairs .*textured backdrop.*--board",
        ),
        pytest.param(
            "mirror",
            sets.ring(3, 12),
            r"could not be placed .*[Ss]hiny or untextured.*textured backdrop",
            marks=pytest.mark.slow,
        ),
        ("textured", sets.ring(1, 18) * 2, r"no parallax: all photos seem to be taken from one place"),
        ("textured", sets.ring(1, 18), r"lists one photo"),
    ],
)
def test_what_defeats_features_is_told(surface: str, poses: list[Floats], says: str, tmp_path: Path) -> None:
    sets.write_set(tmp_path / "set", poses, surface)
    with pytest.raises(ValueError, match=says):
        _register(tmp_path / "set", tmp_path / "work")


@pytest.mark.sweep
def test_gantry_poses_that_contradict_the_photos_are_refused(textured: Path, tmp_path: Path) -> None:
    # The angles of another gantry: its positions three times as far apart.
    manifest = _first_of(textured, tmp_path / "set", 3)
    first, *entries = manifest.read_text(encoding="utf-8").split("[[photo]]")
    wrong = [
        "\n".join(line for line in entry.splitlines() if not line.startswith("world_to_camera"))
        + f"\nworld_to_camera = {pose.tolist()}\n"
        for entry, pose in zip(entries, sets.ring(3, 54), strict=True)
    ]
    manifest.write_text("[[photo]]".join([first, *wrong]), encoding="utf-8")
    with pytest.raises(
        ValueError, match=r"own poses and the found ones are .* degrees apart .*check the gantry"
    ):
        _register(tmp_path / "set", tmp_path / "work")


@pytest.fixture
def run() -> Callable[..., str]:
    """`run(*arguments)`: what `register` prints."""
    app = typer.Typer()
    app.command()(register)

    def call(*arguments: str) -> str:
        result = CliRunner().invoke(app, arguments)
        if result.exception is not None and not isinstance(result.exception, SystemExit):
            raise result.exception
        assert result.exit_code == 0, result.output
        return result.output

    return call


@pytest.mark.slow
def test_command_writes_what_the_set_then_reads(tmp_path: Path, run: Callable[..., str]) -> None:
    # The last photo doesn't show the board, and nobody's features help it.
    poses = sets.ring(4, 40)
    sets.write_set(tmp_path, poses, surface="plain", boards=range(3))
    with pytest.raises(ValueError, match="has no pose"):
        load_photoset(tmp_path)
    printed = run(str(tmp_path), "--board", sets.BOARD.spec)
    assert "3 of 4 photos placed, in the board's frame, in metres" in printed
    assert "1 of 4 photos have no pose: 003.png" in printed
    document = json.loads((tmp_path / "poses.json").read_text(encoding="utf-8"))
    assert (document["format"], document["method"], document["points"]) == (1, "board", "poses-points.ply")
    assert document["scale"] == {"metric": True, "from": "board", "relative_std": None}
    assert set(document["inputs"]) >= {"photoset.toml", "000.png", "mask000.png"}
    (lacking,) = document["unregistered"]
    assert lacking["file"] == "003.png"
    assert "the board was not found" in lacking["reason"]
    for name in ("poses.png", "poses-points.ply"):
        assert (tmp_path / name).stat().st_size > 0
    with pytest.raises(ValueError, match=r'no pose for photo "003\.png": the board: .*take the photo out'):
        load_photoset(tmp_path)
    manifest = tmp_path / "photoset.toml"
    text = manifest.read_text(encoding="utf-8")
    manifest.write_text(text[: text.rindex("[[photo]]")], encoding="utf-8")
    loaded = np.array([photo.camera.world_to_camera for photo in load_photoset(tmp_path).photos])
    turns, shifts = _errors(loaded, np.array(poses[:3]) @ sets.BOARD_TO_WORLD)
    assert np.degrees(turns).max() < 0.15
    assert shifts.max() < 0.003


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--colmap", "a", "--transforms", "b"], "--colmap and --transforms both say where poses come from"),
        (["--colmap", "a", "--whole-image"], "--whole-image are for features, not for --colmap"),
        (["--board", "charuco:7x5"], "charuco"),
        (["-o", "poses.txt"], r"must end in \.json"),
        (["--transforms", "nothing.json"], r"nothing\.json: cannot be read"),
        (["--colmap", "nowhere"], "nowhere: is not a folder"),
    ],
)
def test_wrong_arguments_are_named(
    arguments: list[str], says: str, textured: Path, run: Callable[..., str]
) -> None:
    with pytest.raises(ValueError, match=says):
        run(str(textured), *arguments)
    assert not (textured / "poses.json").exists()


@pytest.mark.sweep
def test_very_many_photos_match_those_that_look_alike() -> None:
    # Photographs along a line, each sharing features with the next ones, listed in any order.
    rng = np.random.default_rng(4)
    world = rng.integers(0, 255, (4000, 128)).astype(np.uint8)
    order = rng.permutation(120)
    seen = [
        np.clip(world[30 * n : 30 * n + 150] + rng.integers(0, 9, (150, 128)), 0, 255) for n in range(120)
    ]
    pairs = likely_pairs([seen[n].astype(np.uint8) for n in order])
    found = {frozenset((int(order[a]), int(order[b]))) for a, b in pairs}
    # All neighbours within three, of which a fifth or more is shared; and far fewer pairs than all 7140.
    assert all(frozenset((n, n + k)) in found for k in (1, 2, 3) for n in range(120 - k))
    assert len(pairs) < 5000
