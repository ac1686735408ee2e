"""What a solved textured mesh is predicted to show of samples, ray by ray and in pictures."""

from __future__ import annotations

from dataclasses import dataclass, replace
from dataclasses import field as defaulted

import numpy as np
from numpy.typing import NDArray

from capture.photo import Photo
from invrender.brdf.microfacet import Microfacet
from invrender.estimate.textured.textures import FittedTextures
from invrender.process.texture_passes import TextureBench
from invrender.transport.predict import predict
from invrender.transport.reflected import ReflectedMap, prepared_map
from invrender.transport.shading import shade
from recon.mesh.bodies import MeshBody
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class TexturedPictures:
    """Radiance of a textured mesh under its lightings, with what its parts send each other.

    body : the mesh. brdf : what all its points share.
    """

    bench: TextureBench
    body: MeshBody
    brdf: Microfacet
    textures: FittedTextures
    # Of the lightings that were asked for, by name: `prepared_map` keeps the last two only.
    _prepared: dict[str, ReflectedMap | None] = defaulted(default_factory=dict, repr=False)

    def radiance(self, photo: Photo, field: LightField) -> Floats:
        """Of samples (n, 3) in a photograph; NaN where the texture isn't known."""
        own, elements = self._with(*self.textures.at(field)), self.bench.elements[photo.lighting]
        shown = predict(own, elements, np.ones((len(elements), 3)), field, self.bench.shadows)
        bounced = self.bench.bounced.get(photo.lighting)
        return shown if bounced is None else shown + bounced.radiance(field, own)

    def transfers(self, photo: Photo, field: LightField) -> tuple[Floats, Floats]:
        """What Kd = 1 and Ks = 1 would show of samples, (n, 3) each."""
        (d, s), (more_d, more_s) = (
            of(photo.lighting, field, self.brdf) for of in (self.bench.direct, self.bench.by_mesh)
        )
        return (d + more_d).astype(float), (s + more_s).astype(float)

    def shaded(self, photo: Photo, field: LightField, kd: Floats, ks: Floats) -> Floats:
        """What rays of given Kd and Ks, (m, 3) each, would show, (n, 3), for many."""
        # All that is known of a lighting is one element. Its map integrated pixel by pixel takes twenty times as long.
        element, bounced = self.bench.elements[photo.lighting][0], self.bench.bounced.get(photo.lighting)
        if photo.lighting not in self._prepared:
            self._prepared[photo.lighting] = prepared_map(self.brdf, element)
        light = self._prepared[photo.lighting]
        return shade(self._with(kd, ks), element, field, self.bench.shadows, light, bounced)

    def pictured(self, photo: Photo, field: LightField, binning: int) -> Floats:
        """Of many samples (n, 3) in pixels so many times as large as the photograph's."""
        # Albedo is the mean around each ray, across which light varies little. It may be as fine as the photograph's
        # own pixels: a ray to each across, and one more.
        return self.shaded(photo, field, *self.textures.around(self.body, photo.camera, field, binning + 1))

    def _with(self, kd: Floats, ks: Floats) -> Microfacet:
        return replace(self.brdf, kd=kd, ks=ks)
