"""Light that reaches a point by way of other points: interreflection, followed along random paths.

    B_indirect(x) = integral of rho(wi, wo) B(y(x, wi)) cos(theta_i) dwi    over directions in which it is met

Paths start where the camera looks, go on in directions drawn from the material, and at every further point take up
what the lights give there directly (Kajiya, "The rendering equation", 1986). Unbiased; what `gather` counts, the
light that no part of the surface stands before, is left out.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from synthetic.lights.illumination import Illumination
from synthetic.materials.material import Material, cosine_density, sample_cosine
from synthetic.render.gather import direct_light
from synthetic.shapes.surface import Points, Surface
from synthetic.vectors import local_frame, to_local, to_world

Floats = NDArray[np.float64]


def indirect_light(
    surface: Surface,
    material: Material,
    illumination: Illumination,
    points: Points,
    views: Floats,
    bounces: int,
    rng: np.random.Generator,
) -> Floats:
    """Radiance (n, 3) towards viewers in directions views (n, 3) after 1 to `bounces` further reflections.

    One path per point: means over many points that are alike, such as a pixel's, are what is meant to be used.
    """
    radiance = np.zeros((len(points), 3))
    carried = np.ones((len(points), 3))
    alive = np.arange(len(points))
    for _ in range(bounces):
        directions, factors = _continued(material, points, views, rng)
        carried = carried * factors
        useful = carried.any(axis=1) & ((directions * points.facets).sum(axis=1) > 0)
        directions, alive, carried = directions[useful], alive[useful], carried[useful]
        hit, met = surface.first_hits(points.positions[useful], directions, points.facets[useful])
        alive, carried, points, views = alive[hit], carried[hit], met, -directions[hit]
        if not len(points):
            break
        kd, ks = material.weights(points.uv)
        lattices = rng.random((len(points), 1, 2))
        irradiance, lobe = direct_light(surface, material, illumination, points, views, lattices, rng)
        radiance[alive] += carried * (kd * irradiance + ks * lobe)
    return radiance


def _continued(
    material: Material, points: Points, views: Floats, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """Directions (n, 3) in which paths go on, and rho cos / density of each (n, 3)."""
    count = len(points)
    frames = local_frame(points.normals, points.tangents)
    wo = to_local(frames, views)
    kd, ks = material.weights(points.uv)
    # The base and the lobe are drawn about as often as they reflect.
    base, gloss = np.pi * kd.mean(axis=1), ks.mean(axis=1)
    share = np.where(gloss > 0, np.maximum(gloss / np.maximum(base + gloss, 1e-300), 0.1), 0.0)
    share[(base == 0) & (gloss > 0)] = 1.0
    glossy = rng.random(count) < share
    u = rng.random((count, 2))
    local = np.where(glossy[:, None], material.sample(wo, u), sample_cosine(u))
    cos_i = local[:, 2]
    valid = (cos_i > 0) & (wo[:, 2] > 0)
    if material.is_mirror:
        factors = np.where(
            glossy[:, None],
            ks * material.mirrored(wo) / np.maximum(share, 1e-300)[:, None],
            np.pi * kd / np.maximum(1 - share, 1e-300)[:, None],
        )
    else:
        density = share * material.density(local, wo) + (1 - share) * cosine_density(local)
        brdf = kd + ks * material.lobe(local, wo)
        factors = brdf * (cos_i / np.maximum(density, 1e-300))[:, None]
    factors = np.where(valid[:, None], factors, 0.0)
    return np.asarray(to_world(frames, local), float), factors
