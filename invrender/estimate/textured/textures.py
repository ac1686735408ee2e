"""Kd and Ks over a surface: values, how well they are known, what lies between them, and their files."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from capture.camera import Camera
from capture.files.imagefile import write_exr
from invrender.estimate.textured.layout import Layout, TexelLayout
from invrender.estimate.textured.texel_equations import PointValues, determined
from recon.mesh.bodies import MeshBody
from recon.mesh.shape import placed
from recon.mesh.trianglemesh import write_mesh
from recon.sampling.draw import ray_squares
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Mask = NDArray[np.bool_]

KD_NAME, KS_NAME = "texture_kd.exr", "texture_ks.exr"
KD_STD_NAME, KS_STD_NAME = "texture_kd_std.exr", "texture_ks_std.exr"
# The mesh with the texture coordinates that were made for it, where its own can't be used.
MESH_NAME = "textured.obj"
TEXTURE_FILES = (KD_NAME, KS_NAME, KD_STD_NAME, KS_STD_NAME, MESH_NAME)

# Texels around the charts that repeat what is next to them, so that interpolation across a border finds no black.
_MARGIN = 2.0


@dataclass(frozen=True, eq=False)
class FittedTextures:
    """What the photographs say of n points of a surface.

    kd, ks, kd_std, ks_std : (n, 3); zero where not known. known : (n,), whether they determine the point's values.
    ks_varies : False where Ks is one number per channel for the whole surface.
    """

    layout: Layout
    kd: Floats
    ks: Floats
    kd_std: Floats
    ks_std: Floats
    known: Mask
    ks_varies: bool

    @classmethod
    def of(cls, layout: Layout, values: PointValues, ks_varies: bool) -> FittedTextures:
        """The textures of what was solved for; what the photographs leave open isn't given."""
        every = np.ones(len(values.kd), bool)
        textures = cls(layout, values.kd, values.ks, values.kd_std, values.ks_std, every, ks_varies)
        return textures.only(determined(values))

    def less_sure(self, shares: Floats) -> FittedTextures:
        """The same with Kd and Ks uncertain by shares (n, 6) of themselves, besides."""
        of_kd, of_ks = np.split(shares, 2, axis=1)
        return replace(
            self,
            kd_std=np.hypot(self.kd_std, of_kd * self.kd),
            ks_std=np.hypot(self.ks_std, of_ks * self.ks),
        )

    def only(self, sure: Mask) -> FittedTextures:
        """The same with those points only that are marked (n,)."""
        known = self.known & sure
        kd, ks, kd_std, ks_std = (
            np.where(known[:, None], of, 0.0) for of in (self.kd, self.ks, self.kd_std, self.ks_std)
        )
        return FittedTextures(self.layout, kd, ks, kd_std, ks_std, known, self.ks_varies)

    @cached_property
    def share_known(self) -> float:
        """The share of the surface that is known: texels of a map stand for more of it here than there."""
        areas = self.layout.areas
        return float(areas[self.known].sum() / areas.sum())

    def mean(self, values: Floats) -> Floats:
        """The mean (k,) of values (n, k) over the surface that is known."""
        return np.asarray(np.average(values[self.known], axis=0, weights=self.layout.areas[self.known]))

    def mean_std(self, deviations: Floats) -> Floats:
        """The standard deviation (3,) of a mean over the surface from the points' own (n, 3), as if independent."""
        areas = self.layout.areas[self.known, None]
        return np.asarray(np.sqrt(((areas * deviations[self.known]) ** 2).sum(axis=0)) / areas.sum())

    def at(self, field: LightField) -> tuple[Floats, Floats]:
        """Kd and Ks (m, 3) at each ray of a field, NaN where none of the points around it is known."""
        assert field.faces is not None
        assert field.corner_weights is not None
        return self._at(field.faces, field.corner_weights)

    def around(self, body: MeshBody, camera: Camera, field: LightField, side: int) -> tuple[Floats, Floats]:
        """Kd and Ks (m, 3), for each ray of a field their means over its part of the pixel; NaN where one isn't known.

        side : at least so many places are looked at across a pixel.
        """
        corners, widths = ray_squares(field)
        kd, ks = np.empty((2, len(widths), 3))
        for width in np.unique(widths):
            mine = widths == width
            steps = width * (np.arange(np.ceil(side * width)) + 0.5) / np.ceil(side * width)
            places = corners[mine, None] + np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
            hits = body.hits(camera, places.reshape(-1, 2))
            assert hits.faces is not None
            assert hits.weights is not None
            for means, values in zip((kd, ks), self._at(hits.faces, hits.weights), strict=True):
                known = np.where(hits.hit[:, None], values, np.nan)
                means[mine] = known.reshape(*places.shape[:2], 3).mean(axis=1)
        return kd, ks

    def _at(self, faces: Ints, corner_weights: Floats) -> tuple[Floats, Floats]:
        """Kd and Ks (m, 3) at places in faces, NaN where none of the points around it is known."""
        places, weights = self.layout.places(faces, corner_weights)
        weights = weights * np.where(places >= 0, self.known[places], 0.0)
        total = weights.sum(axis=1)
        with np.errstate(invalid="ignore"):
            weights = np.where(total[:, None] > 1e-6, weights / total[:, None], np.nan)
        kd, ks = (np.einsum("mk,mkc->mc", weights, values[places]) for values in (self.kd, self.ks))
        return kd, ks

    def write(self, folder: Path, mesh_to_world: Floats) -> None:
        """Write the maps: R, G, B and, 1 where it is known, A; and the mesh in its own frame, in metres, where its
        texture coordinates were made."""
        alpha = self.layout.image(self.known.astype(float))
        images = {KD_NAME: self.kd, KD_STD_NAME: self.kd_std}
        if self.ks_varies:
            images |= {KS_NAME: self.ks, KS_STD_NAME: self.ks_std}
        for name, values in images.items():
            write_exr(folder / name, self._margined(self.layout.image(values)), layers={"A": alpha})
        if self.layout.made is not None:
            world_to_mesh = np.asarray(np.linalg.inv(mesh_to_world), float)
            write_mesh(folder / MESH_NAME, placed(self.layout.made, world_to_mesh))

    def _margined(self, picture: NDArray[np.float32]) -> NDArray[np.float32]:
        """The picture, repeated for two texels beyond the surface."""
        if not isinstance(self.layout, TexelLayout) or not self.known.any():
            return picture
        surface = self.layout.image(np.ones(len(self.known))) > 0
        known = self.layout.image(self.known.astype(float)) > 0
        distance, (row, column) = distance_transform_edt(~known, return_indices=True)
        near = ~surface & (distance <= _MARGIN)
        result = picture.copy()
        result[near] = picture[row[near], column[near]]
        return result
