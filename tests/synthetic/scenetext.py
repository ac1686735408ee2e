"""The text of a small scene file, to be varied, and a small mesh."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from recon.mesh.trianglemesh import TriangleMesh
from synthetic.scenes.build import read_staging
from synthetic.staging import Staging

OBJECT = '[object]\nshape = "sphere"\n'
MATERIAL = '[material]\nmodel = "lambertian"\nkd = 0.2\n'
LIGHT = "directional = [{ azimuth_deg = -20, elevation_deg = 25, irradiance = 1.0 }]\n"
LIGHTING = f'[[lighting]]\nname = "lab"\n{LIGHT}'
CAMERA = "[camera]\nwidth = 24\nheight = 20\nfocal_px = 220\n"
GANTRY = "[gantry]\nphotos = 2\n"
HEAD = 'format = 1\nname = "tiny"\n'
WHOLE = HEAD + OBJECT + MATERIAL + LIGHTING + CAMERA + GANTRY


def read(folder: Path, text: str) -> Staging:
    path = folder / "tiny.toml"
    path.write_text(text, encoding="utf-8")
    return read_staging(path)


def tetrahedron() -> TriangleMesh:
    corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], float)
    return TriangleMesh(corners, np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]]), corners / np.sqrt(3))
