"""Kd and Ks that vary over a surface, in a target's numbers: those of the means, scaled texel by texel.

The lobe is proportional to Ks. The base is Kd, times what makes up for what the lobe takes of it, plus what the mapping
of the means adds to it for the sake of the lobe's tails, in proportion to Ks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.microfacet import Microfacet
from invrender.output.export.mapping import Mapping
from invrender.result.saved_textures import SavedTextures, filled

Floats = NDArray[np.float64]

_STRONG_PERCENTILE = 95.0


@dataclass(frozen=True, eq=False)
class Texels:
    """Maps (h, w, 3), the first row at v = 1. kd, ks : our own. strength : Ks over its mean."""

    kd: Floats
    ks: Floats
    strength: Floats

    @property
    def brightest(self) -> Floats:
        """The strongest channel of each texel's lobe, (h, w)."""
        return np.asarray(self.strength.max(axis=2))


def strongest(texels: Texels) -> float:
    """How many times as strong as the mean the lobe becomes, a twentieth of the texels aside: noise is among them."""
    return max(float(np.percentile(texels.brightest, _STRONG_PERCENTILE)), 1.0)


def texels_of(textures: SavedTextures, ks: Floats) -> Texels:
    """Textures on one grid, those of the nearest known texel where nothing is known.

    Other programs blend neighbours, so that black ones would darken what is known beside them, too. ks : (3,), the mean
    that `Mapping` is of; ValueError if the maps' sizes differ.
    """
    kd_map, ks_map = (filled(texels, textures.known) for texels in (textures.kd, textures.ks))
    if ks_map.shape[:2] == (1, 1):
        ks_map = np.broadcast_to(ks_map, kd_map.shape)
    if kd_map.shape != ks_map.shape:
        raise ValueError(
            f"the textures of Kd and Ks have {_size(kd_map)} and {_size(ks_map)} texels; they must have as many"
        )
    strength = np.where(ks > 0, ks_map / np.where(ks > 0, ks, 1), 0.0)
    return Texels(kd_map, ks_map, strength)


def base_texels(texels: Texels, mapping: Mapping, brdf: Microfacet, strength: Floats | float) -> Floats:
    """Albedo (h, w, 3) below the lobe. strength : (h, w) or one for all, what the lobe that darkens it is scaled by."""
    has_lobe = brdf.ks > 0
    rest = mapping.numbers.base - mapping.base_gain * np.pi * brdf.kd
    per_ks = np.where(has_lobe, rest / np.where(has_lobe, brdf.ks, 1), 0.0)
    gain = 1 + (mapping.base_gain - 1) * np.asarray(strength)[..., None]
    return np.asarray(np.maximum(gain * np.pi * texels.kd + per_ks * texels.ks, 0))


def _size(values: Floats) -> str:
    return f"{values.shape[1]}x{values.shape[0]}"
