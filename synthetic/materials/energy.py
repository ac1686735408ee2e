"""How much of the light that falls on a material it reflects.

    directional albedo      a(wo) = integral of rho(wi, wo) cos theta_i dwi
    bihemispherical albedo  2 integral of a cos theta_o d(cos theta_o), mean over azimuths: under light from all around

By quadrature over incident directions, which shares nothing with the materials' own sampling.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from synthetic.materials.material import Material
from synthetic.materials.microfacet import MicrofacetMaterial
from synthetic.materials.mirror import Mirror
from synthetic.materials.texture import Textured

Floats = NDArray[np.float64]

# Nodes halve their distance to the lobe's centre this often: it may be 1e-3 rad narrow.
_LEVELS = 11
_NODES_PER_LEVEL = 6
# What the quadrature may be wrong by.
_TOLERANCE = 3e-3
_CHECKED_ANGLES = np.radians([0, 20, 40, 55, 65, 72, 77, 81, 84, 86, 88, 89.9])
_COSINES = 12
_AZIMUTHS = 4


def directional_albedo(material: Material, cos_o: ArrayLike, azimuth: float = 0.0) -> Floats:
    """Share (n, 3) of the light from all around that leaves towards viewers at cosines (n,), 0 to 1 exclusive of 0.

    By reciprocity also the share of a beam from there that is reflected to all sides, if the material is reciprocal.
    azimuth : of the viewers from the tangent, radians. Good to 1e-3 of itself; 2% for Beckmann wider than 1 at grazing.
    """
    return np.asarray(np.pi * material.kd + material.ks * _lobe_albedo(material, cos_o, azimuth))


def bihemispherical_albedo(material: Material) -> Floats:
    """Share (3,) that is reflected of light from all around, to all sides."""
    return np.pi * material.kd + material.ks * bihemispherical_lobe(material)


@lru_cache(maxsize=16)
def check_energy(material: Material) -> None:
    """Raises ValueError, with the albedo, for a material that reflects more than it receives.

    In no direction may it; only RH01's microfacets, whose printed form has a factor 1 / cos theta_o and so exceeds any
    bound towards grazing, are taken in the mean over directions, which is finite. Of a textured material,
    every texel is checked for both maps' largest values. A material that has passed isn't checked again.
    """
    if isinstance(material, Textured):
        kd, ks = material.kd_map.max(axis=(0, 1)), material.ks_map.max(axis=(0, 1))
        described = material.material
    else:
        kd, ks, described = material.kd, material.ks, material
    if isinstance(described, MicrofacetMaterial):
        _refuse(np.pi * kd + ks * bihemispherical_lobe(described), "of the light from all around")
        return
    for azimuth in _azimuths(described):
        albedos = np.pi * kd + ks * _lobe_albedo(described, np.cos(_CHECKED_ANGLES), azimuth)
        worst = albedos.max(axis=1).argmax()
        _refuse(albedos[worst], f"at {np.degrees(_CHECKED_ANGLES[worst]):.0f} degrees exitance")


def _refuse(albedo: Floats, where: str) -> None:
    channel = int(albedo.argmax())
    if not albedo[channel] <= 1 + _TOLERANCE:
        raise ValueError(
            f"the material reflects {albedo[channel]:.2f} of the light that falls on it"
            f" ({('red', 'green', 'blue')[channel]}, {where}): lower kd or ks"
        )


def _azimuths(material: Material) -> Floats:
    # Half a turn changes no lobe of slopes.
    count = 1 if material.is_isotropic else _AZIMUTHS
    return np.pi / count * np.arange(count, dtype=float)


@lru_cache(maxsize=16)
def bihemispherical_lobe(material: Material) -> Floats:
    """The part of the lobe alone in it, (1,) or (3,), per unit of ks; kept for the last few materials."""
    node, weight = np.polynomial.legendre.leggauss(_COSINES)
    cos, weight = (node + 1) / 2, weight / 2
    means = [_lobe_albedo(material, cos, azimuth) for azimuth in _azimuths(material)]
    return np.asarray(2 * (weight * cos) @ np.mean(means, axis=0))


def _lobe_albedo(material: Material, cos_o: ArrayLike, azimuth: float) -> Floats:
    """`directional_albedo` (n, 1) or (n, 3) of the lobe alone."""
    cos = np.atleast_1d(np.asarray(cos_o, float))
    if isinstance(material, Mirror):
        return np.asarray(material.fresnel(cos)[:, None], float)
    return np.array([_lobe_integral(material, theta, azimuth) for theta in np.arccos(cos)])


def _lobe_integral(material: Material, theta: float, azimuth: float) -> Floats:
    """The lobe's albedo (1,) or (3,) at an angle of exitance.

    In polar coordinates about the viewer, angle beta and azimuth phi, the normal being at phi = 0: every lobe has its
    centre where the half vector is the normal, beta = 2 theta and phi = 0, and keeps its width in half vectors. Nodes
    gather there, and the horizon, where integrands jump, is a limit of the integral over beta.
    """
    share, weight = _graded()
    # The horizon turns sharply at a right angle when the view is grazing.
    phi = np.concatenate([np.pi / 4 * share, np.pi / 2 - np.pi / 4 * share, np.pi / 2 + np.pi / 2 * share])
    phi_weight = np.pi / 4 * np.concatenate([weight, weight, 2 * weight])
    horizon = np.arctan2(np.cos(theta), -np.sin(theta) * np.cos(phi))[:, None]
    centre = np.minimum(2 * theta, horizon)
    beta = np.concatenate([centre * (1 - share), centre + (horizon - centre) * share], axis=1)
    measure = np.concatenate([centre * weight, (horizon - centre) * weight], axis=1) * phi_weight[:, None]
    sin, cos = np.sin(beta), np.cos(beta)
    # Axes: the viewer, across it towards the normal, and sideways.
    forward, sideways = sin * np.cos(phi)[:, None], sin * np.sin(phi)[:, None]
    level = np.sin(theta) * cos - np.cos(theta) * forward
    up = np.cos(theta) * cos + np.sin(theta) * forward
    total = 0.0
    for side in (1, -1):
        turned = [
            np.cos(azimuth) * level - side * np.sin(azimuth) * sideways,
            np.sin(azimuth) * level + side * np.cos(azimuth) * sideways,
            up,
        ]
        wo = np.sin(theta) * np.array([np.cos(azimuth), np.sin(azimuth), 0]) + [0, 0, np.cos(theta)]
        lobe = material.lobe(np.stack(turned, axis=-1), wo)
        total = total + np.einsum("pbc,pb->c", lobe, measure * sin * np.maximum(up, 0))
    return np.asarray(total, float)


def _graded() -> tuple[Floats, Floats]:
    """Nodes and weights of an integral from 0 to 1, ever closer towards 0."""
    node, weight = np.polynomial.legendre.leggauss(_NODES_PER_LEVEL)
    edges = np.append(0.0, 0.5 ** np.arange(_LEVELS - 1, -1, -1))
    widths = np.diff(edges)[:, None]
    return (edges[:-1, None] + widths * (node + 1) / 2).ravel(), (widths * weight / 2).ravel()
