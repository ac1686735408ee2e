"""Photo sets of one camera and many lamps: rendered spheres, whose normals are known, and the real ones."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from capture.photoset import load_photoset
from invrender.brdf.lobes import GGX_FORM
from invrender.photometric_stereo.photographs import StereoCapture
from recon.normals.normalmap import picture_axes
from synthetic.scenes.build import read_staging
from synthetic.writer import write_photoset

Floats = NDArray[np.float64]
RADIUS, SIZE = 0.02, 56
# Azimuth and elevation, degrees, about a camera at azimuth 0: three rings.
LAMPS = [
    (round(15 * ring * np.cos(turn), 3), round(15 * ring * np.sin(turn), 3))
    for ring, count in ((1, 5), (2, 8), (3, 11))
    for turn in 2 * np.pi * (np.arange(count) + 0.3 * ring) / count
]
GLOSSY = 'model = "ggx"\nkd = [0.2, 0.16, 0.12]\nks = 0.04\nmu = 1.5\nalpha = 0.15'


@contextmanager
def few_pixels_shared() -> Iterator[None]:
    """Fits look at half as many pixels where they compare lobes, and for what all pixels share."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("invrender.photometric_stereo.solve._COMPARED_PIXELS", 200)
        patch.setattr("invrender.photometric_stereo.solve._SHARED_PIXELS", 750)
        yield


@contextmanager
def few_lobes_compared() -> Iterator[None]:
    """The same; of lobes they compare GGX's alone with a Lambertian surface."""
    with few_pixels_shared(), pytest.MonkeyPatch.context() as patch:
        patch.setattr("invrender.photometric_stereo.models.FORMS", (None, GGX_FORM))
        yield


def write_rendered(
    folder: Path, material: str = GLOSSY, distance: float | None = None, noise: float = 0.01, every: int = 1
) -> Path:
    """A sphere before a camera that doesn't move, by brute force; distance : metres, of lamps nearby.

    Its normals are sought; `rendered_normals` has them. every : one lamp of so many.
    """
    parts = [
        f'format = 1\nname = "rendered"\n[object]\nshape = "sphere"\nradius = {RADIUS}\nstated = true',
        f"[material]\n{material}",
        f"[camera]\nwidth = {SIZE}\nheight = {SIZE}\nfocal_px = {0.45 * SIZE * 0.6 / RADIUS}",
        f"[sensor]\nnoise = {noise}",
    ]
    for k, (azimuth, elevation) in enumerate(LAMPS[::every]):
        lamp = f"azimuth_deg = {azimuth}, elevation_deg = {elevation}, irradiance = {1.5 + 0.2 * (k % 3)}"
        kind = "directional" if distance is None else "lamp"
        near = "" if distance is None else f", distance = {distance}"
        parts.append(f'[[lighting]]\nname = "lamp {k}"\n{kind} = [{{ {lamp}{near} }}]')
        parts.append(f'[[view]]\nazimuth_deg = 0\nlighting = "lamp {k}"')
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "staged.toml").write_text("\n".join(parts), encoding="utf-8")
    write_photoset(read_staging(folder / "staged.toml"), folder)
    as_normals(folder)
    return folder


def as_normals(folder: Path, normals: str = "unknown", centre: tuple[float, ...] = (0, 0, 0)) -> None:
    """Replace what a set's manifest says of the shape; centre : metres, of the plane about which the surface lies."""
    path = folder / "photoset.toml"
    where = f"centre = {[float(c) for c in centre]}"
    table = f'[object]\nshape = "normals"\nnormals = "{normals}"\n{where}\n\n'
    path.write_text(
        re.sub(r"(?s)\[object\].*?(?=\n\[)", table, path.read_text(encoding="utf-8")), encoding="utf-8"
    )


def rendered_normals(folder: Path) -> Floats:
    """The sphere's normals (h, w, 3) in the picture's axes, by where the camera's rays meet it; NaN outside."""
    camera = load_photoset(folder).photos[0].camera
    rows, columns = np.indices((camera.height, camera.width)).reshape(2, -1)
    origins, directions = camera.rays(np.column_stack([columns, rows]) + 0.5)
    along = np.einsum("pk,pk->p", origins, directions)
    inside = along**2 - (origins**2).sum(axis=1) + RADIUS**2
    points = origins + (-along - np.sqrt(np.maximum(inside, 0)))[:, None] * directions
    normals = np.where((inside > 0)[:, None], points / RADIUS @ picture_axes(camera).T, np.nan)
    return normals.reshape(camera.height, camera.width, 3)


def write_small(folder: Path) -> Path:
    """Few photographs of few pixels of a Lambertian sphere."""
    return write_rendered(folder, 'model = "lambertian"\nkd = 0.2', every=6)


def write_real(source: Path, folder: Path, every: int = 1, normals: str = "unknown") -> Path:
    """The manifest of a real set with lights.txt (DiLiGenT's): one lamp of so many."""
    lines = [line.split() for line in (source / "lights.txt").read_text().splitlines() if line[:1] != "#"]
    height, width = np.load(source / "normals.npz")["normals"].shape[:2]
    text = (
        f'format = 1\nname = "{source.name}"\n[camera]\nmodel = "ORTHOGRAPHIC"\nwidth = {width}\nheight = {height}\n'
        f'[object]\nshape = "normals"\nnormals = "{normals}"\n'
    )
    for name, *numbers in [line for line in lines if line][::every]:
        direction, irradiance = (json.dumps(list(map(float, part))) for part in (numbers[:3], numbers[3:]))
        text += (
            f'[[lighting]]\nname = "{name}"\n'
            f"directional = [{{ direction = {direction}, irradiance = {irradiance} }}]\n"
            f'[[photo]]\nfile = "{source / name}.png"\nmask = "{source}/mask.png"\nlighting = "{name}"\n'
            "world_to_camera = [[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 1000], [0, 0, 0, 1]]\n"
        )
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "photoset.toml").write_text(text, encoding="utf-8")
    return folder


def thinned(capture: StereoCapture, step: int) -> StereoCapture:
    """The same photographs with one pixel of so many in each row and column."""
    few = np.zeros_like(capture.inside)
    few[::step, ::step] = capture.inside[::step, ::step]
    kept = few[capture.inside]
    height, width = capture.inside[::step, ::step].shape
    camera = capture.camera
    smaller = replace(camera, params=camera.params / step, width=width, height=height)
    photos = tuple(replace(photo, camera=smaller) for photo in capture.photoset.photos)
    return replace(
        capture,
        photoset=replace(capture.photoset, photos=photos),
        inside=capture.inside[::step, ::step],
        radiance=capture.radiance[kept],
        variance=capture.variance[kept],
        usable=capture.usable[kept],
    )


def angles_to(normals: Floats, truth: Floats) -> Floats:
    """Angles between unit vectors (..., 3), degrees."""
    return np.degrees(2 * np.arcsin(np.clip(np.linalg.norm(normals - truth, axis=-1) / 2, 0, 1)))
