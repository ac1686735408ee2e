"""Reflectance that varies over a surface."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from capture.arrays import frozen_array
from synthetic.materials.material import AnyFloats, Floats, Material


@dataclass(frozen=True, eq=False)
class Textured(Material):
    """A material whose weights come from maps over texture coordinates u, v; its lobe is the same everywhere.

    material : whose lobe it has; its own kd and ks don't count.
    kd_map, ks_map : (h, w, 3) RGB, linear, >= 0, in the units of kd and ks; the first row is at v = 1, the first column
        at u = 0. The maps may differ in size.
    kd and ks are their means.
    """

    kd: Floats = field(init=False)
    ks: Floats = field(init=False)
    material: Material
    kd_map: Floats
    ks_map: Floats

    def __post_init__(self) -> None:
        for name in ("kd_map", "ks_map"):
            values = np.asarray(getattr(self, name), float)
            if values.ndim != 3 or values.shape[2] != 3 or values.size == 0:
                raise ValueError(f"{name} has the shape {values.shape}; it must be (h, w, 3)")
            wrong = ~(np.isfinite(values) & (values >= 0)).all(axis=2)
            if wrong.any():
                row, column = np.argwhere(wrong)[0]
                raise ValueError(
                    f"{name} is {values[row, column].tolist()} at row {row}, column {column};"
                    " it must be three finite numbers >= 0"
                )
            object.__setattr__(self, name, frozen_array(values))
        object.__setattr__(self, "kd", self.kd_map.mean(axis=(0, 1)))
        object.__setattr__(self, "ks", self.ks_map.mean(axis=(0, 1)))
        super().__post_init__()

    @property
    def is_mirror(self) -> bool:
        return self.material.is_mirror

    @property
    def is_isotropic(self) -> bool:
        return self.material.is_isotropic

    def mirrored(self, wo: AnyFloats) -> AnyFloats:
        return self.material.mirrored(wo)

    def weights(self, uv: AnyFloats) -> tuple[Floats, Floats]:
        """kd and ks, (n, 3) each, at texture coordinates (n, 2): bilinear between the centres of texels."""
        return _bilinear(self.kd_map, uv), _bilinear(self.ks_map, uv)

    def lobe(self, wi: AnyFloats, wo: AnyFloats) -> AnyFloats:
        return self.material.lobe(wi, wo)

    def sample(self, wo: AnyFloats, u: AnyFloats) -> AnyFloats:
        return self.material.sample(wo, u)

    def density(self, wi: AnyFloats, wo: AnyFloats) -> AnyFloats:
        return self.material.density(wi, wo)


def _bilinear(texels: Floats, uv: AnyFloats) -> Floats:
    """Values (n, 3) of texels (h, w, 3): u wraps around, v stops at the edges."""
    height, width, _ = texels.shape
    x = uv[:, 0] * width - 0.5
    y = np.clip((1 - uv[:, 1]) * height - 0.5, 0, height - 1)
    left, top = np.floor(x), np.floor(y)
    right_share, lower_share = (x - left)[:, None], (y - top)[:, None]
    left_column = left.astype(int) % width
    right_column = (left_column + 1) % width
    row = top.astype(int)
    next_row = np.minimum(row + 1, height - 1)
    upper = texels[row, left_column] * (1 - right_share) + texels[row, right_column] * right_share
    lower = texels[next_row, left_column] * (1 - right_share) + texels[next_row, right_column] * right_share
    return np.asarray(upper * (1 - lower_share) + lower * lower_share)
