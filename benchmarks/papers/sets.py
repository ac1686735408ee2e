"""The photo sets that figures are drawn from: built-in scenes, photographed once."""

from __future__ import annotations

from pathlib import Path

from benchmarks.papers.entry import Workplace
from capture.terminal import track
from synthetic.scenes.build import read_staging
from synthetic.scenes.builtin import scene_path
from synthetic.writer import write_photoset


def photographed(scene: str, place: Workplace) -> Path:
    """The folder of a built-in scene's photo set, photographed if it hasn't been yet."""
    folder = place.sets / scene
    if not (folder / "photoset.toml").exists():
        write_photoset(read_staging(scene_path(scene)), folder, track)
    return folder
