"""A map of light prefiltered for a BRDF: reflection maps of its lobes, their orders, and how far they can be off."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capture.lighting import check_latlong, latlong_directions
from invrender.prefilter.bounds import ErrorBound, LightingEnergy, ball_angles, error_bound, sphere_angles
from invrender.prefilter.centred import CentredBrdf, CentredLobe
from invrender.prefilter.globalmap import GlobalReflectionMap, global_map
from invrender.prefilter.reflectionmap import ReflectionMap, isotropic_terms, reflected_terms
from recon.harmonics.basis import check_degree
from recon.harmonics.latlong import integrate_latlong

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

# Rows of a map per degree [R02, section 5.5.2, S ~ 10 F], and at least.
_ROWS_PER_DEGREE, _LEAST_ROWS = 10, 20
# Maps and what making them takes may fill so much memory, bytes.
_MOST_BYTES = 2 << 30
# Angles at which the bound is stated.
_ANGLES = 24
# By how much more than it receives a BRDF may reflect, over all views: what its quadrature leaves, and rounding.
_ALBEDO_EXCESS = 0.01


@dataclass(frozen=True, eq=False)
class PrefilteredLobe:
    """One lobe under the light.

    rho : (n, F + 1, P + 1, min + 1), its coefficients, of one lobe for all channels or of three, without strength.
    left_out : the share of its energy that these leave out, the largest of the channels [R02, eq. 5.18]. local : its
    reflection map, strength included. bound : of this map.
    """

    lobe: CentredLobe
    rho: Floats
    left_out: float
    local: ReflectionMap
    bound: ErrorBound

    @property
    def orders(self) -> tuple[int, int]:
        """F and P."""
        return self.rho.shape[1] - 1, self.rho.shape[2] - 1

    @property
    def between_pixels(self) -> float:
        """How far values between pixels can be off, over the largest that a viewer's map holds.

        (pi (F + P) / 2H)^2: maps are waves of at most F + P along rows and columns; Bernstein's inequality bounds their
        second derivatives.
        """
        return float((np.pi * sum(self.orders) / (2 * self.local.maps.shape[2])) ** 2)

    def radiance(self, axes: Floats, views: Floats) -> Floats:
        """Reflected radiance (n, 3) of normals or tangents (n, 3) seen from (n, 3), all unit."""
        factor = self.lobe.factor((axes * views).sum(axis=-1, keepdims=True))
        return self.world.radiance(self.lobe.centres(axes, views), views) * factor

    def seen_from(self, viewer: Floats) -> Singles:
        """The reflection map (3, H, 2H) over the lobe's centres for a distant viewer in a direction (3,), unit."""
        found = self.world.seen_from(viewer[None])[0]
        cos_view = latlong_directions(found.shape[1]) @ viewer
        # Of mirrored views the normal is half way to the viewer.
        cos_angle = np.sqrt((1 + cos_view).clip(0) / 2) if self.lobe.mirrored else cos_view
        return np.asarray(found * self.lobe.factor(cos_angle), np.float32)

    @cached_property
    def world(self) -> GlobalReflectionMap:
        """The same map in the world's axes."""
        return global_map(self.local)


@dataclass(frozen=True, eq=False)
class PrefilteredLight:
    """A BRDF's lobes under one light.

    lighting : coefficients ((F + 1)^2, 3) of the map, to the highest of the orders. albedo : (k, 3), what is reflected
    of light from all sides, at the angles of the bound. bound : of the sum.
    """

    brdf: CentredBrdf
    lobes: tuple[PrefilteredLobe, ...]
    lighting: Floats
    albedo: Floats
    bound: ErrorBound

    def radiance(self, axes: Floats, views: Floats) -> Floats:
        """Reflected radiance (n, 3) of normals or tangents (n, 3) seen from (n, 3), all unit."""
        views = np.broadcast_to(views, axes.shape)
        return np.asarray(sum(each.radiance(axes, views) for each in self.lobes))


