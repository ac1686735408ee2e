"""A photograph's object as a harmonic BRDF would show it, cut out of the picture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture.decode import decode_photo
from capture.photo import Photo
from invrender.inverse_brdf.harmonic import HarmonicBRDF
from invrender.inverse_brdf.observe import Observations
from recon.mesh.bodies import body_pixels, body_window
from recon.sampling.draw import NO_SOURCES, samples_at
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Rendering:
    """All pixels of the object in one photograph. window : top, left, bottom, right. towards : (3,), to the camera."""

    field: LightField
    window: tuple[int, int, int, int]
    shape: tuple[int, ...]
    towards: Floats

    @staticmethod
    def of(seen: Observations, photo: Photo) -> Rendering:
        """The pixels of a photograph of a set."""
        observed = decode_photo(seen.photoset.radiometry, photo)
        places = body_pixels(seen.body, photo.camera)
        field = samples_at(seen.body, photo.camera, observed, *places, NO_SOURCES)
        towards = field.views.mean(axis=0)
        towards /= np.linalg.norm(towards)
        return Rendering(field, body_window(seen.body, photo.camera), observed.radiance.shape, towards)

    def cut(self, radiance: NDArray[np.floating]) -> NDArray[np.floating]:
        """The part (h, w, 3) of a picture of the photograph's size that holds the object."""
        top, left, bottom, right = self.window
        return radiance[top:bottom, left:right]

    def of_brdf(self, brdf: HarmonicBRDF, light: Floats) -> NDArray[np.floating]:
        """The object (h, w, 3) under lighting of coefficients ((l_max + 1)^2, 3); black around it."""
        picture = np.zeros(self.shape)
        values = brdf.radiance(light, self.field.normals, self.field.views)
        picture[self.field.rows, self.field.columns] = self.field.mean_over_rays(values)
        return self.cut(picture)
