"""Transfer through the specular part of any form, Fresnel's factor as a sum of given functions.

A source at wi sends Ks F W cos theta_i; light from a map the integral of it over wi, which for facets is one over
half-vectors (`half_vectors`),

    integral D(theta_h) F(theta_d) G2 L(wi(h)) (wo.h) / cos theta_o  dh

D alone is a weight per ring. G2, what facets hide of each other, differs along a ring, but slowly with sigma: a few
roughnesses give it for all. Phong's lobe has its rings around the mirrored view, and a weight per ring is all of it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.brushed import Brushed
from invrender.brdf.form import Angles, LobeForm, part_width
from invrender.brdf.fresnel import normalised_fresnel
from invrender.brdf.lobes import RH01_FORM
from invrender.brdf.phong import phong_exponent
from invrender.brdf.smith import Smith
from invrender.transport.brushed_transfer import brushed_transfer
from invrender.transport.half_vectors import (
    Chunk,
    PreparedMap,
    RayFrames,
    facet_ring,
    fill,
    mirror_ring,
    ring_weights,
)
from invrender.transport.transfer import LightElement, exitant_grid, specular_transfer

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
# Cosines (...,) to values (..., k) of functions whose sum Fresnel's factor is; hashable.
FresnelFunctions = Callable[[Floats], Floats]

# Roughnesses that give G2 at all others to 2e-4, and cosines that its parts and Fresnel's are looked up at.
_HIDING_NODES, _LOOKUP = 10, 4096
# Rings in theta_h left out that weigh less than this share of the heaviest.
_NEGLIGIBLE = 1e-6


@dataclass(frozen=True)
class OneIndex:
    """Fresnel's factor of one refractive index, None for no factor: one function."""

    mu: float | None

    def __call__(self, cos: Floats) -> Floats:
        """F (..., 1), relative to normal incidence."""
        return normalised_fresnel(self.mu, np.clip(cos, 0, 1))[..., None]


def form_transfer(
    form: LobeForm,
    element: LightElement,
    normals: Floats,
    views: Floats,
    sigmas: Floats,
    fresnel: FresnelFunctions,
) -> Floats:
    """Reflected radiance (m, k, sigmas, channels) per unit of Ks and strength, for each of k functions in place of F.

    normals, views : (m, 3) unit. sigmas : (j,), radians; of many, the outer ones bound the others.
    """
    return forms_transfer((form,), element, normals, views, sigmas, fresnel)[:, 0]


def forms_transfer(
    forms: Sequence[LobeForm],
    element: LightElement,
    normals: Floats,
    views: Floats,
    sigmas: Floats,
    fresnel: FresnelFunctions,
) -> Floats:
    """`form_transfer` of several forms, (m, forms, k, sigmas, channels), which sum over the same half-vectors.

    forms : all of them facets', all brushed about one axis, or one.
    """
    sigmas = np.atleast_1d(np.asarray(sigmas, float))
    if any(len(form.parts) > 1 for form in forms):
        return np.concatenate(
            [_of_parts(form, element, normals, views, sigmas, fresnel) for form in forms], 1
        )
    if forms[0] is RH01_FORM:
        factors = fresnel((normals * views).sum(axis=1))
        plain = specular_transfer(element, normals, views, sigmas)
        return np.asarray(factors[:, None, :, None, None] * plain[:, None, None])
    shape = len(normals), len(forms), fresnel(np.ones(1)).shape[-1], len(sigmas), element.channels
    result = np.empty(shape) if element.irradiances.shape[-2] else np.zeros(shape)
    for k, (direction, irradiance) in enumerate(element.sources):
        # (channels,), or each ray's: (m, 1, 1, channels).
        strength = irradiance if irradiance.ndim == 1 else irradiance[:, None, None]
        angles = Angles.between(normals, direction, views, forms[0].axis)
        wide = angles.widened
        for own, form in enumerate(forms):
            lobe = form.shape(wide, sigmas)[:, None, :] * fresnel(form.fresnel_cosine(angles))[:, :, None]
            if k:
                result[:, own] += lobe[..., None] * strength
            else:
                # Most elements have one source: their columns are as large as memory is slow.
                np.multiply(lobe[..., None], strength, out=result[:, own])
    brushed = [form for form in forms if isinstance(form, Brushed)]
    if brushed:
        for light, share in ((element.prepared_map, 1.0), (_white(), element.uniform)):
            if light is not None and share:
                result += share * brushed_transfer(brushed, light, normals, views, sigmas, fresnel)
        return result
    if element.uniform:
        grid, table = _uniform_table(tuple(forms), tuple(sigmas.tolist()), fresnel)
        result += np.float32(element.uniform) * _interpolated(grid, table, (normals * views).sum(axis=1))
    if element.prepared_map is not None:
        result += _map_transfer(forms, element.prepared_map, normals, views, sigmas, fresnel)
    return result


