"""Phong's lobe."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.form import Angles, Lobe, LobeForm

Floats = NDArray[np.float64]


class Phong(LobeForm):
    """cos^s of the angle to the mirror direction, s = 1 / (2 sigma^2), normalised as by Lafortune and Willems 1994."""

    name = "Phong"
    description = "Phong's lobe about the mirrored view"
    has_fresnel = False

    def shape(self, angles: Angles, sigma: float | Floats) -> Floats:
        lit = (angles.cos_i > 0) & (angles.cos_o > 0)
        exponent = phong_exponent(sigma)
        # The mirrored viewer's cosine to the light.
        mirrored = 2 * angles.cos_i * angles.cos_o - (2 * angles.cos_d**2 - 1)
        lobe = (exponent + 2) / (2 * np.pi) * np.clip(mirrored, 0, 1) ** exponent
        return np.where(lit, lobe * angles.cos_i, 0)

    def fresnel_cosine(self, angles: Angles) -> Floats:
        return angles.cos_o


def mirrored_phong(exponent: float) -> Lobe:
    """(s + 1) / (2 pi) cos^s of the angle to the mirrored view, horizon or not [R02, eq. 5.26]; the cosine is in it.

    Normalised to 1 over the half sphere about the mirrored view.
    """

    def lobe(normals: Floats, wi: Floats, wo: Floats) -> Floats:
        mirrored = 2 * (normals * wo).sum(axis=-1, keepdims=True) * normals - wo
        cos = np.clip((mirrored * wi).sum(axis=-1), 0, 1)
        return np.asarray((exponent + 1) / (2 * np.pi) * cos**exponent)

    return lobe


def phong_exponent(sigma: float | Floats) -> Floats:
    """The exponent s of Phong's lobe whose highlight is as wide as that of facets of roughness sigma, radians."""
    return np.asarray(1 / (2 * np.asarray(sigma, float) ** 2))


def phong_sigma(exponent: float) -> float:
    """The roughness, radians, whose `phong_exponent` is a given one, > 0."""
    return float(np.sqrt(1 / (2 * exponent)))
