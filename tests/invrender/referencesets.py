"""Photo sets with a card or a sphere of known reflectance beside the object, its light summed by direction."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from capture.files.imagefile import read_pixels, write_exr
from capture.lighting import Lighting, latlong_directions, latlong_solid_angles, seen_from
from capture.photo import Photo
from capture.photoset import load_photoset
from recon.lighting import read_lighting
from recon.sampling.find import find_body
from recon.sphere.sphere import Sphere

Floats = NDArray[np.float64]


def irradiance(lighting: Lighting, normals: Floats, positions: Floats) -> Floats:
    """What falls on points (n, 3) with normals (n, 3), (n, 3): a sum over the map's pixels and the lamps."""
    fallen = np.zeros((len(normals), 3))
    if len(lighting.directions):
        directions, factors = seen_from(lighting.sources, positions)
        towards = np.broadcast_to(directions, (len(normals), *directions.shape[-2:]))
        cos = np.clip(np.einsum("nc,nkc->nk", normals, towards), 0, None)
        fallen += (cos * factors) @ lighting.irradiances
    if lighting.radiance_map is not None:
        height = len(lighting.radiance_map)
        towards = latlong_directions(height).reshape(-1, 3)
        sent = (lighting.radiance_map * latlong_solid_angles(height)[..., None]).reshape(-1, 3)
        fallen += np.clip(normals @ towards.T, 0, None) @ sent
    return fallen


def add_card(
    folder: Path,
    number: int,
    centre: Sequence[float],
    normal: Sequence[float],
    size: tuple[float, float] = (0.012, 0.012),
    reflectance: float = 0.4,
    noise: float = 0.01,
    given: str = "",
) -> Path:
    """Put a card into a photograph, and its table into the manifest, where `given` says how it faces: `normal` if "".

    The light must still be given by the manifest.
    """
    photo, lighting = _photo(folder, number)
    facing = np.asarray(normal, float) / np.linalg.norm(normal)
    across = np.cross(facing, np.eye(3)[np.abs(facing).argmin()])
    across /= np.linalg.norm(across)
    up = np.cross(facing, across)
    corners = np.array(
        [
            np.asarray(centre) + a * size[0] * across + b * size[1] * up
            for a, b in ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))
        ]
    )
    at = photo.camera.project(corners)
    mask = np.zeros((photo.camera.height, photo.camera.width), np.uint8)
    cv2.fillPoly(mask, [np.round(at - 0.5).astype(np.int32)], 1)
    fallen = irradiance(lighting, facing[None], np.asarray(centre, float)[None])
    _paint(photo, mask > 0, reflectance / np.pi * fallen, noise)
    faces = given or f"normal = {[round(x, 6) for x in facing.tolist()]}\nnormal_std_deg = 0.5"
    region = [[round(x, 3) for x in corner] for corner in at.tolist()]
    return _add_table(folder, photo, f"region = {region}\n{faces}", reflectance)


def add_sphere(
    folder: Path,
    number: int,
    centre: Sequence[float],
    radius: float,
    reflectance: float = 0.4,
    noise: float = 0.01,
) -> Path:
    """Put a matte sphere into a photograph, and its table into the manifest."""
    photo, lighting = _photo(folder, number)
    rows, columns = np.indices((photo.camera.height, photo.camera.width)).reshape(2, -1)
    sphere = Sphere(np.asarray(centre, float), radius, np.zeros((4, 4)))
    hit, normals = sphere.hits(*photo.camera.rays(np.column_stack([columns, rows]) + 0.5))
    fallen = irradiance(lighting, normals[hit], sphere.centre + radius * normals[hit])
    mask = hit.reshape(photo.camera.height, photo.camera.width)
    _paint(photo, mask, reflectance / np.pi * fallen, noise)
    return _add_table(folder, photo, f"centre = {list(centre)}\nradius = {radius}", reflectance)


def forget_light(folder: Path) -> Path:
    """Leave all lightings of a set unknown, as lamps in the dark if they are lamps."""
    path = folder / "photoset.toml"
    text = re.sub(r"directional = .*", "unknown = true\ndark = true", path.read_text())
    path.write_text(re.sub(r"(?m)^map = .*", "unknown = true", text))
    return folder


def forget_strength(folder: Path) -> Path:
    """Leave the strengths of a set's lamps to be recovered."""
    path = folder / "photoset.toml"
    path.write_text(re.sub(r"(directional = .*)", r'\1\nrecover = ["irradiance"]', path.read_text()))
    return folder


def _photo(folder: Path, number: int) -> tuple[Photo, Lighting]:
    photoset = load_photoset(folder)
    photo = photoset.photos[number]
    table = next(table for table in photoset.lightings if table.name == photo.lighting)
    return photo, read_lighting(photoset, table, find_body(photoset).body)


def _paint(photo: Photo, mask: NDArray[np.bool_], radiance: Floats, noise: float) -> None:
    pixels = read_pixels(photo.file).astype(float)
    shown = np.broadcast_to(radiance, (np.count_nonzero(mask), 3))
    pixels[mask] = shown * (1 + noise * np.random.default_rng(7).standard_normal(shown.shape))
    write_exr(photo.file, pixels.astype(np.float32))


def _add_table(folder: Path, photo: Photo, place: str, reflectance: float) -> Path:
    path = folder / "photoset.toml"
    table = f'\n[[reference]]\nphoto = "{photo.name}"\n{place}\nreflectance = {reflectance}\nreflectance_std = 0.01\n'
    path.write_text(path.read_text() + table)
    return folder
