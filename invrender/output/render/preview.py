"""Quick pictures: the light prefiltered once, a lookup per pixel [R02, section 5.7.5].

At grazing views lobes are streaks, which low orders hold badly, and what a map is off by is multiplied by Fresnel's
factor over a cosine. A ball has one pixel in nine there: those are integrated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from capture.camera import Camera
from capture.lighting import Lighting
from invrender.brdf.microfacet import Microfacet
from invrender.output.render.light import light_element
from invrender.output.render.photographer import Photographer
from invrender.output.render.picture import Picture
from invrender.output.render.subject import Subject
from invrender.prefilter.centred import CentredBrdf, CentredLobe
from invrender.prefilter.prefiltered import PrefilteredLight, prefilter
from invrender.transport.centred_lobes import centred_microfacet
from invrender.transport.shading import shade
from invrender.transport.transfer import LightElement
from recon.mesh.bodies import body_window
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]

# From this angle between view and normal on radiance is integrated.
_STEEP_DEG = 70


@dataclass(frozen=True, eq=False)
class Previewer:
    """Takes pictures of a subject by reflection maps: one ray per pixel, no shadows, no light between its parts.

    brdf : the material as lobes about their own centres. found : the light's map, prefiltered for it; None where there
    are sources alone, which need no maps.
    """

    subject: Subject
    material: Microfacet
    brdf: CentredBrdf
    lighting: Lighting
    found: PrefilteredLight | None

    def take(self, camera: Camera, light_turn: float = 0.0) -> Picture:
        """The picture from a camera, the light turned about +Z by so many degrees; ValueError where it sees nothing."""
        top, left, bottom, right = body_window(self.subject.body, camera)
        rows, columns = (each.ravel() for each in np.mgrid[top:bottom, left:right])
        hits = self.subject.body.hits(camera, np.column_stack([columns, rows]) + 0.5)
        if not hits.hit.any():
            raise ValueError(
                f"the camera at {camera.centre.round(4).tolist()} m sees nothing of the object: it is inside it, or"
                " looks past it"
            )
        pixels = rows[hits.hit], columns[hits.hit]
        radiance = np.zeros((camera.height, camera.width, 3), np.float32)
        coverage = np.zeros(radiance.shape[:2], np.float32)
        radiance[pixels] = self._reflected(hits.normals[hits.hit], hits.views[hits.hit], light_turn)
        coverage[pixels] = 1
        return Picture(radiance, coverage, None)

    @property
    def stated(self) -> str:
        """What the maps' own theory says of their error, a sentence."""
        if self.found is None:
            return "Sources alone: exact for each pixel's middle."
        bound = self.found.bound.up_to(_STEEP_DEG)
        reflected = np.maximum(bound.picture_reflected, np.finfo(float).tiny)
        rms, most = ((part / reflected).max() for part in (bound.picture_rms, bound.picture_largest))
        between = max(each.between_pixels for each in self.found.lobes)
        return (
            f"Up to {_STEEP_DEG} degrees from the normal a ball in the map's light is off by {rms:.1%} (RMS over pixels"
            f" and views), in no view by more than {most:.0%}, and between the maps' pixels by up to {between:.1%} of"
            " the largest value more; steeper views are integrated."
        )

    def _reflected(self, normals: Floats, views: Floats, light_turn: float) -> Floats:
        """Radiance (n, 3) of normals seen from views, (n, 3) each, unit."""
        angle = np.radians(light_turn)
        # In place of the light, what it falls on is turned, the other way.
        about_z = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
        normals, views = normals @ about_z, views @ about_z
        steep = (normals * views).sum(axis=1) < np.cos(np.radians(_STEEP_DEG))
        if self.found is None:
            steep[:] = False
        total = np.zeros_like(normals)
        total[steep] = self._integrated(normals[steep], views[steep])
        normals, views = normals[~steep], views[~steep]
        quick = np.zeros_like(normals) if self.found is None else self.found.radiance(normals, views)
        for direction, irradiance in zip(self.lighting.directions, self.lighting.irradiances, strict=True):
            quick = quick + irradiance * _of_source(self.brdf.lobes, normals, direction, views)
        # Low orders ring below zero; light doesn't.
        total[~steep] = np.maximum(quick, 0)
        return total

    def _integrated(self, normals: Floats, views: Floats) -> Floats:
        """Radiance (n, 3) as pictures that aren't previews have it, without shadows."""
        each, nothing = np.arange(len(normals)), np.zeros_like(normals)
        field = LightField(
            rows=each,
            columns=each,
            radiance=nothing,
            variance=nothing,
            weight=np.ones(len(each)),
            ray_sample=each,
            positions=nothing,
            normals=normals,
            views=views,
            reflected_visible=np.ones(len(each), bool),
            sources_visible=np.zeros((len(each), 0), bool),
        )
        return shade(self.material, self._element, field, None) if len(each) else nothing

    @cached_property
    def _element(self) -> LightElement:
        return light_element(self.lighting)


def previewer(studio: Photographer, epsilon: float = 0.03) -> Previewer:
    """What takes quick pictures of a photographer's subject, near lamps as from afar. epsilon : as in `prefilter`.

    ValueError where Kd and Ks vary over the subject, the BRDF is black or its lobe too narrow for maps.
    """
    if studio.material.textures is not None:
        raise ValueError("--preview: the result's Kd and Ks vary over its object; give --mean for the means")
    lighting, found = studio.lighting.from_afar, None
    try:
        brdf = centred_microfacet(studio.material.brdf, studio.result.content.name)
        if lighting.radiance_map is not None:
            found = prefilter(lighting.radiance_map, brdf, epsilon, is_absolute=studio.result.is_absolute)
    except ValueError as error:
        raise ValueError(f"--preview: {error}; or leave --preview out") from error
    return Previewer(studio.subject, studio.material.brdf, brdf, lighting, found)


def _of_source(lobes: Sequence[CentredLobe], normals: Floats, direction: Floats, views: Floats) -> Floats:
    """What lobes reflect (n, 3) of a source of unit irradiance, to rounding."""
    total = np.zeros_like(normals)
    for each in lobes:
        values = np.stack([of(normals, direction, views) for of in each.lobes], axis=1)
        factor = each.factor((normals * views).sum(axis=1))
        total += values * each.strength * factor[:, None]
    return total
