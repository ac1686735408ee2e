"""The contact sheet of the built-in scenes, docs/scenes.png: one photograph of each, as its camera wrote it.

python docs/scenes.py [OUT.png]
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from capture.photoset import load_photoset
from capture.terminal import track
from synthetic.scenes.build import read_staging
from synthetic.scenes.builtin import scene_names, scene_path
from synthetic.sensing.contactsheet import contact_sheet, displayed_photo
from synthetic.writer import write_photoset


def photograph(name: str) -> NDArray[np.float64]:
    """One photograph of a built-in scene (h, w, 3), as it is displayed."""
    staging = read_staging(scene_path(name))
    scene = staging.scene
    # A third of the way along the gantry: lit from the side.
    shot = scene.shots[len(scene.shots) // 3]
    effort = replace(scene.effort, directions=min(scene.effort.directions, 256))
    alone = replace(scene, shots=(shot,), effort=effort)
    with TemporaryDirectory() as folder:
        write_photoset(replace(staging, scene=alone, calibration=None), Path(folder))
        photoset = load_photoset(Path(folder))
        # Of a bracket the middle.
        photo = photoset.photos[len(photoset.photos) // 2]
        return displayed_photo(photoset, photo)


def main(out: Path) -> None:
    """Write the sheet."""
    pictures = [(name, photograph(name)) for name in track(scene_names(), "Scenes")]
    contact_sheet(pictures).savefig(out, dpi=100, metadata={"Software": None})


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).with_name("scenes.png"))
