"""Kd and Ks of a result that vary over the surface: maps over texture coordinates, or values at a mesh's vertices."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from capture.files.imagefile import read_exr_layers, read_pixels
from invrender.result.saved import SavedResult

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
# Height and width of a map to rows, columns and weights (m, k) of the k texels around each of m points.
_Places = Callable[[int, int], tuple[Ints, Ints, Floats]]

KD_NAME, KS_NAME = "texture_kd.exr", "texture_ks.exr"
# Weight of known texels below which a point isn't known.
_LEAST_KNOWN = 1e-6


@dataclass(frozen=True, eq=False)
class RayReflectance:
    """What rays see of Kd and Ks, (m, 3) each, with their standard deviations; zero where not known.

    known : (m,) bool.
    """

    kd: Floats
    ks: Floats
    kd_std: Floats
    ks_std: Floats
    known: NDArray[np.bool_]

    def where(self, kept: NDArray[np.bool_]) -> RayReflectance:
        """These, and zero of the others."""
        shares = kept[:, None]
        return RayReflectance(
            self.kd * shares, self.ks * shares, self.kd_std * shares, self.ks_std * shares, self.known & kept
        )


@dataclass(frozen=True, eq=False)
class SavedTextures:
    """Maps (h, w, 3) of Kd and Ks with their standard deviations; of one texel where nothing varies.

    The first row is at v = 1, the first column at u = 0; or there is one row, of the mesh's vertices in their order.
    known : (h, w), 1 where the photographs determine them; None for everywhere. at_vertices : as said.
    """

    kd: Floats
    ks: Floats
    kd_std: Floats
    ks_std: Floats
    known: Floats | None = None
    at_vertices: bool = False

    def at(self, uv: Floats) -> RayReflectance:
        """Kd and Ks at texture coordinates (m, 2), linear between the centres of known texels."""
        return self._blended(lambda height, width: texels_around(uv, height, width))

    def between(self, corners: Ints, weights: Floats) -> RayReflectance:
        """Kd and Ks between vertices, (m, 3) of them and their weights."""
        return self._blended(lambda height, width: (np.zeros_like(corners), corners, weights))

    def at_points(self, corners: Ints, weights: Floats) -> SavedTextures:
        """Values at points of the mesh whose vertices' values these are: each point's (m, 3) vertices and weights."""
        seen = self.between(corners, weights)
        known = None if self.known is None else (weights * self.known[0, corners]).sum(axis=1)[None]
        return SavedTextures(seen.kd[None], seen.ks[None], seen.kd_std[None], seen.ks_std[None], known, True)

    def onto_vertices(self, uv: Floats) -> SavedTextures:
        """Values at the texture coordinates (m, 2) of a mesh's vertices, which then need none."""
        seen = self.at(uv)
        known = None if self.known is None else seen.known.astype(float)[None]
        return SavedTextures(seen.kd[None], seen.ks[None], seen.kd_std[None], seen.ks_std[None], known, True)

    def _blended(self, places: _Places) -> RayReflectance:
        height, width = self.kd.shape[:2] if self.known is None else self.known.shape
        rows, columns, weights = places(height, width)
        known = np.ones(len(weights), bool)
        if self.known is not None:
            weights = weights * self.known[rows, columns]
            total = weights.sum(axis=1)
            known = total > _LEAST_KNOWN
            weights = np.where(known[:, None], weights / np.where(known, total, 1)[:, None], 0)

        def seen(texels: Floats) -> Floats:
            if texels.shape[:2] == (1, 1):
                return np.broadcast_to(texels[0, 0], (len(weights), 3)) * known[:, None]
            if texels.shape[:2] == (height, width):
                return np.einsum("mk,mkc->mc", weights, texels[rows, columns])
            own_rows, own_columns, own_weights = places(*texels.shape[:2])
            return np.einsum("mk,mkc->mc", own_weights, texels[own_rows, own_columns]) * known[:, None]

        return RayReflectance(seen(self.kd), seen(self.ks), seen(self.kd_std), seen(self.ks_std), known)


def read_textures(result: SavedResult, ks: Floats) -> SavedTextures | None:
    """The textures in a result's folder, None where it has none; ValueError where one that it names isn't there.

    ks : (3,), where only Kd varies.
    """
    folder, table = result.folder, result.content.texture
    # One Ks in place of a lost map, or no deviation in place of a lost one, would be made up.
    for name in () if table is None else table.files:
        if not (folder / name).is_file():
            raise ValueError(
                f"{folder / name}: is missing; {result.path} names it. Copy the whole folder that `lightfactor process`"
                " wrote, or run it again"
            )
    if not (folder / KD_NAME).is_file():
        return None
    kd_map = _read(folder / KD_NAME)
    ks_map = _read(folder / KS_NAME) if (folder / KS_NAME).is_file() else np.full((1, 1, 3), ks)
    known = read_exr_layers(folder / KD_NAME).get("A")
    return SavedTextures(
        kd_map,
        ks_map,
        _deviations(folder, KD_NAME),
        _deviations(folder, KS_NAME),
        None if known is None else known.astype(float),
        table is not None and table.at == "vertices",
    )


def filled(texels: Floats, known: Floats | None) -> Floats:
    """A map (h, w, 3) with the nearest known texel's values where `known` (h, w) is zero; as it is where none is."""
    if known is None or not known.any() or texels.shape[:2] != known.shape:
        return texels
    rows, columns = distance_transform_edt(known <= 0, return_distances=False, return_indices=True)
    return np.asarray(texels[rows, columns])


def _deviations(folder: Path, name: str) -> Floats:
    path = folder / name.replace(".exr", "_std.exr")
    return _read(path) if path.is_file() else np.zeros((1, 1, 3))


def _read(path: Path) -> Floats:
    texels = read_pixels(path).astype(float)
    if not (texels >= 0).all():
        row, column = np.argwhere(~(texels >= 0).all(axis=2))[0]
        raise ValueError(
            f"{path}: is {texels[row, column].tolist()} at row {row}, column {column}; it must be three numbers >= 0"
        )
    return texels


def texels_around(uv: Floats, height: int, width: int) -> tuple[Ints, Ints, Floats]:
    """Rows, columns and weights (m, 4) of the texels around texture coordinates; u goes around, v ends at the edges."""
    x, y = uv[:, 0] * width - 0.5, np.clip((1 - uv[:, 1]) * height - 0.5, 0, height - 1)
    left, top = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    across, down = x - left, y - top
    right, below = (left + 1) % width, np.minimum(top + 1, height - 1)
    left = left % width
    return (
        np.stack([top, top, below, below], axis=-1),
        np.stack([left, right, left, right], axis=-1),
        np.stack(
            [(1 - down) * (1 - across), (1 - down) * across, down * (1 - across), down * across], axis=-1
        ),
    )
