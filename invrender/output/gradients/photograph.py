"""The gradients of one predicted photograph: its pixels, what they see, and the terms there."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from capture.camera import Camera
from capture.radiance import RadianceImage
from invrender.gradients.predicted import MaterialRays, PixelCross, nearness, predicted_terms
from invrender.gradients.surface import GradientTerms
from invrender.output.render.subject import Subject
from invrender.result.reflectance import Reflectance
from invrender.transport.transfer import LightElement
from invrender.transport.visibility import facing
from recon.mesh.bodies import body_window, larger_pixels
from recon.sampling.draw import MIN_COS_EXITANT, samples_around

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# The middle of a pixel, and its sides' middles: before and after it, to the right and down.
_POINTS: Floats = np.array([(0.0, 0.0), (-0.5, 0.0), (0.5, 0.0), (0.0, -0.5), (0.0, 0.5)])


@dataclass(frozen=True, eq=False)
class PhotoGradients:
    """Gradients at n pixels of a predicted photograph, every `stride`-th to the right and down.

    first : row and column, in the photograph, of the first pixel. shape : of the picture of these pixels. rows,
    columns : (n,), in it. terms, difference : (n, 2, 3), radiance per pixel of the photograph (`predicted_terms`).
    nearness : (n,), 1 / d over 2 k. curvature : (n,), 1 / metres.
    """

    first: tuple[int, int]
    stride: int
    shape: tuple[int, int]
    rows: Ints
    columns: Ints
    terms: GradientTerms
    difference: Floats
    nearness: Floats
    curvature: Floats

    @property
    def remainder(self) -> Floats:
        """What the terms lack of the difference across each pixel, (n, 2, 3): it isn't of first order."""
        return self.difference - self.terms.whole

    @property
    def middles(self) -> Floats:
        """Image points (n, 2) of the pixels' middles, in the photograph."""
        top, left = self.first
        return np.asarray(
            np.column_stack([left + self.stride * self.columns, top + self.stride * self.rows]) + 0.5, float
        )

    def picture(self, values: Floats, blank: float = 0.0) -> NDArray[np.float32]:
        """Values of the pixels (n, ...) as a picture (h, w, ...)."""
        result = np.full((*self.shape, *values.shape[1:]), blank, np.float32)
        result[self.rows, self.columns] = values
        return result


def photo_gradients(
    subject: Subject, camera: Camera, reflectance: Reflectance, element: LightElement, count: int
) -> PhotoGradients:
    """Gradients at about `count` pixels of what a camera sees of a subject; ValueError where it sees none of it whole.

    Pixels at the outline, at edges, and where the surface is seen at more than 84 degrees are left out.
    """
    stride = larger_pixels(subject.body, camera, count)
    top, left, bottom, right = body_window(subject.body, camera)
    # Half a pixel further on must be a pixel of the photograph, too.
    down = np.arange(max(top, 1), min(bottom, camera.height - 1), stride)
    along = np.arange(max(left, 1), min(right, camera.width - 1), stride)
    rows, columns = (of.ravel() for of in np.meshgrid(down, along, indexing="ij"))
    geometry = subject.body.pixel_geometry(camera, rows, columns)
    kept = np.flatnonzero(geometry.whole & (geometry.cos > MIN_COS_EXITANT))
    kept, cross = _crossed(subject, camera, reflectance, rows, columns, kept)
    if not len(kept):
        raise ValueError(
            f"the camera at {camera.centre.round(4).tolist()} m sees no pixel that lies on the object as a whole: it"
            " is too far away, inside it, or looks past it"
        )
    terms, difference = predicted_terms(cross, element, subject.shadows)
    return PhotoGradients(
        (int(down[0]), int(along[0])),
        stride,
        (len(down), len(along)),
        *np.divmod(kept, len(along)),
        terms,
        difference,
        nearness(cross, element, subject.shadows),
        cross.curvature,
    )


def _crossed(
    subject: Subject, camera: Camera, reflectance: Reflectance, rows: Ints, columns: Ints, kept: Ints
) -> tuple[Ints, PixelCross]:
    """Which of the pixels `kept` the body and its textures cover at all five points, and the rays there."""
    image = RadianceImage.black(camera.height, camera.width)
    middles = np.column_stack([columns, rows])[kept] + 0.5
    found = [samples_around(subject.body, camera, image, middles + off, across=False) for off in _POINTS]
    everywhere = np.all([complete for _, complete in found], axis=0)
    brdfs = [reflectance.brdf] * len(found)
    if reflectance.textures is not None:
        painted = [subject.ray_reflectance(reflectance.textures, camera, middles + off) for off in _POINTS]
        everywhere &= np.all([rays.known for rays in painted], axis=0)
        brdfs = [
            replace(reflectance.brdf, kd=rays.kd[everywhere], ks=rays.ks[everywhere]) for rays in painted
        ]
    middle, left, right, above, below = (
        MaterialRays(facing(field.where(everywhere[complete])), brdf)
        for (field, complete), brdf in zip(found, brdfs, strict=True)
    )
    return kept[everywhere], PixelCross(middle, ((left, right), (above, below)))
