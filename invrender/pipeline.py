"""The main job: a photo set in, a factorization and predicted photographs out. No terminal, no result files."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from capture.decode import decode_photo
from capture.lighting import Lighting
from capture.parallel import one_blas_thread, parallel_map
from capture.photoset import Photo, PhotoSet
from capture.progress import Track, silent
from capture.radiance import RadianceImage
from invrender.factorization import Factorization, FittedLighting, PhotoScore
from invrender.findings import find_warnings
from invrender.model.columns import PhotoColumns, photo_columns
from invrender.model.predict import predict, predict_columns
from invrender.model.transfer import LightElement, light_elements
from invrender.solve.evidence import fit_strengths, ladder_steps, relative_rms
from invrender.solve.factorize import Solution, factorize
from recon.bodies import SphereBody, body_pixels
from recon.findsphere import find_sphere, sphere_mask
from recon.knownlight import read_lighting
from recon.lightfield import LightField, off_terminators
from recon.sampling import NO_SOURCES, sample_body, samples_at

DEFAULT_SAMPLES = 60_000
_MIN_SAMPLES_PER_PHOTO = 20
# Predictions go through a photograph in blocks of this many pixels: memory stays small for large ones.
_PIXELS_AT_A_TIME = 100_000
_STAGES = ("capture", "recon", "invrender")


@dataclass(frozen=True, eq=False)
class Prediction:
    """One photograph beside its prediction: (h, w, 3) float32; `inside` (h, w) marks where it is predicted."""

    photo: Photo
    observed: RadianceImage
    predicted: NDArray[np.float32]
    inside: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Run:
    """A finished run: its result, the samples it was fitted to, and what predictions need.

    seconds : per package, added up over threads, and "total", by the clock on the wall.
    """

    photoset: PhotoSet
    result: Factorization
    columns: Mapping[str, PhotoColumns]
    elements: Mapping[str, Sequence[LightElement]]
    strengths: Mapping[str, NDArray[np.float64]]
    seconds: dict[str, float]

    def predictions(self) -> Iterator[Prediction]:
        """Predicted photographs in the set's order, a few at a time in memory."""
        return parallel_map(self._predict, self.photoset.photos)

    def _predict(self, photo: Photo) -> Prediction:
        observed = decode_photo(self.photoset, photo)
        body = SphereBody(self.result.sphere)
        rows, columns = body_pixels(body, photo.camera)
        elements, strengths = self.elements[photo.lighting], self.strengths[photo.label]
        predicted = np.zeros_like(observed.radiance)
        for part in np.array_split(np.arange(len(rows)), len(rows) // _PIXELS_AT_A_TIME + 1):
            pixels = rows[part], columns[part]
            samples = samples_at(body, photo.camera, observed, *pixels, NO_SOURCES)
            predicted[pixels] = predict(self.result.brdf, elements, strengths, samples)
        inside = np.zeros(observed.saturated.shape, bool)
        inside[rows, columns] = True
        return Prediction(photo, observed, predicted, inside)


@dataclass
class _Clock:
    """Time spent per stage, added up over threads."""

    seconds: dict[str, float] = field(default_factory=lambda: dict.fromkeys(_STAGES, 0.0))
    lock: threading.Lock = field(default_factory=threading.Lock)

    @contextmanager
    def on(self, stage: str) -> Iterator[None]:
        start = time.perf_counter()
        try:
            yield
        finally:
            with self.lock:
                self.seconds[stage] += time.perf_counter() - start


def process(photoset: PhotoSet, samples: int = DEFAULT_SAMPLES, track: Track = silent) -> Run:
    """Recover the BRDF of a sphere, and what of its lighting is free, from a photo set.

    samples : about how many pixels of all photographs together enter the fit.
    """
    with one_blas_thread():
        return _process(photoset, samples, track)


def _process(photoset: PhotoSet, samples: int, track: Track) -> Run:
    begun = time.perf_counter()
    clock = _Clock()
    fitted = [photo for photo in photoset.photos if not photo.held_out]
    _check_scope(photoset, fitted)
    with clock.on("recon"):
        lightings = _used_lightings(photoset)
        elements = {name: light_elements(lighting) for name, lighting in lightings.items()}
        sphere = find_sphere(photoset, track)
        body = SphereBody(sphere)
    budget = max(samples // len(fitted), 4 * _MIN_SAMPLES_PER_PHOTO)

    def read(index: int) -> PhotoColumns:
        photo = photoset.photos[index]
        with clock.on("capture"):
            image = decode_photo(photoset, photo)
        with clock.on("recon"):
            mask = sphere_mask(photoset, photo, sphere)
            # Seeded by place, so that neither order nor threads change what is drawn.
            sources = lightings[photo.lighting].directions
            rng = np.random.default_rng(index)
            drawn = sample_body(body, photo.camera, image, mask, sources, budget, rng)
            drawn = off_terminators(drawn, sources)
            _check_usable(photo, image, drawn, mask)
        with clock.on("invrender"):
            return photo_columns(photo.lighting, elements[photo.lighting], drawn)

    columns: dict[str, PhotoColumns] = {}
    work = parallel_map(read, range(len(photoset.photos)))
    for photo in track(photoset.photos, "Reading photographs"):
        columns[photo.label] = next(work)
    _check_lit(photoset, lightings, columns)
    with clock.on("invrender"):
        steps = iter(track(range(ladder_steps(len(fitted))), "Fitting and cross-validating"))
        next(steps)
        # A light that only held-out photographs are under is no evidence: it is scored, not fitted.
        seen = {photo.lighting for photo in fitted}
        solution = factorize(
            [columns[photo.label] for photo in fitted],
            [lighting for name, lighting in lightings.items() if name in seen],
            lambda: next(steps, None),
        )
        strengths = {
            photo.label: _strengths(solution, columns[photo.label], photo.held_out)
            for photo in photoset.photos
        }
        scored = []
        for name in [name for name in lightings if name not in seen]:
            label = next(photo.label for photo in photoset.photos if photo.lighting == name)
            scored.append(_scored_lighting(lightings[name], elements[name], strengths[label]))
        scores = _scores(photoset, solution, columns, strengths)
    warnings = find_warnings(photoset, solution, sphere, lightings)
    result = Factorization(
        name=photoset.name,
        gauge=solution.gauge,
        sphere=sphere,
        brdf=solution.estimate.brdf,
        quantities=solution.quantities,
        lightings=(*solution.lightings, *scored),
        rungs=solution.rungs,
        chosen=solution.chosen,
        photos=scores,
        noise_floor=solution.noise.floor,
        noise_relative=solution.noise.relative,
        structured=solution.structured,
        covariance=solution.covariance,
        covariance_names=solution.covariance_names,
        warnings=warnings,
    )
    seconds = {**clock.seconds, "total": time.perf_counter() - begun}
    return Run(photoset, result, columns, elements, strengths, seconds)


def _check_scope(photoset: PhotoSet, fitted: Sequence[Photo]) -> None:
    where = photoset.manifest
    if photoset.object.shape != "sphere":
        raise ValueError(f"{where}: [object] shape = 'mesh': this version processes spheres only")
    if photoset.object.texture:
        raise ValueError(
            f"{where}: [object] texture = true: this version recovers one BRDF for the whole object only"
        )
    if not photoset.lightings:
        raise ValueError(
            f"{where}: has no [[lighting]]: this version recovers reflectance under known light only;"
            " give map, directional or mirror_ball"
        )
    if len(fitted) < 2:
        raise ValueError(
            f"{where}: has {len(fitted)} photo(s) to fit; at least two are needed, so that a model can be judged on"
            " a photo it has not seen: add photographs from other sides or under other light"
        )


def _used_lightings(photoset: PhotoSet) -> dict[str, Lighting]:
    used = {photo.lighting for photo in photoset.photos}
    return {table.name: read_lighting(photoset, table) for table in photoset.lightings if table.name in used}


def _check_usable(
    photo: Photo, image: RadianceImage, samples: LightField, coverage: NDArray[np.float32] | None
) -> None:
    inside = coverage >= 0.5 if coverage is not None else np.ones(image.saturated.shape, bool)
    if image.saturated[inside].all():
        raise ValueError(
            f"{photo.file}: every pixel of the object is saturated; expose shorter, or leave it out"
        )
    if len(samples) < _MIN_SAMPLES_PER_PHOTO:
        raise ValueError(
            f"{photo.file}: only {len(samples)} pixels of the object are usable (not saturated, not at its rim);"
            " the object must be larger in the image, or the exposure shorter"
        )
    if not samples.radiance.any():
        raise ValueError(f"{photo.file}: the object is black in every pixel; expose longer, or leave it out")


def _check_lit(
    photoset: PhotoSet, lightings: Mapping[str, Lighting], columns: Mapping[str, PhotoColumns]
) -> None:
    for name, lighting in lightings.items():
        users = [columns[photo.label] for photo in photoset.photos if photo.lighting == name]
        for k, direction in enumerate(lighting.directions):
            highest = max(float((photo.field.sample_normals @ direction).max()) for photo in users)
            if highest <= 0:
                raise ValueError(
                    f'{photoset.manifest}: [[lighting]] "{name}": source {k + 1} at {np.round(direction, 3).tolist()}'
                    " is below the horizon of everything that is seen; directions point from the object to the"
                    " light, in the world's frame: check its sign and frame"
                )


def _strengths(solution: Solution, photo: PhotoColumns, held_out: bool) -> NDArray[np.float64]:
    known = solution.estimate.strengths.get(photo.lighting)
    if known is not None:
        return known
    assert held_out
    return fit_strengths(photo, 1 / solution.noise.variance(photo.radiance), solution.estimate)


def _scored_lighting(
    lighting: Lighting, elements: Sequence[LightElement], strengths: NDArray[np.float64]
) -> FittedLighting:
    """A lighting that only held-out photographs are under, with strengths fitted to score them; no error bars."""
    irradiances, std = lighting.irradiances.copy(), np.zeros_like(lighting.irradiances)
    ambient = None
    for element, strength in zip(elements, strengths, strict=True):
        if element.name.startswith("source"):
            k = int(element.name.removeprefix("source ")) - 1
            irradiances[k], std[k] = np.maximum(strength, 0), np.nan
        elif element.name == "ambient":
            ambient = strength
    ambient_std = None if ambient is None else np.full(3, np.nan)
    return FittedLighting(replace(lighting, irradiances=irradiances), std, ambient, ambient_std)


def _scores(
    photoset: PhotoSet,
    solution: Solution,
    columns: Mapping[str, PhotoColumns],
    strengths: Mapping[str, NDArray[np.float64]],
) -> tuple[PhotoScore, ...]:
    scores = []
    unseen = iter(solution.rungs[solution.chosen].photo_errors)
    weights = iter(solution.weights)
    for photo in photoset.photos:
        entry = columns[photo.label]
        residual = entry.radiance - predict_columns(entry, solution.estimate.brdf, strengths[photo.label])
        trust = None if photo.held_out else next(weights).trust
        scores.append(
            PhotoScore(
                label=photo.label,
                lighting=photo.lighting,
                held_out=photo.held_out,
                samples=len(entry.field),
                rms=relative_rms(residual, entry.radiance, trust),
                cross_validated=None if photo.held_out else float(next(unseen)),
            )
        )
    return tuple(scores)
