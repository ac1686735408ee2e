"""Interreflection with little noise: light that other parts of a mesh send, gathered from all directions.

    B_indirect(x) = integral of rho(wi, wo) B(y(x, wi)) cos(theta_i) dwi    over directions in which it is met

The matte part varies little along most of the surface: the irradiance from other parts is gathered at the vertices,
finely and once for all photographs, and interpolated (Goral et al., "Modeling the interaction of light between diffuse
surfaces", 1984), but where it does vary, in creases, it is gathered for every pixel, as the glossy part is.

In all of these, what leaves a point y is computed where y is: sources by a shadow ray, glossy reflections for the very
direction towards x; only the irradiance from extended lights, and that after two and more reflections, come from the
vertices there too. In the latter lobes count as matte surfaces of the same albedo, so that further reflections
by glossy materials are approximate. `paths` takes no such steps, and is what this is tested by.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, vstack

from capture.parallel import parallel_map
from synthetic.lights.illumination import Illumination
from synthetic.materials.energy import bihemispherical_lobe
from synthetic.materials.lambertian import Lambertian
from synthetic.materials.material import Material, sample_cosine
from synthetic.render.gather import direct_light, from_source
from synthetic.render.lattice import lattice, shifted
from synthetic.shapes.meshsurface import MeshSurface
from synthetic.shapes.surface import Points
from synthetic.vectors import local_frame, sums_by_row, to_local, to_world

Floats = NDArray[np.float64]
AnyFloats = NDArray[np.floating]
Ints = NDArray[np.int64]

# Directions that a vertex looks into: for extended lights, for the exchange between vertices, and for other parts.
_SOFT, _EXCHANGE, _PARTS = 1024, 256, 2048
_VERTICES_PER_CHUNK = 512
# Pairs of point and direction at a time.
_PAIRS_PER_CHUNK = 1 << 15
# Where the irradiance from other parts differs between the corners of a triangle by more than this, of the mean
# irradiance, it isn't interpolated.
_UNEVEN = 0.06
# There, much is met nearby, of very different brightness: so many lattices are used for one.
_ROUNDS = 4
# The share of points at which the glossy reflection of extended lights is asked for, a random one.
_ASKED = 0.25
# The vertices' random numbers, whatever the scene's.
_SEED = 271
_MATTE = Lambertian(np.full(3, 1 / np.pi))


@dataclass(frozen=True, eq=False)
class PartsLight:
    """What the parts of a mesh send each other.

    soft, exchanged : (v, 3) irradiance at the vertices, from extended lights, and from other parts after one
    reflection fewer than wanted: what leaves a point is computed from these.
    parts : (v, 3) irradiance from other parts after all reflections. level : mean irradiance from everywhere.
    """

    surface: MeshSurface
    material: Material
    illumination: Illumination
    soft: Floats
    exchanged: Floats
    parts: Floats
    level: float


@lru_cache(maxsize=4)
def parts_light(
    surface: MeshSurface, material: Material, illumination: Illumination, bounces: int
) -> PartsLight:
    """Gather the irradiance at all vertices after up to `bounces` reflections, >= 1; kept for the last few calls."""
    vertices = surface.vertex_points()
    chunks = _vertex_chunks(vertices)

    def exchange(chunk: tuple[int, Points]) -> csr_array:
        return _exchange(surface, chunk[1], np.random.default_rng([_SEED, chunk[0], 1]))

    def parts(chunk: tuple[int, Points]) -> Floats:
        rng = np.random.default_rng([_SEED, chunk[0], 2])
        lattices = np.broadcast_to(lattice(_PARTS), (len(chunk[1]), _PARTS, 2))
        return _irradiance(coarse, chunk[1], lattices, rng.random((len(chunk[1]), 2)), rng)

    from_lights = _soft_light(surface, illumination)
    exchanged = np.zeros_like(from_lights)
    direct, no_lobe = from_lights.copy(), np.zeros_like(from_lights)
    for source in illumination.sources:
        from_source(surface, _MATTE, source, vertices, vertices.normals, direct, no_lobe)
    if bounces > 1:
        matrix = vstack(list(parallel_map(exchange, chunks))).tocsr()
        reflectance = _as_matte(material, vertices)
        for _ in range(bounces - 1):
            exchanged = matrix @ (reflectance * (direct + exchanged))
    level = float(direct.mean())
    coarse = PartsLight(surface, material, illumination, from_lights, exchanged, exchanged, level)
    return replace(coarse, parts=np.concatenate(list(parallel_map(parts, chunks))))


@lru_cache(maxsize=4)
def _soft_light(surface: MeshSurface, illumination: Illumination) -> Floats:
    """Irradiance (v, 3) at all vertices from extended lights, of whatever material; kept for the last few calls."""

    def soft(chunk: tuple[int, Points]) -> Floats:
        return _from_extended(surface, illumination, chunk[1], np.random.default_rng([_SEED, chunk[0]]))

    return np.concatenate(list(parallel_map(soft, _vertex_chunks(surface.vertex_points()))))


def _vertex_chunks(vertices: Points) -> list[tuple[int, Points]]:
    """Vertices some at a time, each chunk with its first one's number."""
    starts = range(0, len(vertices), _VERTICES_PER_CHUNK)
    return [(start, vertices[start : start + _VERTICES_PER_CHUNK]) for start in starts]


