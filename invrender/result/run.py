"""A photo set that was solved, and the pictures that it predicts."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from capture.blocks import block_means
from capture.decode import decode_photo
from capture.parallel import one_blas_thread, parallel_map
from capture.photo import Photo
from capture.photoset import PhotoSet
from capture.radiance import RadianceImage
from invrender.diagnostics.named import NamedCause
from invrender.estimate.evidence import PictureError, picture_error
from invrender.estimate.interreflection.statement import Interreflection
from invrender.estimate.quantities import PhotoScore, ReferenceScore
from invrender.estimate.solution import Solution
from invrender.estimate.textured.textures import FittedTextures
from invrender.observation.geometry import SceneGeometry
from invrender.result.scores import mean_rms
from invrender.transport.visibility import facing
from recon.mesh.bodies import body_pixels, larger_pixels
from recon.sampling.candidates import WHOLE
from recon.sampling.draw import NO_SOURCES, samples_around, samples_at
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]
Radiance = Callable[[Photo, LightField], Floats]
Pictured = Callable[[Photo, LightField, int], Floats]

# Places in a pixel at the outline that rays go through, in parts of it.
_WITHIN = (np.stack(np.meshgrid(*2 * [np.arange(8)]), axis=-1).reshape(-1, 2) + 0.5) / 8
# Predictions go through a photograph in blocks of this many pixels, or rays at its outline: memory stays small.
_PIXELS_AT_A_TIME, _RAYS_AT_A_TIME = 16_000, 32_000
# About how many pixels an object has in predictions, what is around it included: one of 12 megapixels would show no
# more on a page, and take minutes.
_PREDICTED = 200_000


@dataclass(frozen=True, eq=False)
class Prediction:
    """One photograph beside its prediction: (h, w, 3) float32; `inside` (h, w) marks the object's whole pixels.

    observed, predicted : in pixels of the size that the run predicts; at the outline a pixel is predicted as the share
    of it that shows the object, before black. counted : (h, w), the pixels of the object that errors are of: all that
    are predicted and not saturated, and that the mask, if there is one, calls the object's.
    """

    photo: Photo
    observed: RadianceImage
    predicted: NDArray[np.float32]
    inside: NDArray[np.bool_]
    counted: NDArray[np.bool_]

    @property
    def error(self) -> PictureError:
        """How far the prediction is off."""
        observed, predicted = self.observed.radiance[self.counted], self.predicted[self.counted]
        return picture_error(observed.astype(float), predicted.astype(float))


@dataclass(frozen=True, eq=False)
class Run:
    """A photo set that was solved: what was found, and the pictures that it predicts.

    solution : the numbers; its lightings are all that photographs are under. fields : samples of each photograph, by
    label. residuals : (n, 3) each, photograph less prediction. scores : how well each photograph is explained, in the
    set's order. radiance : of samples (n, 3) in a photograph, as predicted. pictured : the same of many samples in
    pixels so many times as large as the photograph's, off by less than shows. interreflection : light that bounces
    between the object's parts; None where there is none that matters. causes : of what the model leaves beyond noise,
    the best supported first; none where nothing stands out. textures : Kd and Ks over the surface, where they vary;
    those of the solution are then means. references : how well each of known reflectance is explained. seconds : per
    package, added up over threads, and "total", by the clock on the wall; empty while it runs.
    """

    photoset: PhotoSet
    geometry: SceneGeometry
    solution: Solution
    fields: Mapping[str, LightField]
    residuals: Mapping[str, Floats]
    scores: tuple[PhotoScore, ...]
    warnings: tuple[str, ...]
    radiance: Radiance
    pictured: Pictured
    interreflection: Interreflection | None = None
    causes: tuple[NamedCause, ...] = ()
    textures: FittedTextures | None = None
    references: tuple[ReferenceScore, ...] = ()
    seconds: Mapping[str, float] = field(default_factory=dict)

    def rms(self, held_out: bool) -> float | None:
        """Mean over photographs of their relative RMS, or None where there are none of the kind."""
        return mean_rms(self.scores, held_out)

    @cached_property
    def binning(self) -> int:
        """So many pixels of a photograph, across and down, are one of its prediction."""
        photos, body = self.photoset.photos, self.geometry.body
        return max(larger_pixels(body, photo.camera, _PREDICTED) for photo in photos)

    @cached_property
    def _sources(self) -> dict[str, NDArray[np.float64]]:
        """Each lighting's sources, (k, 3) or (k, 4), by its name."""
        return {entry.lighting.name: entry.lighting.sources for entry in self.solution.lightings}

    def predictions(self, photos: Sequence[Photo] | None = None) -> Iterator[Prediction]:
        """Predicted photographs, all in the set's order if none are named, a few at a time in memory."""
        with one_blas_thread():
            yield from parallel_map(self.predict, self.photoset.photos if photos is None else photos)

    def predict(self, photo: Photo) -> Prediction:
        """One photograph beside its prediction."""
        observed = decode_photo(self.photoset.radiometry, photo).noiseless()
        mask = self.geometry.found.mask_of(photo)
        if self.binning > 1:
            observed = observed.binned(self.binning)
            photo = replace(photo, camera=photo.camera.binned(self.binning))
        body = self.geometry.body
        rows, columns = body_pixels(body, photo.camera)
        predicted = np.zeros_like(observed.radiance)
        inside = np.zeros(observed.saturated.shape, bool)
        glints = self._sources[photo.lighting]
        for part in np.array_split(np.arange(len(rows)), len(rows) // _PIXELS_AT_A_TIME + 1):
            pixels = rows[part], columns[part]
            samples = facing(samples_at(body, photo.camera, observed, *pixels, NO_SOURCES, glints))
            samples = samples.through(photo.polariser)
            radiance = self.pictured(photo, samples, self.binning)
            # Pixels with a hole, and where a texture isn't known, are left out.
            known = np.isfinite(radiance).all(axis=1)
            predicted[samples.rows[known], samples.columns[known]] = radiance[known]
            inside[samples.rows[known], samples.columns[known]] = True
        shown = inside
        if mask is not None:
            own = (mask if self.binning == 1 else block_means(mask[..., None], self.binning)[..., 0]) >= WHOLE
            shown = inside & own
            if self.textures is None:
                rows, columns = body_pixels(body, photo.camera, outline=True)
                rows, columns = rows[own[rows, columns]], columns[own[rows, columns]]
                for part in np.array_split(
                    np.arange(len(rows)), len(rows) * len(_WITHIN) // _RAYS_AT_A_TIME + 1
                ):
                    pixels = rows[part], columns[part]
                    predicted[pixels] = self._at_outline(photo, observed, *pixels)
                shown[rows, columns] = True
        return Prediction(photo, observed, predicted, inside, shown & ~observed.saturated)

    def _at_outline(
        self, photo: Photo, observed: RadianceImage, rows: NDArray[np.int64], columns: NDArray[np.int64]
    ) -> NDArray[np.float64]:
        """Radiance (n, 3) of pixels that the object covers partly, by a few rays through each."""
        places = np.column_stack([columns, rows]).repeat(len(_WITHIN), axis=0) + np.tile(
            _WITHIN, (len(rows), 1)
        )
        rays, on_body = samples_around(
            self.geometry.body, photo.camera, observed, places.astype(float), across=False
        )
        radiance = np.zeros((len(places), 3))
        if on_body.any():
            rays = facing(rays).through(photo.polariser)
            radiance[on_body] = self.pictured(photo, rays, self.binning)
        return radiance.reshape(len(rows), len(_WITHIN), 3).mean(axis=1)


@dataclass(frozen=True, eq=False)
class TexturedRun(Run):
    """A set whose Kd and Ks vary over a mesh.

    transfers : what Kd = 1 and Ks = 1 would show of samples, (n, 3) each. shaded : what rays of given Kd and Ks, (m, 3)
    each, would show, (n, 3), for many.
    """

    transfers: Callable[[Photo, LightField], tuple[Floats, Floats]] = field(kw_only=True)
    shaded: Callable[[Photo, LightField, Floats, Floats], Floats] = field(kw_only=True)


def pixel_by_pixel(radiance: Radiance) -> Pictured:
    """Pictures made of the radiance itself, where that takes no longer for many samples."""
    return lambda photo, field, binning: radiance(photo, field)
