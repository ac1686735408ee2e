"""Registering and aligning go on where they were stopped, and compute anew what has changed, and that alone."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from lightfactor.cli import app
from recon.poses.align import run as aligning
from recon.poses.register import features, registration

from . import test_align_command as lumps
from . import texturedset as sets
from .test_align_command import lump  # noqa: F401  (a fixture)

POSES = sets.ring(3, 14)


pytestmark = pytest.mark.usefixtures("own_cache")


def run(*arguments: object) -> str:
    done = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert done.exit_code == 0, done.output
    return done.output


def numbers(path: Path) -> dict[str, Any]:
    """What was found, without the hashes of what it was found from."""
    found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return {key: value for key, value in found.items() if key not in ("inputs", "software")}


@pytest.mark.sweep
def test_registering_goes_on_with_the_features_that_it_has(
    tmp_path: Path, own_cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "set"
    sets.write_set(folder, POSES, given=(0, 2))
    map_incrementally = registration.map_incrementally

    def stopped(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(registration, "map_incrementally", stopped)
    assert CliRunner().invoke(app, ["register", str(folder)]).exit_code != 0
    assert not (folder / "poses.json").exists()
    assert len(list(own_cache.glob("*/features/*.kept"))) == len(POSES)
    monkeypatch.setattr(registration, "map_incrementally", map_incrementally)

    # The first photograph gets darker by a code or two: its features alone are looked for again.
    first = next(iter(sorted(path for path in folder.glob("*.png") if "mask" not in path.name)))
    codes = cv2.imread(str(first), cv2.IMREAD_UNCHANGED)
    cv2.imwrite(str(first), (codes * 0.99).astype(codes.dtype))
    run("register", folder)
    assert len(list(own_cache.glob("*/features/*.kept"))) == len(POSES) + 1
    found = numbers(folder / "poses.json")

    # What is registered already is there at once; anew, and with features found in other places, it is the same.
    monkeypatch.setattr(registration, "map_incrementally", lambda *_: pytest.fail("it was mapped anew"))
    run("register", folder)
    assert numbers(folder / "poses.json") == found
    monkeypatch.setattr(registration, "map_incrementally", map_incrementally)
    run("register", folder, "--fresh")
    assert numbers(folder / "poses.json") == found


def test_a_picture_without_features_has_none(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "grey.png"), np.full((60, 80, 3), 128, np.uint8))
    keypoints, descriptors = features.find_features((tmp_path / "grey.png", None))
    assert (len(keypoints), len(descriptors)) == (0, 0)
    assert [path.name for path in tmp_path.iterdir()] == ["grey.png"]


def test_aligning_reads_and_places_what_has_changed(
    tmp_path: Path,
    own_cache: Path,
    lump: Any,  # noqa: F811
    counted: Callable[[Any, str], list[None]],
) -> None:
    folder = lumps.write_set(tmp_path / "set", lump, keys=lumps.start_near())
    placed = counted(aligning, "place_mesh")
    run("align", folder)
    found = numbers(folder / "alignment.json")
    (folder / "alignment.json").unlink()
    run("align", folder)
    assert (len(placed), numbers(folder / "alignment.json")) == (1, found)
    assert len(list(own_cache.glob("*/silhouettes/*.kept"))) == len(lumps.CAMERAS)

    # One mask gets a softer outline.
    mask = cv2.imread(str(folder / "1_mask.png"), cv2.IMREAD_UNCHANGED)
    cv2.imwrite(str(folder / "1_mask.png"), cv2.blur(mask, (2, 1)))
    run("align", folder)
    changed = numbers(folder / "alignment.json")
    assert len(placed) == 2
    assert len(list(own_cache.glob("*/silhouettes/*.kept"))) == len(lumps.CAMERAS) + 1
    assert changed["mesh_to_world"] != found["mesh_to_world"]
    run("align", folder, "--fresh")
    assert (len(placed), numbers(folder / "alignment.json")) == (3, changed)
