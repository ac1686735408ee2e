"""Small photo sets with one thing wrong each, whose name a diagnosis should find."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from capture.files.imagefile import read_pixels, write_exr
from capture.photoset import load_photoset
from synthetic.scenes.build import read_staging
from synthetic.writer import write_photoset

Floats = NDArray[np.float64]

SIZE = 68
RADIUS = 0.02
# Azimuth and elevation, degrees, of a lamp per photograph; the camera stands at azimuth 0.
LAMPS = ((0, 10), (40, 20), (-40, 25), (70, -5), (-65, 0), (20, 60), (-20, -45), (55, 40))
GLOSSY = 'model = "microfacet"\nkd = [0.2, 0.16, 0.12]\nks = 0.04\nmu = 1.6\nsigma = 0.12'
MATTE = 'model = "lambertian"\nkd = [0.2, 0.16, 0.12]'
BRUSHED = 'model = "anisotropic"\nkd = [0.05, 0.04, 0.03]\nks = 0.08\nmu = 1.6\nalpha_x = 0.1\nalpha_y = 0.3'


def write_set(
    folder: Path,
    material: str = GLOSSY,
    distance: float | None = None,
    noise: float = 0.01,
    beside: int = 0,
) -> Path:
    """The photographs of a scene of `write_scene`. What was rendered once is copied."""
    original = Path(_rendered_set(material, distance, noise, beside).name)
    shutil.copytree(original, folder, copy_function=shutil.copyfile, dirs_exist_ok=True)
    return folder


@cache
def _rendered_set(
    material: str, distance: float | None, noise: float, beside: int
) -> TemporaryDirectory[str]:
    """A set of `write_set` in a folder that is there until the tests end."""
    folder = TemporaryDirectory(prefix="lightfactor-faulty-")
    path = write_scene(Path(folder.name), material, distance, noise, beside)
    write_photoset(read_staging(path), path.parent)
    return folder


def write_scene(
    folder: Path,
    material: str = GLOSSY,
    distance: float | None = None,
    noise: float = 0.01,
    beside: int = 0,
) -> Path:
    """A scene of a sphere under one lamp per photograph, given as distant; distance : metres, None for far away.

    beside : pixels more in width, half of them on either side.
    """
    parts = [
        f'format = 1\nname = "faulty"\n[object]\nshape = "sphere"\nradius = {RADIUS}\nstated = true',
        f"[material]\n{material}",
        f"[camera]\nwidth = {SIZE + beside}\nheight = {SIZE}\nfocal_px = {0.45 * SIZE * 0.6 / RADIUS}",
        f"[sensor]\nnoise = {noise}",
    ]
    for k, (azimuth, elevation) in enumerate(LAMPS):
        towards = f"azimuth_deg = {azimuth}, elevation_deg = {elevation}, irradiance = {1.5 + 0.2 * (k % 3)}"
        lamp = (
            f"directional = [{{ {towards} }}]"
            if distance is None
            else f'given = "distant"\nlamp = [{{ {towards}, distance = {distance} }}]'
        )
        parts.append(f'[[lighting]]\nname = "lamp {k}"\n{lamp}')
    parts += [f'[[view]]\nazimuth_deg = 0\nlighting = "lamp {k}"' for k in range(len(LAMPS))]
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "staged.toml"
    path.write_text("\n".join(parts), encoding="utf-8")
    return path


def change_pixels(folder: Path, change: Callable[[int, Floats], Floats]) -> Path:
    """Replace photographs (h, w, 3) by what `change` of their number and pixels returns."""
    for k in range(len(LAMPS)):
        path = folder / f"{k:03d}.exr"
        write_exr(path, change(k, read_pixels(path).astype(float)).astype(np.float32))
    return folder


def change_manifest(folder: Path, pattern: str, replacement: Callable[[re.Match[str]], str]) -> Path:
    path = folder / "photoset.toml"
    text, count = re.subn(pattern, replacement, path.read_text())
    assert count
    path.write_text(text)
    return folder


def surface_normals(folder: Path) -> tuple[NDArray[np.bool_], Floats]:
    """Where the first photograph shows the sphere (h, w), and its normals there (n, 3)."""
    camera = load_photoset(folder).photos[0].camera
    rows, columns = np.mgrid[:SIZE, :SIZE] + 0.5
    focal = 0.45 * SIZE * 0.6 / RADIUS
    rays = np.stack([(columns - SIZE / 2) / focal, (rows - SIZE / 2) / focal, np.ones_like(rows)], axis=-1)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    along = 0.6 * rays[..., 2]
    inside = along**2 - 0.6**2 + RADIUS**2
    seen = inside > 0
    depth = along[seen] - np.sqrt(inside[seen])
    points = (rays[seen] * depth[:, None] - [0, 0, 0.6]) / RADIUS
    return seen, points @ camera.world_to_camera[:3, :3]
