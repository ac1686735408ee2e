"""The photo sets that figures are drawn from: built-in scenes, photographed once."""

from __future__ import annotations

from pathlib import Path

from benchmarks.papers.entry import Workplace
from benchmarks.smallscene import small_scene
from capture.terminal import track
from synthetic.lights.illumination import Given
from synthetic.scenes.build import read_staging
from synthetic.scenes.builtin import scene_path
from synthetic.writer import write_photoset

# At 0.6 m a sphere of 20 mm appears 18 px in radius.
_SMALL = {"width": "64", "height": "48", "focal_px": "540"}
_FEW = {"photos": "8", "step_deg": "22.5"}
_CHANGED = {
    "rh01-teflon": {**_SMALL, **_FEW, "held_out": "[3]"},
    "rh01-lighting": {**_SMALL, **_FEW, "held_out": "[3]"},
    "rh01-area": {**_SMALL, **_FEW},
    "rh01-marschner": {**_SMALL, "photos": "20", "step_deg": "9", "held_out": "[10]"},
}


def photographed(scene: str, place: Workplace, given: Given | None = None) -> Path:
    """The folder of a built-in scene's photo set, photographed if it hasn't been yet; a small one where that does.

    given : how the set states its light, in place of the scene's own way.
    """
    folder = place.sets / (f"{scene}-small" if place.quick else scene)
    if (folder / "photoset.toml").exists():
        return folder
    path = scene_path(scene)
    if place.quick:
        text = path.read_text(encoding="utf-8")
        path = place.sets / f"{scene}-small.toml"
        path.write_text(small_scene(text, _CHANGED[scene]), encoding="utf-8")
    write_photoset(read_staging(path, given), folder, track)
    return folder
