"""What `process` says of a sphere in known light: more than one fit, where photographs ask for it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.atlas.stage import SPHERE, Finding, Stage, known_findings
from capture.photoset import load_photoset
from invrender.process.pipeline import process
from synthetic.lights.illumination import Illumination
from synthetic.lights.sources import PointSource
from synthetic.scene import Scene, Shot
from synthetic.shapes.ball import Ball
from synthetic.staging import Staging
from synthetic.writer import write_photoset


def processed(stage: Stage, lamps: Sequence[PointSource], number: int) -> dict[str, Finding]:
    """Findings in a photo set that tells the sphere, the poses and all light, with lamps as if they were distant.

    lamps : instead of the stage's sources. number : of the draw of the noise.
    """
    light = Illumination("light", stage.areas, tuple(lamps), "distant")
    shots = tuple(Shot(camera, light) for camera in stage.cameras)
    scene = Scene("atlas", Ball(SPHERE.centre, SPHERE.radius), stage.material, shots, seed=number)
    with TemporaryDirectory() as folder:
        write_photoset(Staging(scene, stage.noise, stated=True), Path(folder) / "set")
        return known_findings(stage, process(load_photoset(Path(folder) / "set"), stage.samples).solution)
