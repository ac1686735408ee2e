"""What benchmarks against compiled integration over angles share: the light, the pixels of its map, the compiler."""

from __future__ import annotations

import ctypes
import subprocess
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from capture.lighting import latlong_directions, latlong_solid_angles
from synthetic.lights.arealight import AreaLight
from synthetic.lights.illumination import latlong_map

Singles = NDArray[np.float32]

# Rows of the map, and the share of a lobe's integral that integration leaves out.
HEIGHT, LEFT_OUT = 128, 0.05
_LIGHTS = (
    AreaLight(np.array([-0.26, 0.72, 0.64]), np.array([1.5, 1.6, 1.8]), width_rad=0.7),
    AreaLight(np.array([0.7, -0.1, -0.7]), np.array([0.9, 0.5, 0.3]), width_rad=1.0),
)


def light_map() -> Singles:
    """Two area lights in a grey room, (HEIGHT, 2 HEIGHT, 3)."""
    return np.asarray(latlong_map(_LIGHTS, HEIGHT).astype(np.float32) + np.float32(0.1))


def map_pixels() -> tuple[Singles, Singles]:
    """Directions (HEIGHT, 2 HEIGHT, 3) and solid angles (HEIGHT, 2 HEIGHT) of the map's pixels, as C reads them."""
    directions = np.ascontiguousarray(latlong_directions(HEIGHT), np.float32)
    solid = np.broadcast_to(latlong_solid_angles(HEIGHT), directions.shape[:2])
    return directions, np.ascontiguousarray(solid, np.float32)


def compiled(compiler: str, folder: Path, source: str) -> ctypes.CDLL:
    """A C source as a library, in a folder of its own that must stay meanwhile."""
    path, library = folder / "angles.c", folder / "angles.so"
    path.write_text(source, encoding="utf-8")
    subprocess.run([compiler, "-O3", "-shared", "-fPIC", str(path), "-o", str(library), "-lm"], check=True)
    return ctypes.CDLL(str(library))
