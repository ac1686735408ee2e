"""The demonstration: a teflon sphere on a gantry, after RH01's set-up (section 6, "Data Acquisition")."""

from __future__ import annotations

from pathlib import Path

from synthetic.render.photograph import Progress
from synthetic.scenes.build import read_staging
from synthetic.scenes.builtin import scene_path
from synthetic.staging import Staging
from synthetic.writer import write_photoset


def demo_staging() -> Staging:
    """A teflon sphere under an area light and one source, 19 photographs over 180 degrees, 1% noise.

    The sphere is a little off the gantry's centre, as spheres are. The source stands just behind the arc's
    beginning, so that its highlight is seen at exitant angles from 16 degrees in the first photographs to
    78 degrees in the last ones, where the Fresnel factor rises: without those, mu is hardly determined.
    """
    return read_staging(scene_path("demo"))


def write_demo(folder: Path, progress: Progress | None = None) -> None:
    """Photograph `demo_staging` into a folder, see `write_photoset`."""
    write_photoset(demo_staging(), folder, progress)
