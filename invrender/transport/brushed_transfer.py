"""The half-vector integral of `half_vectors` for brushed forms: their rings are ellipses of slope.

A half-vector of slopes (x, y) = tan(theta) (sqrt(stretch) cos psi, sin psi / sqrt(stretch)) lies where the isotropic
lobe, stretched, has its ring theta. Stretching keeps areas of slope, so that the density times d omega is

    D(theta; sigma) sin(theta) d theta d psi  cos(theta) / cos(theta_h)

with the isotropic D. All sigma then share one walk through the map, as they do without a stretch.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.brushed import Brushed
from invrender.brdf.form import brushed_tangents
from invrender.transport.half_vectors import Chunk, PreparedMap, RayFrames, fill, ring_weights

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

# Rings that weigh less than this share of the heaviest are left out.
_NEGLIGIBLE = 1e-6
# How far apart rings lie, over the distance of an isotropic lobe's: ellipses are longer than circles of their area.
_CLOSER = 0.7
_LEAST_COS = np.float32(1e-4)
# Of a ring's angle and azimuths, for how half-vectors change with them.
_STEP = 1e-3
# Cosines that Fresnel's factor is looked up at.
_LOOKUP = 4096


def brushed_transfer(
    forms: Sequence[Brushed],
    light: PreparedMap,
    normals: Floats,
    views: Floats,
    sigmas: Floats,
    fresnel: Callable[[Floats], Floats],
) -> Singles:
    """Radiance (m, forms, k, sigmas, c) per unit of Ks from a map of c channels, for k functions in Fresnel's place.

    forms : brushed about one axis; those of one stretch share the walk. normals, views : (m, 3) unit. sigmas : (j,),
    radians. fresnel : cosines (...,) to (..., k).
    """
    light = light.with_rings(_CLOSER)
    factors = fresnel(np.linspace(0, 1, _LOOKUP)).astype(np.float32)
    channels = light.levels[0].shape[2]
    result = np.empty((len(normals), len(forms), factors.shape[1], len(sigmas), channels), np.float32)
    stretches = np.array([form.numbers["stretch"] for form in forms])

    def of_chunk(chunk: Chunk) -> Singles:
        axes, thetas = normals[chunk.rays], chunk.thetas
        frame = RayFrames.of(axes, views[chunk.rays], brushed_tangents(axes, forms[0].tangent_axis))
        view = np.stack([frame.along_tangent, frame.along_bitangent, frame.along_normal], axis=1)
        weights = [ring_weights(form.of.density, thetas, sigmas, light.fineness.log_step) for form in forms]
        found = np.zeros((len(axes), *result.shape[1:]), np.float32)
        for stretch in np.unique(stretches):
            mine = np.flatnonzero(stretches == stretch).tolist()
            towards = [_towards_viewer(forms[own], view, sigmas) for own in mine]
            largest = np.array([weights[own].max(axis=1) / weights[own].max() for own in mine]).max(axis=0)
            for k in np.flatnonzero(largest > _NEGLIGIBLE):
                ring = _ring(
                    light, frame, view, float(np.sqrt(stretch)), float(thetas[k]), float(chunk.turns[k])
                )
                arriving = ring.arriving(factors)
                for own, (cos_o, shown) in zip(mine, towards, strict=True):
                    seen = _seen(forms[own], ring, cos_o, shown, sigmas)
                    sums = (arriving @ seen).reshape(len(view), factors.shape[1], channels, -1)
                    found[:, own] += sums.transpose(0, 1, 3, 2) * weights[own][k][:, None].astype(np.float32)
        return found

    fill(result, light, of_chunk)
    return result


@dataclass(frozen=True, eq=False)
class _EllipseRing:
    """A ring's nodes. weight : (m, p), of the ring that each stands for, lit, times wo.h. toward : (m, p), wo.h.
    incident : (m, p, 3) in the frames. radiance : (m, p, c)."""

    weight: Singles
    toward: Singles
    incident: Singles
    radiance: Singles

    def arriving(self, factors: Singles) -> Singles:
        """Radiance times weight and Fresnel's factor, (m, k c, p); factors : (n, k) at even steps of the cosine."""
        place = np.clip(self.toward * np.float32(_LOOKUP - 1) + np.float32(0.5), 0, _LOOKUP - 1)
        factor = factors.take(place.astype(np.intp), axis=0).transpose(0, 2, 1)
        light = (self.radiance * self.weight[..., None]).transpose(0, 2, 1)
        return (factor[:, :, None] * light[:, None]).reshape(len(light), -1, light.shape[2])


