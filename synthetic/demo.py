"""The demonstration: a teflon sphere on a gantry, after RH01's set-up (section 6, "Data Acquisition")."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from capture.arc.gantry import Arc
from capture.camera import Camera
from synthetic.lights.arealight import AreaLight
from synthetic.lights.sources import DirectionalSource
from synthetic.materials.rh01 import RH01_MATERIALS, radiometric
from synthetic.spheres import SphereScene
from synthetic.writer import Progress, write_photoset

_ARC_RADIUS = 0.60
_PHOTOS = 19
# Degrees on the arc, from +X towards +Y.
_FIRST_DEG, _LAST_DEG = 0.0, 180.0
_HELD_OUT = 9


def demo_scene() -> SphereScene:
    """A teflon sphere under an area light and one source, 19 photographs over 180 degrees, 1% noise.

    The sphere is a little off the gantry's centre, as spheres are. The source stands just behind the arc's
    beginning, so that its highlight is seen at exitant angles from 16 degrees in the first photographs to
    78 degrees in the last ones, where the Fresnel factor rises: without those, mu is hardly determined.
    """
    angles = np.radians(np.linspace(_FIRST_DEG, _LAST_DEG, _PHOTOS))
    arc = Arc(np.zeros(3), np.array([0, 0, 1.0]), _ARC_RADIUS, np.array([1.0, 0, 0]))
    poses = [arc.pose(angle) for angle in angles]
    # At 0.6 m a sphere of 20 mm appears 45 px in radius.
    params = np.array([1350.0, 1350.0, 80.0, 60.0, 0.0, 0.0, 0.0, 0.0])
    return SphereScene(
        name="teflon sphere",
        material=radiometric(RH01_MATERIALS["teflon"]),
        area_lights=(AreaLight(_direction(110, 40), np.array([1.5, 1.6, 1.8]), width_rad=0.35),),
        sources=(DirectionalSource(_direction(-20, 25), np.array([1.6, 1.5, 1.35])),),
        centre=np.array([0.0015, -0.001, 0.002]),
        radius=0.02,
        cameras=tuple(Camera("OPENCV", params, 160, 120, pose) for pose in poses),
        held_out=(_HELD_OUT,),
    )


def write_demo(folder: Path, progress: Progress | None = None) -> None:
    """Photograph `demo_scene` into a folder, see `write_photoset`."""
    write_photoset(demo_scene(), folder, progress)


def _direction(azimuth_deg: float, elevation_deg: float) -> np.ndarray:
    azimuth, elevation = np.radians([azimuth_deg, elevation_deg])
    level = np.cos(elevation)
    return np.array([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])
