"""What is staged for a photo set: a scene, the camera that it is taken with, and what goes wrong."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from capture.manifest import UncertaintyTable
from recon.mesh.trianglemesh import TriangleMesh
from synthetic.lights.sources import PointSource
from synthetic.scene import Scene
from synthetic.scenes.schema import BallTable, CalibrationTable, FaultsTable
from synthetic.sensing.development import Development
from synthetic.sensing.noise import Noise

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Staging:
    """What a photo set is made of.

    sensor : the ideal one, which writes linear EXR, or a camera. mesh : the object, which the set then holds, in its
    own frame, mesh_to_world : (4, 4) where it stands; None for spheres. stated : a sphere's centre and
    radius are handed over too, not left to be found from the masks. faults : what goes wrong unnoticed. uncertainty :
    how far off what is handed over may be, which the set states. source : the text of the scene file, "" for scenes
    made in memory.
    """

    scene: Scene
    sensor: Noise | Development = field(default_factory=Noise)
    mesh: TriangleMesh | None = None
    mesh_to_world: Floats = field(default_factory=lambda: np.eye(4))
    stated: bool = False
    faults: FaultsTable = field(default_factory=FaultsTable)
    uncertainty: UncertaintyTable = field(default_factory=UncertaintyTable)
    ball: BallTable | None = None
    calibration: CalibrationTable | None = None
    source: str = ""

    def __post_init__(self) -> None:
        single = self.ball is not None and len(self.ball.azimuths_deg) < 2
        for light in self.scene.illuminations if single else ():
            if any(isinstance(source, PointSource) for source in light.sources):
                raise ValueError(
                    f"lighting {light.name!r}: a mirror ball can't show from one place how far a lamp is: photograph"
                    " it from two (azimuths_deg), or give the lamp as directional"
                )
