"""The command `synth` at work: scenes by name, progress on the terminal, photo sets on disk."""

from __future__ import annotations

import json
from pathlib import Path

from rich.table import Table

from capture.photoset import MANIFEST_NAME
from capture.tasks.workplace import opened_workplace
from capture.terminal import console, leave_cleanly_when_stopped, track
from synthetic.lights.illumination import Given
from synthetic.render.photograph import STAGE
from synthetic.scenes.builtin import scene_names, scene_path
from synthetic.scenes.scenefile import read_scene_file
from synthetic.shoot import photograph_scene
from synthetic.writer import CONTACT_NAME, TRUTH_NAME


def run_synth(
    scene: str,
    out: Path,
    given: Given | None,
    seed: int | None,
    workers: int | None = None,
    cluster: str | None = None,
) -> None:
    """Photograph a scene into a photo set, and say what was done. workers, cluster : as of `opened_workplace`."""
    leave_cleanly_when_stopped()
    with opened_workplace(out / MANIFEST_NAME, workers, cluster) as workplace:
        photograph_scene(scene, out, given, seed, track)
        workplace.store.forget(STAGE)
    truth = json.loads((out / TRUTH_NAME).read_text(encoding="utf-8"))
    error = truth["integration"]["relative_rms_error"]
    console.print(
        f"{truth['name']}: {len(truth['photos'])} photographs, light summed over directions"
        f" to {100 * error:.1g}% (relative RMS).",
        soft_wrap=True,
        markup=False,
    )
    places = f"Photo set: {out / MANIFEST_NAME}   Look at it: {out / CONTACT_NAME}"
    console.print(places, soft_wrap=True, markup=False)


def list_built_in() -> None:
    """Print names and descriptions of the built-in scenes."""
    table = Table("scene", "what")
    for name in scene_names():
        table.add_row(name, read_scene_file(scene_path(name)).description)
    console.print(table)


def show_scene(scene: str) -> None:
    """Print a scene file as it is."""
    path = scene_path(scene)
    read_scene_file(path)
    print(path.read_text(encoding="utf-8"), end="")  # noqa: T201
