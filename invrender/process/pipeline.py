"""The main job: a photo set in, a factorization and predicted photographs out. No terminal, no result files."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from capture.blocks import block_means
from capture.decode import decode_photo
from capture.parallel import one_blas_thread, parallel_map
from capture.photoset import Photo, PhotoSet
from capture.progress import Track, silent
from capture.radiance import RadianceImage
from invrender.estimate.evidence import PictureError, picture_error
from invrender.observation.clock import Clock
from invrender.observation.geometry import SceneGeometry, find_geometry
from invrender.process.known_light import solve_known_light
from invrender.process.solved import Solved
from invrender.process.textured import solve_textured
from invrender.process.unknown_light import solve_unknown_light
from invrender.process.unknown_texture import solve_unknown_texture
from invrender.result.factorization import Factorization
from invrender.transport.visibility import facing
from recon.mesh.bodies import MeshBody, body_pixels, larger_pixels
from recon.sampling.draw import NO_SOURCES, WHOLE, samples_around, samples_at
from recon.sampling.lightfield import LightField

DEFAULT_SAMPLES = 60_000
# Places in a pixel at the outline that rays go through, in parts of it.
_WITHIN = (np.stack(np.meshgrid(*2 * [np.arange(8)]), axis=-1).reshape(-1, 2) + 0.5) / 8
# Predictions go through a photograph in blocks of this many pixels, or rays at its outline: memory stays small.
_PIXELS_AT_A_TIME, _RAYS_AT_A_TIME = 4_000, 32_000
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
    """A finished run. seconds : per package, added up over threads, and "total", by the clock on the wall."""

    photoset: PhotoSet
    geometry: SceneGeometry
    solved: Solved
    seconds: dict[str, float]

    @property
    def result(self) -> Factorization:
        return self.solved.result

    @property
    def fields(self) -> Mapping[str, LightField]:
        """The samples of each photograph, by label."""
        return self.solved.fields

    @cached_property
    def binning(self) -> int:
        """So many pixels of a photograph, across and down, are one of its prediction."""
        photos, body = self.photoset.photos, self.geometry.body
        return max(larger_pixels(body, photo.camera, _PREDICTED) for photo in photos)

    @cached_property
    def _sources(self) -> dict[str, NDArray[np.float64]]:
        """Directions (k, 3) of each lighting's sources, by its name."""
        return {entry.lighting.name: entry.lighting.directions for entry in self.result.lightings}

    def predictions(self) -> Iterator[Prediction]:
        """Predicted photographs in the set's order, a few at a time in memory."""
        with one_blas_thread():
            yield from parallel_map(self._predict, self.photoset.photos)

    def _predict(self, photo: Photo) -> Prediction:
        observed, mask = decode_photo(self.photoset, photo), self.geometry.found.mask_of(photo)
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
            radiance = self._radiance(photo, samples)
            # Pixels with a hole, and where a texture isn't known, are left out.
            known = np.isfinite(radiance).all(axis=1)
            predicted[samples.rows[known], samples.columns[known]] = radiance[known]
            inside[samples.rows[known], samples.columns[known]] = True
        shown = inside
        if mask is not None:
            own = (mask if self.binning == 1 else block_means(mask[..., None], self.binning)[..., 0]) >= WHOLE
            shown = inside & own
            if self.result.textures is None:
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
            radiance[on_body] = self._radiance(photo, facing(rays))
        return radiance.reshape(len(rows), len(_WITHIN), 3).mean(axis=1)

    def _radiance(self, photo: Photo, samples: LightField) -> NDArray[np.float64]:
        """Radiance (n, 3) of samples; paint is the mean around each ray, across which light varies little."""
        textures, shaded, body = self.result.textures, self.solved.shaded, self.geometry.body
        if textures is None:
            return (self.solved.pictured or self.solved.radiance)(photo, samples)
        assert shaded is not None
        assert isinstance(body, MeshBody)
        # Paint may be as fine as the photograph's own pixels: a ray to each across, and one more.
        return shaded(photo, samples, *textures.around(body, photo.camera, samples, self.binning + 1))


def process(
    photoset: PhotoSet, samples: int = DEFAULT_SAMPLES, track: Track = silent, shadowing: bool = True
) -> Run:
    """Recover the BRDF of an object, and what of its lighting is free, from a photo set.

    samples : about how many pixels of all photographs together enter the fit. shadowing : False leaves the
    shadows of a mesh on itself out, to show what they amount to.
    """
    with one_blas_thread():
        return _process(photoset, samples, track, shadowing)


def _process(photoset: PhotoSet, samples: int, track: Track, shadowing: bool) -> Run:
    begun = time.perf_counter()
    clock = Clock()
    _check_scope(photoset, [photo for photo in photoset.photos if not photo.held_out])
    with clock.on("recon"):
        geometry = find_geometry(photoset, track, shadowing)
    unknown = {table.name for table in photoset.lightings if table.unknown}
    given = photoset, geometry, samples, clock, track
    if unknown & {photo.lighting for photo in photoset.photos}:
        solved = (solve_unknown_texture if photoset.object.texture else solve_unknown_light)(*given)
    else:
        solved = (solve_textured if photoset.object.texture else solve_known_light)(*given)
    return Run(photoset, geometry, solved, {**clock.seconds, "total": time.perf_counter() - begun})


def _check_scope(photoset: PhotoSet, fitted: Sequence[Photo]) -> None:
    where = photoset.manifest
    if photoset.object.texture and photoset.object.shape != "mesh":
        raise ValueError(
            f"{where}: [object] texture = true is for meshes, whose surface has coordinates; remove it, or give the"
            " sphere as a mesh"
        )
    if len(fitted) < 2:
        raise ValueError(
            f"{where}: has {len(fitted)} photo(s) to fit; at least two are needed, so that a model can be judged on"
            " a photo it has not seen: add photographs from other sides or under other light"
        )
