"""A scene by its name, photographed into a photo set with its truth beside it. No terminal."""

from __future__ import annotations

import json
from pathlib import Path

from capture.files.outfolder import result_folder
from capture.photoset import MANIFEST_NAME
from synthetic.lights.illumination import Given
from synthetic.render.photograph import Progress
from synthetic.scenes.build import read_staging
from synthetic.scenes.builtin import scene_path
from synthetic.sensing.contactsheet import write_contact_sheet
from synthetic.writer import CONTACT_NAME, PHOTOSET_FILES, TRUTH_NAME, write_photoset


def photograph_scene(
    scene: str,
    out: Path,
    given: Given | None = None,
    seed: int | None = None,
    progress: Progress | None = None,
) -> None:
    """Photograph a scene into the folder `out`: photographs, manifest, truth, and a sheet to look at.

    scene : the name of a built-in one, or a scene file. given : what the set tells of the light, and seed : of all that
    is random, in place of what the file says. ValueError where the scene is wrong, or the folder holds another set.
    """
    staging = read_staging(scene_path(scene), given, seed)
    _refuse_another_set(out, staging.scene.name)
    with result_folder(out, PHOTOSET_FILES) as folder:
        write_photoset(staging, folder, progress)
        write_contact_sheet(folder, folder / CONTACT_NAME)


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