def _of_parts(
    form: LobeForm,
    element: LightElement,
    normals: Floats,
    views: Floats,
    sigmas: Floats,
    fresnel: FresnelFunctions,
) -> Floats:
    """`forms_transfer` of a form that is a sum of lobes of several widths."""
    shares, factors = np.transpose(form.parts)
    widths = part_width(factors[:, None], sigmas).ravel()
    found = forms_transfer((form.lobe,), element, normals, views, widths, fresnel)
    apart = found.reshape(*found.shape[:3], len(factors), len(sigmas), found.shape[-1])
    return np.asarray(np.einsum("p,mfkpsc->mfksc", shares, apart))


def _map_transfer(
    forms: Sequence[LobeForm],
    light: PreparedMap,
    normals: Floats,
    views: Floats,
    sigmas: Floats,
    fresnel: FresnelFunctions,
) -> Singles:
    facets = [form for form in forms if isinstance(form, Smith)]
    if facets:
        return _facets(facets, light, normals, views, sigmas, fresnel)
    return _mirrored(light, normals, views, sigmas)[:, None, None]


def _facets(
    forms: Sequence[Smith],
    light: PreparedMap,
    normals: Floats,
    views: Floats,
    sigmas: Floats,
    fresnel: FresnelFunctions,
) -> Singles:
    """The half-vector integral over a map, (m, forms, k, sigmas, c)."""
    steps = np.linspace(0, 1, _LOOKUP)
    factors = fresnel(steps).astype(np.float32)
    nodes, blend = _hiding_nodes(sigmas)
    # Of all forms side by side: what else a ring asks for is the same.
    hidden = np.hstack([form.hidden(steps[:, None], nodes) for form in forms]).astype(np.float32)
    correlated = np.repeat([form.correlated for form in forms], len(nodes))
    functions, channels = factors.shape[1], light.levels[0].shape[2]

    def of_chunk(chunk: Chunk) -> Singles:
        frame = RayFrames.of(normals[chunk.rays], views[chunk.rays])
        weights = np.array(
            [ring_weights(form.density, chunk.thetas, sigmas, light.fineness.log_step) for form in forms]
        )
        largest = weights.max(axis=2)
        used = np.flatnonzero((largest > _NEGLIGIBLE * largest.max(axis=1, keepdims=True)).any(axis=0))
        cos_o = np.maximum(frame.along_normal, np.float32(1e-4))[:, None, None]
        towards_viewer = cos_o + _looked_up(hidden, frame.along_normal)[:, None]
        # cos_i / (cos_i cos_o / G2), as in `Smith.shape`, is (cos_i + hidden) + what this is times hidden / cos_i.
        per_hidden = np.where(correlated, cos_o, towards_viewer)
        means = np.empty(
            (len(forms), len(frame.normal), functions * channels, len(used), len(nodes)), np.float32
        )
        for place, k in enumerate(used):
            ring = facet_ring(light, frame, chunk.thetas[k], chunk.turns[k])
            cos_i = np.maximum(ring.cos_incident, np.float32(1e-4))[..., None]
            shown = _looked_up(hidden, cos_i[..., 0])
            shown *= per_hidden / cos_i
            shown += towards_viewer
            np.reciprocal(shown, out=shown)
            # Nodes come last, (m, k, c, p): products over so short an axis as c's would take three times as long.
            shares = ring.lit * np.maximum(ring.toward, 0) / np.float32(ring.lit.shape[1])
            arriving = np.ascontiguousarray(ring.radiance.transpose(0, 2, 1)) * shares[:, None]
            factor = np.ascontiguousarray(_looked_up(factors, ring.toward).transpose(0, 2, 1))
            seen = factor[:, :, None] * arriving[:, None]
            of_ring = seen.reshape(len(seen), -1, ring.lit.shape[1]) @ shown
            means[:, :, :, place] = np.moveaxis(of_ring.reshape(*of_ring.shape[:2], len(forms), -1), 2, 0)
        found = np.empty((len(frame.normal), len(forms), functions, len(sigmas), channels), np.float32)
        for own in range(len(forms)):
            sums = (weights[own, used, None] * blend).astype(np.float32).reshape(-1, len(sigmas))
            total = means[own].reshape(-1, len(sums)) @ sums
            found[:, own] = total.reshape(-1, functions, channels, len(sigmas)).transpose(0, 1, 3, 2)
        return found

    result = np.empty((len(normals), len(forms), functions, len(sigmas), channels), np.float32)
    fill(result, light, of_chunk)
    return result