def bounced_light(
    light: PartsLight,
    points: Points,
    views: Floats,
    lattices: Floats,
    rng: np.random.Generator,
    shifts: NDArray[np.intp],
    everywhere: bool = False,
) -> Floats:
    """Radiance (n, 3) at points (n) of the mesh towards views (n, 3) of the light that its other parts send there.

    lattices, shifts : as `direct_light` has them. everywhere : nothing is interpolated between vertices.
    """
    assert points.corners is not None, "points of meshes lie between vertices"
    kd, ks = light.material.weights(points.uv)
    moves = rng.random((int(shifts.max(initial=0)) + 1, 2, 2))[shifts]
    irradiance = _between(light.parts, points)
    spread = np.ptp(light.parts[points.corners], axis=1).max(axis=1)
    uneven = np.arange(len(points)) if everywhere else np.flatnonzero(spread > _UNEVEN * light.level)
    rounds = [
        _irradiance(light, points[uneven], lattices[uneven], (moves[uneven, 0] + rng.random(2)) % 1, rng)
        for _ in range(1 if everywhere else _ROUNDS)
    ]
    irradiance[uneven] = np.mean(rounds, axis=0)
    radiance = kd * irradiance * ((points.normals * views).sum(axis=1) > 0)[:, None]
    if light.material.ks.any():
        radiance += ks * _glossy(light, points, views, lattices, moves[:, 1], rng)
    return np.asarray(radiance)


def _irradiance(
    light: PartsLight, points: Points, lattices: Floats, moves: Floats, rng: np.random.Generator
) -> Floats:
    """Irradiance (n, 3) at points (n) by what other parts send, in k directions each by the cosine."""
    frames = local_frame(points.normals).astype(np.float32)
    irradiance = np.zeros((len(points), 3))
    for part in _chunks(lattices):
        local = sample_cosine(shifted(lattices[part], moves[part]))
        row, _, sent = _met(light, points[part], local @ frames[part], local[..., 2] > 0, rng)
        irradiance[part] = sums_by_row(row, sent, len(local)) * (np.pi / lattices.shape[1])
    return irradiance


def _glossy(
    light: PartsLight,
    points: Points,
    views: Floats,
    lattices: Floats,
    moves: Floats,
    rng: np.random.Generator,
) -> Floats:
    """Integral (n, 3) of the lobe over what other parts send, in k directions each by the lobe."""
    material = light.material
    frames = local_frame(points.normals, points.tangents).astype(np.float32)
    total = np.zeros((len(points), 3))
    for part in _chunks(lattices):
        wo = to_local(frames[part], views[part].astype(np.float32))[:, None]
        local = material.sample(wo, shifted(lattices[part], moves[part]))
        density = material.density(local, wo)
        weight = np.maximum(local[..., 2], 0) / (lattices.shape[1] * np.where(density > 0, density, 1))
        weight *= wo[..., 2] > 0
        row, column, sent = _met(light, points[part], local @ frames[part], weight > 0, rng)
        lobe = material.lobe(local, wo)[row, column] * weight[row, column, None]
        total[part] = sums_by_row(row, sent * lobe, len(local))
    return total


