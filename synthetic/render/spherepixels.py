"""Pixels of a sphere under lights with smooth integrals: fewer directions, as good.

RH01's lobe under area lights and directional sources is integrated by `lobes`, which converges exponentially, for
points so many per pixel as its curvature asks for. `gather` does the same by plain sums, and is what it is tested by.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from capture.camera import Camera
from synthetic.lights.arealight import AreaLight
from synthetic.lights.illumination import Illumination
from synthetic.lights.sources import DirectionalSource
from synthetic.materials.material import Material
from synthetic.materials.microfacet import MicrofacetMaterial
from synthetic.render.lobes import reflected_radiance
from synthetic.render.pixels import looked_at
from synthetic.render.specular_table import node_count
from synthetic.shapes.ball import Ball
from synthetic.shapes.surface import Surface
from synthetic.vectors import sums_by_row

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# A pixel's mean is taken over Gauss-Legendre points, 2 to 6 per side: so many that the normal turns by at most
# this from one to the next, radians. (Midpoints, 2 per side, have only 3/4 of a pixel's second moment; the
# missing blur shows as a highlight that is too narrow: 0.1% in sigma at 45 px radius.)
_TURN_PER_SUBSAMPLE = 0.015
_FEWEST_SUBSAMPLES, _MOST_SUBSAMPLES = 2, 6
# `lobes` is good to 1e-4 for area lights no narrower than so many sigma.
_NARROWEST_LIGHT = 2.0
# A table serves where it has fewer nodes than this share of the points that are looked at.
_SHARED = 0.5


def sphere_means(
    surface: Surface,
    material: Material,
    illumination: Illumination,
    camera: Camera,
    pixels: Ints,
    cameras: int = 1,
) -> Floats | None:
    """Mean radiance (n, 3) over pixels (n, 2), (column, row); what misses the sphere is black.

    None where it doesn't apply: to other surfaces, materials and lights. cameras : how many photographs like this one
    there are: many share tables of their integrals.
    """
    areas = [light for light in illumination.extended if isinstance(light, AreaLight)]
    sources = [source for source in illumination.sources if isinstance(source, DirectionalSource)]
    if not (isinstance(surface, Ball) and type(material) is MicrofacetMaterial):
        return None
    if len(areas) < len(illumination.extended) or len(sources) < len(illumination.sources):
        return None
    if any(light.width_rad < _NARROWEST_LIGHT * material.sigma for light in areas):
        return None
    origins, directions = camera.rays(pixels + 0.5)
    hit, points = surface.first_hits(origins, directions)
    cos_o = np.full(len(pixels), 1e-3)
    cos_o[hit] = np.maximum(-(points.normals * directions[hit]).sum(axis=1), 1e-3)
    radius = surface.sphere.pixel_radius(camera)
    turn = 1 / (radius * cos_o)
    nodes = sum(node_count(material.sigma, width) for width in {light.width_rad for light in areas})
    tabled = nodes < _SHARED * cameras * np.pi * radius**2 * _FEWEST_SUBSAMPLES**2
    per_side = np.clip(np.ceil(turn / _TURN_PER_SUBSAMPLE), _FEWEST_SUBSAMPLES, _MOST_SUBSAMPLES).astype(int)
    total = np.zeros((len(pixels), 3))
    for count in np.unique(per_side):
        chosen = np.flatnonzero(per_side == count)
        pixel, _, weight, points, views = looked_at(surface, camera, pixels[chosen], count)
        radiance = reflected_radiance(material, areas, sources, points.normals, views, tabled=tabled)
        total[chosen] = sums_by_row(pixel, weight[:, None] * radiance, len(chosen))
    return total