def _looked_up(table: Singles, cos: Singles) -> Singles:
    """Rows of a table over cosines from 0 to 1, nearest neighbour: (..., k)."""
    # Steps of 2.4e-4 in the cosine; what they leave averages out over nodes.
    place = np.clip(cos * np.float32(_LOOKUP - 1) + np.float32(0.5), 0, _LOOKUP - 1).astype(np.intp)
    return table.take(place, axis=0)  # several times as fast as table[place]


def _hiding_nodes(sigmas: Floats) -> tuple[Floats, Floats]:
    """Roughnesses (g,) and the weights (g, sigmas) with which what is smooth in log sigma goes over to others."""
    if len(sigmas) <= _HIDING_NODES:
        return sigmas, np.eye(len(sigmas))
    low, high = np.log(sigmas.min()), np.log(sigmas.max())
    angle = (np.arange(_HIDING_NODES) + 0.5) * np.pi / _HIDING_NODES
    position = np.clip(2 * (np.log(sigmas) - low) / (high - low) - 1, -1, 1)
    order = np.arange(_HIDING_NODES)[:, None]
    scale = np.where(order == 0, 1, 2) / _HIDING_NODES
    blend = np.cos(order * angle).T @ (scale * np.cos(order * np.arccos(position)))
    return np.exp(low + (np.cos(angle) + 1) / 2 * (high - low)), blend


def _mirrored(light: PreparedMap, normals: Floats, views: Floats, sigmas: Floats) -> Singles:
    """Phong's lobe over a map, (m, sigmas, c): rings around the mirrored view."""

    def of_chunk(chunk: Chunk) -> Singles:
        axes, towards = normals[chunk.rays], views[chunk.rays]
        frame = RayFrames.of(2 * (axes * towards).sum(axis=1)[:, None] * axes - towards, axes)
        # A half-vector's angle is half of its mirrored one.
        angles = np.minimum(2 * chunk.thetas, np.pi / 2)
        weights = ring_weights(_phong_density, angles, sigmas, light.fineness.log_step)
        used = np.flatnonzero((weights.max(axis=1) > _NEGLIGIBLE * weights.max()) & (angles < np.pi / 2))
        means = [mirror_ring(light, frame, angles[k], chunk.turns[k]) for k in used]
        return np.einsum("mck,kj->mjc", np.stack(means, axis=-1), weights[used].astype(np.float32))

    result = np.empty((len(normals), len(sigmas), light.levels[0].shape[2]), np.float32)
    fill(result, light, of_chunk)
    return result


def _phong_density(angle: Floats, sigmas: Floats) -> Floats:
    exponent = phong_exponent(sigmas)
    return (exponent + 2) / (2 * np.pi) * np.maximum(np.cos(angle), 0) ** exponent


@lru_cache(maxsize=8)
def _uniform_table(
    forms: Sequence[LobeForm], sigmas: Sequence[float], fresnel: FresnelFunctions
) -> tuple[Floats, Singles]:
    """Transfer of unit uniform light against the exitant cosine: (grid,), (grid, forms, k, sigmas, 1)."""
    grid, normals, views = exitant_grid()
    return grid, _map_transfer(forms, _white(), normals, views, np.array(sigmas), fresnel)


@lru_cache(maxsize=1)
def _white() -> PreparedMap:
    return PreparedMap.of(np.ones((4, 8, 1), np.float32))


def _interpolated(grid: Floats, table: Singles, at: Floats) -> Singles:
    """Linearly, along the table's first axis."""
    place = np.interp(at, grid, np.arange(len(grid)))
    below = np.minimum(place.astype(int), len(grid) - 2)
    share = (place - below).astype(np.float32).reshape(-1, *[1] * (table.ndim - 1))
    return (1 - share) * table[below] + share * table[below + 1]