def _chunks(lattices: Floats) -> list[slice]:
    count, each = lattices.shape[:2]
    size = max(1, _PAIRS_PER_CHUNK // each)
    return [slice(start, start + size) for start in range(0, count, size)]


def _met(
    light: PartsLight, points: Points, wi: AnyFloats, used: NDArray[np.bool_], rng: np.random.Generator
) -> tuple[Ints, Ints, Floats]:
    """Which of the directions wi (n, k, 3) in use (n, k) meet the mesh: rows, columns, and the radiance sent back."""
    row, column = np.nonzero(used)
    directions = wi[row, column]
    hit, met = light.surface.first_hits(points.positions[row], directions, points.facets[row])
    sent = _sent(light, met, -directions[hit].astype(float), rng)
    return row[hit], column[hit], sent


def _sent(light: PartsLight, points: Points, towards: Floats, rng: np.random.Generator) -> Floats:
    """Radiance (n, 3) that points (n) send in directions (n, 3)."""
    kd, ks = light.material.weights(points.uv)
    irradiance = _between(light.soft, points)
    lobe = np.zeros_like(irradiance)
    for source in light.illumination.sources:
        from_source(light.surface, light.material, source, points, towards, irradiance, lobe)
    if light.material.ks.any() and light.illumination.extended:
        asked = np.flatnonzero(rng.random(len(points)) < _ASKED)
        lobe[asked] += _glossy_of_extended(light, points[asked], towards[asked], rng) / _ASKED
    exchanged = _between(light.exchanged, points)
    radiance = kd * irradiance + ks * lobe + _as_matte(light.material, points) * exchanged
    return np.asarray(radiance * ((points.normals * towards).sum(axis=1) > 0)[:, None])


def _glossy_of_extended(
    light: PartsLight, points: Points, towards: Floats, rng: np.random.Generator
) -> Floats:
    """The lobe integral (n, 3) of the extended lights from one direction each: right in the mean over many points."""
    material = light.material
    frames = local_frame(points.normals, points.tangents)
    wo = to_local(frames, towards)
    local = material.sample(wo, rng.random((len(points), 2)))
    density = material.density(local, wo)
    weight = np.maximum(local[:, 2], 0) / np.where(density > 0, density, 1) * (wo[:, 2] > 0)
    used = np.flatnonzero(weight)
    wi = to_world(frames[used], local[used])
    clear = ~light.surface.occluded(points.positions[used], points.facets[used], wi)
    used, wi = used[clear], wi[clear]
    lobe = np.zeros((len(points), 3))
    seen = light.illumination.radiance_from(wi) * material.lobe(local[used], wo[used])
    lobe[used] = weight[used, None] * seen
    return lobe


def _from_extended(
    surface: MeshSurface, illumination: Illumination, vertices: Points, rng: np.random.Generator
) -> Floats:
    """Irradiance (n, 3) at vertices (n) from extended lights."""
    if not illumination.extended:
        return np.zeros((len(vertices), 3))
    lattices = np.broadcast_to(lattice(_SOFT), (len(vertices), _SOFT, 2))
    only = replace(illumination, sources=())
    return direct_light(surface, _MATTE, only, vertices, vertices.normals, lattices, rng)[0]


def _exchange(surface: MeshSurface, vertices: Points, rng: np.random.Generator) -> csr_array:
    """How much of the radiance of each vertex (v) is irradiance at these, (n, v), steradian."""
    frames = local_frame(vertices.normals).astype(np.float32)
    local = sample_cosine(shifted(lattice(_EXCHANGE)[None], rng.random((len(vertices), 2))))
    directions = (local @ frames).reshape(-1, 3)
    row = np.repeat(np.arange(len(vertices)), _EXCHANGE)
    hit, met = surface.first_hits(vertices.positions[row], directions, vertices.facets[row])
    assert met.corners is not None
    assert met.shares is not None
    entries = met.shares.ravel() * (np.pi / _EXCHANGE)
    shape = (len(vertices), len(surface.mesh.vertices))
    return csr_array((entries, (np.repeat(row[hit], 3), met.corners.ravel())), shape=shape)


def _as_matte(material: Material, points: Points) -> Floats:
    """The BRDF (n, 3) of a matte surface that reflects as much light from all around."""
    kd, ks = material.weights(points.uv)
    return np.asarray(kd + ks * bihemispherical_lobe(material) / np.pi)


def _between(values: Floats, points: Points) -> Floats:
    """Values (n, 3) at points (n) of the mesh, interpolated from its vertices' (v, 3)."""
    assert points.corners is not None, "points of meshes lie between vertices"
    assert points.shares is not None
    return np.asarray(np.einsum("nk,nkc->nc", points.shares, values[points.corners]))