def prefilter(
    radiance_map: ArrayLike,
    brdf: CentredBrdf,
    epsilon: float = 0.03,
    orders: tuple[int, int] | None = None,
    rows: int | None = None,
    is_absolute: bool = True,
) -> PrefilteredLight:
    """A lat-long map (H, 2H, 3), constant within each pixel, prefiltered for a BRDF [R02, section 5.6.2].

    epsilon : the share of a lobe's energy that its orders may leave out. orders : F and P of the last lobe instead.
    rows : of the maps; 10 F if None. is_absolute : whether the BRDF has a scale, and so must reflect no more than it
    receives. Raises ValueError for maps that aren't light, orders that aren't reached or don't fit into 2 GB, and a
    BRDF that reflects more than it receives over all views.
    """
    radiance_map = np.asarray(radiance_map, float)
    check_latlong(radiance_map, "radiance_map")
    if not 0 < epsilon < 1:
        raise ValueError(f"epsilon is {epsilon}; the share of energy that may be missing must be in (0, 1)")
    if rows is not None:
        check_degree(rows - 1, "rows - 1")
    if orders is not None:
        for order, name in zip(orders, ("F", "P"), strict=True):
            check_degree(order, name)
    cos_angles, weights = (ball_angles if brdf.axis == "normal" else sphere_angles)(_ANGLES)
    albedo = _albedo(brdf, cos_angles)
    mean = weights @ albedo
    if is_absolute and (mean > 1 + _ALBEDO_EXCESS).any():
        raise ValueError(
            f"{brdf.description}: reflects {mean.max():.3g} times the light that it receives, over all views; a BRDF"
            " reflects at most what it receives"
        )
    chosen = [lobe.orders(epsilon) for lobe in (brdf.lobes if orders is None else brdf.lobes[:-1])]
    if orders is not None:
        chosen.append(orders)
    for lobe, (f, p) in zip(brdf.lobes, chosen, strict=True):
        _check_memory(lobe, f, p, _height(f, rows))
    highest = max(f for f, _ in chosen)
    coefficients = integrate_latlong(radiance_map, 2 * highest + 8)
    light, lighting = LightingEnergy.of(coefficients, radiance_map), coefficients[: (highest + 1) ** 2]
    found = []
    for lobe, (f, p) in zip(brdf.lobes, chosen, strict=True):
        rho, energy = lobe.coefficients(f, p)
        held = (rho**2 * np.where(np.arange(rho.shape[3]) > 0, 2, 1)).sum(axis=(1, 2, 3))
        maps = reflected(lobe, rho, lighting[: (f + 1) ** 2], _height(f, rows))
        bound = error_bound(lobe, rho, light, cos_angles, weights)
        left_out = float((1 - held / np.where(energy > 0, energy, 1)).max().clip(0))
        found.append(PrefilteredLobe(lobe, rho, left_out, maps, bound))
    bound = found[0].bound
    for each in found[1:]:
        bound = bound + each.bound
    return PrefilteredLight(brdf, tuple(found), lighting, albedo, bound)


def reflected(lobe: CentredLobe, rho: Floats, lighting: Floats, rows: int) -> ReflectionMap:
    """The reflection map of a lobe, strength included, under light of degree F [R02, eq. 5.7 to 5.9]."""
    terms = [isotropic_terms(each) for each in rho]
    if len(terms) == 1:
        maps = reflected_terms(lighting, *terms[0], rows)
    else:
        maps = np.concatenate(
            [reflected_terms(lighting[:, [c]], *term, rows) for c, term in enumerate(terms)], axis=1
        )
    return ReflectionMap(maps * lobe.strength.astype(np.float32)[:, None, None])


def _height(degree: int, rows: int | None) -> int:
    return max(_ROWS_PER_DEGREE * degree, _LEAST_ROWS) if rows is None else rows


def _albedo(brdf: CentredBrdf, cos_angles: Floats) -> Floats:
    """Shares (k, 3) of light from all sides that are reflected at cosines (k,) of the view to the axis."""
    total = np.zeros((len(cos_angles), 3))
    for lobe in brdf.lobes:
        coefficients, _ = lobe.at_views(lobe.cos_views(cos_angles), 0, 0)
        total += np.sqrt(4 * np.pi) * coefficients[:, :, 0, 0].T * lobe.factor(cos_angles)[:, None]
    return total


def _check_memory(lobe: CentredLobe, f: int, p: int, rows: int) -> None:
    """ValueError where maps of these orders, with the turns and waves that make them, are too large."""
    terms, q_max = (p + 1) ** 2, min(f, p)
    # Local and global maps, waves in two copies, turns; single precision.
    numbers = 2 * terms * 3 * rows * 2 * rows + 2 * terms * 3 * rows * 2 * (f + 1)
    numbers += (q_max + 1) * 2 * (f + 1) ** 2 * rows
    if 4 * numbers > _MOST_BYTES:
        raise ValueError(
            f"the lobe {lobe.name!r} with F = {f}, P = {p} on {rows} rows takes {4 * numbers / 2**30:.1f} GB, more than"
            f" {_MOST_BYTES / 2**30:.0f}: take lower orders, more error or fewer rows"
        )
