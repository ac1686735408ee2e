"""BRDF under known light: a simplex over mu and sigma, Kd and Ks solved linearly [RH01, section 6.1, eq. 24]."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture.lighting import Lighting
from invrender.brdf.fresnel import normalised_fresnel
from invrender.brdf.microfacet import SIGMA_RANGE, Microfacet, sigma_nodes, sigma_weights
from invrender.estimate.rh01.simplex import MU_BOUNDS, root_weight, simplex
from invrender.theory.lambertian import irradiance
from invrender.theory.specialcases import microfacet_gaussian
from invrender.transport.lobe_table import Transfer, mirrored_harmonics
from invrender.transport.transfer import LightElement, diffuse_transfer, specular_transfer
from invrender.transport.visibility import Shadows
from recon.harmonics.complex import project_sources
from recon.harmonics.latlong import map_coefficients
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]

# Degrees of the slow light in the mirror direction, and in eq. 21.
_SLOW_DEGREE, _DIFFUSE_DEGREE = 30, 2
_START_SIGMA, _START_MU = 0.15, 1.5


@dataclass(frozen=True, eq=False)
class PublishedBRDF:
    """What section 6.1 finds under known light. rms : of the residuals over that of the radiance."""

    brdf: Microfacet
    rms: float


def published_brdf(
    photos: Sequence[LightField],
    lighting: Lighting,
    transfer: Transfer = "filtered",
    fresnel: bool = True,
    shadows: Shadows | None = None,
) -> PublishedBRDF:
    """BRDF of a body under known light by the nested procedure of [RH01, section 6.1].

    lighting : its map is the slow part [eq. 22], its sources the fast one [eq. 23]; the diffuse part goes to degree 2
    [eq. 21]. transfer : `filtered` is the paper's [eq. 20]; `mirror` doesn't blur the map; `exact` integrates the lobe
    over it. fresnel : False leaves mu out, as the paper does for metals. shadows : of a mesh on itself, for which
    mirror directions and sources are tested [RH01, section 6.4]; None of a convex body.
    """
    prepared = [_Prepared.of(photo, lighting, transfer, shadows) for photo in photos]
    seen = np.concatenate([entry.root * entry.field.radiance for entry in prepared])

    def solved(point: Floats) -> tuple[float, Microfacet]:
        sigma = float(np.exp(point[0]))
        mu = 1 + float(np.exp(point[1])) if fresnel else None
        columns = np.concatenate([entry.columns(mu, sigma) for entry in prepared])
        found = np.stack([np.linalg.lstsq(columns[:, c], seen[:, c], rcond=None)[0] for c in range(3)])
        left = seen - np.einsum("nck,ck->nc", columns, found)
        rms = float(np.sqrt((left**2).sum() / (seen**2).sum()))
        kd, ks = np.maximum(found, 0).T
        return rms, Microfacet(kd, ks, mu, sigma)

    start = np.log([_START_SIGMA, _START_MU - 1])[: 1 + fresnel]
    bounds = np.array([np.log(SIGMA_RANGE), MU_BOUNDS])[: 1 + fresnel]
    rms, brdf = solved(simplex(lambda point: solved(point)[0], start, bounds))
    return PublishedBRDF(brdf, rms)


@dataclass(frozen=True, eq=False)
class _Prepared:
    """A photograph of n samples and m rays, with what holds neither mu nor sigma.

    diffuse : (m, 3), irradiance. slow : (m, k, 3), which add up to L_slow(R) by weights (k,) of sigma. fast : sources,
    and visible : (m,) whether each is. root : (n, 1), of the samples' weights.
    """

    field: LightField
    cos: Floats
    diffuse: Floats
    slow: Floats
    slow_weights: Callable[[float], Floats]
    fast: Sequence[tuple[LightElement, NDArray[np.bool_]]]
    root: Floats

    @staticmethod
    def of(field: LightField, lighting: Lighting, transfer: Transfer, shadows: Shadows | None) -> _Prepared:
        sources = [
            LightElement("source", direction[None], irradiance[None])
            for direction, irradiance in zip(lighting.directions, lighting.irradiances, strict=True)
        ]
        slow, weights = _slow_parts(field, lighting, transfer)
        visible = [np.ones(len(field.normals), bool)] * len(sources)
        if shadows is not None:
            slow = slow * field.reflected_visible[:, None, None]
            visible = [shadows.free(field, source.directions[0]) for source in sources]
        fast = list(zip(sources, visible, strict=True))
        return _Prepared(
            field,
            np.einsum("nk,nk->n", field.normals, field.views),
            _diffuse(field, lighting, fast, shadows),
            slow,
            weights,
            fast,
            root_weight(field)[:, None],
        )

    def columns(self, mu: float | None, sigma: float) -> Floats:
        """What unit Kd and unit Ks send to the samples, (n, 3, 2), times the root of their weights."""
        lobe = np.einsum("mkc,k->mc", self.slow, self.slow_weights(sigma))
        for source, visible in self.fast:
            seen = specular_transfer(source, self.field.normals, self.field.views, np.array([sigma]))[:, 0]
            lobe += visible[:, None] * seen
        lobe *= normalised_fresnel(mu, self.cos)[:, None]
        mean = self.field.mean_over_rays(np.stack([self.diffuse, lobe], axis=-1))
        return np.asarray(self.root[:, :, None] * mean)


def _diffuse(
    field: LightField,
    lighting: Lighting,
    fast: Sequence[tuple[LightElement, NDArray[np.bool_]]],
    shadows: Shadows | None,
) -> Floats:
    """Irradiance (m, 3) at rays: of nine coefficients [eq. 21]; on a mesh, of the map and of visible sources."""
    sky = np.zeros(((_DIFFUSE_DEGREE + 1) ** 2, 3))
    if lighting.radiance_map is not None:
        sky = map_coefficients(lighting.radiance_map, _DIFFUSE_DEGREE)
    if shadows is None:
        return irradiance(
            field.normals, sky + project_sources(lighting.directions, lighting.irradiances, _DIFFUSE_DEGREE)
        )
    total = np.maximum(irradiance(field.normals, sky) - shadows.hidden(field, sky), 0)
    for source, visible in fast:
        total += visible[:, None] * diffuse_transfer(source, field.normals)
    return total


def _slow_parts(
    field: LightField, lighting: Lighting, transfer: Transfer
) -> tuple[Floats, Callable[[float], Floats]]:
    """L_slow(R) of each ray in parts (m, k, 3), and the weights (k,) by which a sigma adds them up."""
    if lighting.radiance_map is None:
        return np.zeros((len(field.normals), 1, 3)), lambda sigma: np.ones(1)
    if transfer == "exact":
        slow = LightElement("slow", np.zeros((0, 3)), np.zeros((0, 3)), lighting.radiance_map)
        return specular_transfer(slow, field.normals, field.views, sigma_nodes()), sigma_weights
    coefficients = map_coefficients(lighting.radiance_map, _SLOW_DEGREE)
    at_mirror = mirrored_harmonics(field, _SLOW_DEGREE)
    bands = [slice(l * l, (l + 1) ** 2) for l in range(_SLOW_DEGREE + 1)]
    parts = np.stack([at_mirror[:, band] @ coefficients[band] for band in bands], axis=1)
    if transfer == "mirror":
        return parts.sum(axis=1, keepdims=True), lambda sigma: np.ones(1)
    return parts, lambda sigma: microfacet_gaussian(sigma, _SLOW_DEGREE)
