"""The command `synth` at work: scenes by name, progress on the terminal, photo sets on disk."""

from __future__ import annotations

import json
from pathlib import Path

from rich.table import Table

from capture.files.outfolder import result_folder
from capture.photoset import MANIFEST_NAME
from capture.terminal import console, leave_cleanly_when_stopped, track
from synthetic.lights.illumination import Given
from synthetic.scenes.build import read_staging
from synthetic.scenes.builtin import scene_names, scene_path
from synthetic.scenes.scenefile import read_scene_file
from synthetic.sensing.contactsheet import write_contact_sheet
from synthetic.writer import CONTACT_NAME, PHOTOSET_FILES, TRUTH_NAME, write_photoset


def run_synth(scene: str, out: Path, given: Given | None, seed: int | None) -> None:
    """Photograph a scene into a photo set, and say what was done."""
    leave_cleanly_when_stopped()
    staging = read_staging(scene_path(scene), given, seed)
    _refuse_another_set(out, staging.scene.name)
    with result_folder(out, PHOTOSET_FILES) as folder:
        write_photoset(staging, folder, track)
        write_contact_sheet(folder, folder / CONTACT_NAME)
        truth = json.loads((folder / TRUTH_NAME).read_text(encoding="utf-8"))
    error = truth["integration"]["relative_rms_error"]
    console.print(
        f"{staging.scene.name}: {len(truth['photos'])} photographs, light summed over directions"
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


def _refuse_another_set(out: Path, name: str) -> None:
    """ValueError if a folder holds a photo set that is not an earlier one of this scene."""
    if not (out / MANIFEST_NAME).exists():
        return
    try:
        other = json.loads((out / TRUTH_NAME).read_text(encoding="utf-8"))["name"]
    except (OSError, ValueError, KeyError, TypeError):
        raise ValueError(
            f"{out}: holds a photo set that this command didn't make, which would be lost; give another folder"
        ) from None
    if other != name:
        raise ValueError(
            f"{out}: holds the photo set of another scene, {other!r}; give another folder, or remove it"
        )