def _ring(
    light: PreparedMap, frame: RayFrames, view: Singles, root: float, theta: float, turn: float
) -> _EllipseRing:
    """The ring of an angle; view : (m, 3) in the frames. root : of the stretch."""
    log_step = light.fineness.log_step
    longest = float(np.arctan(max(root, 1 / root) * np.tan(theta))) if theta < np.pi / 2 else np.pi / 2
    count = light.fineness.nodes(longest)
    azimuth = turn + 2 * np.pi * np.arange(count) / count
    nodes = _half_vectors(theta, azimuth, root)
    # A cell along the ring and outwards; where the horizon crosses it, it counts as in `half_vectors.facet_ring`.
    along = (_half_vectors(theta, azimuth + _STEP, root) - nodes) * (2 * np.pi / count / _STEP)
    beyond = (_half_vectors(theta * (1 + _STEP), azimuth, root) - nodes) * (log_step / _STEP)
    half, around, outward = (np.asarray(each, np.float32) for each in (nodes, along, beyond))
    toward: Singles = view @ half.T
    doubled = 2 * toward[..., None] * half
    incident: Singles = doubled - view[:, None]
    # By how much 2 (wo.h) h_z - wo_z changes over the cell.
    rises = [(view @ change.T) * half[:, 2] + toward * change[:, 2] for change in (around, outward)]
    cell = 2 * np.sqrt(rises[0] ** 2 + rises[1] ** 2) + np.float32(1e-9)
    lit = np.clip(incident[..., 2] / cell + np.float32(0.5), 0, 1)
    incident[..., 2] = np.maximum(np.maximum(incident[..., 2], lit * cell / 2), _LEAST_COS)
    axes = np.stack([frame.tangent, frame.bitangent, frame.normal], axis=1)
    world = doubled @ axes - frame.view[:, None]
    spacing = 2 * min(log_step * theta, float(np.linalg.norm(around, axis=1).mean()))
    share = (np.cos(theta) / nodes[:, 2] / count).astype(np.float32)
    radiance = light.seen(world.astype(np.float32), spacing)
    return _EllipseRing(lit * np.maximum(toward, 0) * share, toward, incident, radiance)


def _half_vectors(theta: float, azimuth: Floats, root: float) -> Floats:
    """Unit half-vectors (p, 3) of a ring in the frames."""
    sin, cos = np.sin(theta), np.full(len(azimuth), np.cos(theta))
    vectors = np.stack([sin * root * np.cos(azimuth), sin / root * np.sin(azimuth), cos], axis=1)
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def _towards_viewer(form: Brushed, view: Singles, sigmas: Floats) -> tuple[Singles, Singles]:
    """cos theta_o (m, 1, 1), and with what is hidden from there, (m, 1, j)."""
    cos_o = np.maximum(view[:, None, 2:], _LEAST_COS)
    hidden = _hidden(form, np.concatenate([view[:, None, :2], cos_o], axis=2), sigmas)
    return cos_o, cos_o + hidden


def _seen(form: Brushed, ring: _EllipseRing, cos_o: Singles, shown: Singles, sigmas: Floats) -> Singles:
    """G2 / cos theta_o (m, p, j), as cos_i / (cos_i cos_o / G2) in `Smith.shape`."""
    per_hidden = cos_o if form.of.correlated else shown
    hidden = _hidden(form, ring.incident, sigmas)
    return np.asarray(1 / (shown + hidden * (per_hidden / ring.incident[..., 2:])), np.float32)


def _hidden(form: Brushed, directions: Singles, sigmas: Floats) -> Singles:
    """What facets hide (..., j) of directions (..., 3) in the frames."""
    stretch = np.float32(form.numbers["stretch"])
    x2, y2 = directions[..., 0] ** 2, directions[..., 1] ** 2
    width = np.sqrt((stretch * x2 + y2 / stretch) / np.maximum(x2 + y2, np.float32(1e-12)))
    # In single precision, which takes half the time.
    cos: NDArray[Any] = directions[..., 2:]
    widths: NDArray[Any] = width[..., None] * sigmas.astype(np.float32)
    return np.asarray(form.of.hidden(cos, widths), np.float32)
