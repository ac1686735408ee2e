"""Published materials that are none of the product's models, photographed by plain sums.

They are fits of the ABC lobe to the MERL set [Low et al. 2012]:

    rho = kD / pi + F(theta_d) G A / (1 + B (1 - cos theta_h))^C / (pi cos theta_i cos theta_o)

with Fresnel's equations for F, and the hiding of V-shaped grooves for G. A distribution of normals with such tails is
no Beckmann's, GGX's or Phong's, and grooves hide unlike Smith's facets.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from capture.files.imagefile import write_exr

Floats = NDArray[np.float64]

# Radius and side of pictures, pixels; points per pixel's side; noise, relative; elevation of the lowest lamp, degrees.
_RADIUS, _SIDE, _POINTS, _NOISE, _LOWEST = 48, 112, 10, 0.01, 15
_TOWARDS_VIEWER = np.array([0.0, 0.0, 1.0])


def spread_lamps(count: int, rng: np.random.Generator) -> Floats:
    """Directions (count, 3) to lamps spread evenly about the viewer, in random order."""
    k = np.arange(count)
    azimuth = np.pi * (3 - np.sqrt(5)) * k
    up = 1 - (k + 0.5) / count * (1 - np.sin(np.radians(_LOWEST)))
    out = np.sqrt(1 - up**2)
    return rng.permutation(np.stack([out * np.cos(azimuth), out * np.sin(azimuth), up], axis=1))


class AbcSphere:
    """A sphere of a published material, seen from far away; x right, y up, z to the camera, pixels its unit."""

    def __init__(self, source: Path, name: str) -> None:
        self._material = _published(source, name)
        places = ((np.arange(_SIDE * _POINTS) + 0.5) / _POINTS - _SIDE / 2) / _RADIUS
        x, y = np.meshgrid(places, -places)
        self._inside = x**2 + y**2 < 1
        self._normals = np.stack([x, y, np.sqrt(np.clip(1 - x**2 - y**2, 0, None))], axis=-1)[self._inside]

    def photograph(self, towards: Floats, rng: np.random.Generator) -> Floats:
        """A picture (h, w, 3) under a lamp of irradiance 1 in a direction, with noise."""
        fine = np.zeros((*self._inside.shape, 3))
        fine[self._inside] = self._radiance(towards)
        pixels = fine.reshape(_SIDE, _POINTS, _SIDE, _POINTS, 3).mean(axis=(1, 3))
        return np.asarray(pixels * (1 + _NOISE * rng.standard_normal(pixels.shape)))

    @property
    def mask(self) -> NDArray[np.bool_]:
        """Pixels (h, w) that the sphere covers by more than half."""
        return np.asarray(self._inside.reshape(_SIDE, _POINTS, _SIDE, _POINTS).mean(axis=(1, 3)) > 0.5)

    def _radiance(self, towards: Floats) -> Floats:
        material, half = self._material, towards + _TOWARDS_VIEWER
        half = half / np.linalg.norm(half)
        cos_i, cos_o, cos_h = (self._normals @ of for of in (towards, _TOWARDS_VIEWER, half))
        cos_d = float(half @ _TOWARDS_VIEWER)
        lit, cos_i, cos_o = (cos_i > 0)[:, None], np.maximum(cos_i, 0), np.maximum(cos_o, 1e-6)
        g = np.sqrt(material["ior"] ** 2 - 1 + cos_d**2)
        fresnel = (
            0.5
            * ((g - cos_d) / (g + cos_d)) ** 2
            * (1 + ((cos_d * (g + cos_d) - 1) / (cos_d * (g - cos_d) + 1)) ** 2)
        )
        seen = np.minimum(1, 2 * cos_h * np.minimum(cos_i, cos_o) / cos_d)
        lobe = np.array(material["A"]) / (1 + material["B"] * (1 - cos_h[:, None])) ** material["C"]
        matte = np.array(material["kD"]) * cos_i[:, None]
        return np.asarray(np.where(lit, (matte + (fresnel * seen / cos_o)[:, None] * lobe) / np.pi, 0))


def _published(source: Path, name: str) -> dict[str, Any]:
    fits: dict[str, dict[str, Any]] = json.loads((source / "merl_abc_low2012.json").read_text())
    return fits[name]


def published_kd(source: Path, name: str) -> Floats:
    """Kd (3,), 1/sr, of a material as published."""
    return np.array(_published(source, name)["kD"]) / np.pi


def write_spheres(source: Path, name: str, folder: Path, lamps: int, parts: int) -> Sequence[Path]:
    """Photo sets of disjoint photographs of one material, a given lamp to each; their folders."""
    rng = np.random.default_rng(1)
    sphere, directions = AbcSphere(source, name), spread_lamps(lamps, rng)
    folders = []
    for part in range(parts):
        own = folder / f"{name} {part}"
        own.mkdir(parents=True)
        cv2.imwrite(str(own / "mask.png"), sphere.mask.astype(np.uint8) * 255)
        lines = [
            f'format = 1\nname = "{name}"\n[camera]\nmodel = "ORTHOGRAPHIC"\nwidth = {_SIDE}\nheight = {_SIDE}',
            f'[radiometry]\nencoding = "linear"\n[object]\nshape = "sphere"\ncentre = [0, 0, 0]\nradius = {_RADIUS}',
        ]
        for k in range(part, lamps, parts):
            write_exr(own / f"{k}.exr", sphere.photograph(directions[k], rng).astype(np.float32))
            towards = json.dumps(directions[k].tolist())
            lines += [
                f'[[lighting]]\nname = "{k}"\ndirectional = [{{ direction = {towards}, irradiance = [1, 1, 1] }}]',
                f'[[photo]]\nfile = "{k}.exr"\nmask = "mask.png"\nlighting = "{k}"',
                "world_to_camera = [[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 1000], [0, 0, 0, 1]]",
            ]
        (own / "photoset.toml").write_text("\n".join(lines), encoding="utf-8")
        folders.append(own)
    return folders
