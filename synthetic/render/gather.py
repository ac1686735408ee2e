"""Direct light at points of any surface, of any material, by summing over the directions that it comes from.

    E = integral of L(wi) V(wi) cos(theta_i) dwi,    G = integral of lobe(wi, wo) L(wi) V(wi) cos(theta_i) dwi

so that the radiance is kd E + ks G. Directions are taken both from where the lights are bright and from where the
lobe is high, each weighted by the density with which either would have taken it (Veach and Guibas, "Optimally
combining sampling techniques for Monte Carlo rendering", 1995, balance heuristic): bounded weights, no bias.
Nothing is precomputed, filtered or expanded; visibility V is a ray for every direction.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from synthetic.lights.illumination import Illumination
from synthetic.lights.sources import DirectionalSource, PointSource
from synthetic.materials.material import Material
from synthetic.render.lattice import shifted
from synthetic.shapes.surface import Points, Surface
from synthetic.vectors import local_frame, to_local, to_world

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
AnyFloats = NDArray[np.floating]

# Pairs of point and direction at a time: arrays of this many float32 stay in the cache.
_PAIRS_PER_CHUNK = 1 << 15


def direct_light(
    surface: Surface,
    material: Material,
    illumination: Illumination,
    points: Points,
    views: Floats,
    lattices: Floats,
    rng: np.random.Generator,
    shifts: NDArray[np.intp] | None = None,
) -> tuple[Floats, Floats]:
    """Irradiance E and lobe integral G, (n, 3) each, from all lights at points (n) seen from directions views (n, 3).

    lattices : (n, k, 2) points of the unit square, the k directions tried per light (and as many for the lobe).
    shifts : (n,) which points share a random shift of their lattices, counted from 0; each its own if not given.
    """
    irradiance, lobe = np.zeros((len(points), 3)), np.zeros((len(points), 3))
    for source in illumination.sources:
        from_source(surface, material, source, points, views, irradiance, lobe)
    bulbs = material.is_mirror and not material.kd.any()
    if not (illumination.extended or bulbs) or not len(points):
        return irradiance, lobe
    groups = np.arange(len(points)) if shifts is None else shifts
    strategies = len(illumination.extended) + 1
    moves = rng.random((int(groups.max()) + 1, strategies, 2))[groups]
    size = max(1, _PAIRS_PER_CHUNK // lattices.shape[1])
    for start in range(0, len(points), size):
        part = slice(start, start + size)
        gathered = _gather(
            surface, material, illumination, points[part], views[part], lattices[part], moves[part]
        )
        irradiance[part] += gathered[0]
        lobe[part] += gathered[1]
    return irradiance, lobe


def from_source(
    surface: Surface,
    material: Material,
    source: DirectionalSource | PointSource,
    points: Points,
    views: Floats,
    irradiance: Floats,
    lobe: Floats,
) -> None:
    """Add what a source gives at points (n) to E and G (n, 3), in place; one shadow ray each."""
    towards, distances, strength = source.at(points.positions)
    cos_i = (points.normals * towards).sum(axis=1)
    lit = np.flatnonzero((cos_i > 0) & ((points.normals * views).sum(axis=1) > 0))
    if not surface.convex:
        ends = None if np.isinf(distances).all() else distances[lit]
        lit = lit[~surface.occluded(points.positions[lit], points.facets[lit], towards[lit], ends)]
    arriving = cos_i[lit, None] * strength[lit]
    irradiance[lit] += arriving
    if material.ks.any() and not material.is_mirror:
        frames = local_frame(points.normals[lit], points.tangents[lit])
        lobe[lit] += arriving * material.lobe(to_local(frames, towards[lit]), to_local(frames, views[lit]))


def _gather(
    surface: Surface,
    material: Material,
    illumination: Illumination,
    points: Points,
    views: Floats,
    lattices: Floats,
    moves: Floats,
) -> tuple[Floats, Floats]:
    """E and G (n, 3) from the extended lights, all directions at once, in single precision (1e-6 of the sums)."""
    frames = local_frame(points.normals, points.tangents).astype(np.float32)
    wo = to_local(frames, views.astype(np.float32))
    if material.is_mirror and not material.kd.any():
        return np.zeros_like(views), _mirrored(surface, material, illumination, points, frames, wo)
    count = lattices.shape[1]
    glossy = bool(material.ks.any()) and not material.is_mirror
    batches = [light.sample(shifted(lattices, moves[:, j])) for j, light in enumerate(illumination.extended)]
    if glossy:
        local = material.sample(wo[:, None], shifted(lattices, moves[:, -1]))
        batches.append(local @ frames)
    wi = np.concatenate(batches, axis=1)
    local = wi @ frames.swapaxes(1, 2)
    density = sum(light.density(wi) for light in illumination.extended)
    if glossy:
        density = density + material.density(local, wo[:, None])
    # Placeholders of 1 where nothing arrives anyway.
    weight = np.maximum(local[..., 2], 0) / (count * np.where(density > 0, density, 1))
    weight *= wo[:, None, 2] > 0
    if not surface.convex:
        row, column = np.nonzero(weight)
        blocked = surface.occluded(points.positions[row], points.facets[row], wi[row, column])
        weight[row[blocked], column[blocked]] = 0
    arriving = illumination.radiance_from(wi)
    irradiance = _sums(weight, arriving)
    if material.is_mirror:
        return irradiance, _mirrored(surface, material, illumination, points, frames, wo)
    if not glossy:
        return irradiance, np.zeros_like(irradiance)
    lobe = material.lobe(local, wo[:, None])
    if lobe.shape[-1] == 1:
        return irradiance, _sums(weight * lobe[..., 0], arriving)
    return irradiance, _sums(weight, arriving * lobe)


def _sums(weights: AnyFloats, values: AnyFloats) -> Floats:
    """Sums (n, 3) over k of weights (n, k) times values (n, k, 3)."""
    return np.asarray((weights[:, None] @ values)[:, 0], float)


def _mirrored(
    surface: Surface,
    material: Material,
    illumination: Illumination,
    points: Points,
    frames: Singles,
    wo: Singles,
) -> Floats:
    """What a mirror shows (n, 3): the radiance from the one direction that it looks into."""
    local = material.sample(wo, np.zeros((len(wo), 2), np.float32))
    wi = to_world(frames, local)
    radiance = illumination.radiance_from(wi)
    for source in illumination.sources:
        if isinstance(source, PointSource):
            radiance = radiance + source.mirrored(points.positions, wi)
    seen = radiance * material.mirrored(wo) * (wo[:, 2:] > 0)
    if not surface.convex:
        seen[surface.occluded(points.positions, points.facets, wi)] = 0
    return seen.astype(float)
