"""Scenes for tests of live pictures: a sphere and a mesh under a room and lamps."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from capture.files.imagefile import write_exr
from capture.lighting import Lighting
from invrender.output.render.light import chosen_lighting, distant_source
from invrender.output.render.photographer import Photographer, photographer
from invrender.result.saved import read_result
from recon.mesh.trianglemesh import TriangleMesh, write_mesh
from synthetic.lights.arealight import AreaLight
from synthetic.lights.illumination import latlong_map

from .renders import write_result

# Not symmetric about anything, so that a wrong axis or sense of turning shows.
LAMP = (60.0, 35.0, (0.9, 0.8, 0.6))


def room(height: int = 64) -> np.ndarray:
    """A dim room with two windows of different colours and sizes, (H, 2H, 3)."""
    windows = [
        AreaLight(np.array([0.5, -0.4, 0.77]), np.array([2.0, 2.5, 3.2]), width_rad=0.5),
        AreaLight(np.array([-0.7, 0.6, 0.3]), np.array([3.0, 2.0, 1.2]), width_rad=0.25),
    ]
    return latlong_map(windows, height) + np.float32(0.05)


def gloss(folder: Path, model: str = "half-angle microfacet", mu: float = 1.5, sigma: float = 0.15) -> Path:
    """A result's folder: a glossy sphere of 20 mm in the room."""
    write_result(folder, model, mu, sigma, interreflection={"taken_off": False})
    write_exr(folder / "lighting.exr", room())
    return folder


def studio_of(folder: Path, mesh: TriangleMesh | None = None) -> tuple[Photographer, Lighting]:
    """Takes pictures of a result, or of its material on a mesh, in its room with a lamp more."""
    result = read_result(folder)
    file = None
    if mesh is not None:
        file = folder / "mesh.obj"
        write_mesh(file, mesh)
    lighting = chosen_lighting(result, None, folder / "lighting.exr", [distant_source(*LAMP)], False)
    return photographer(result, lighting, mesh=file), lighting
