"""The main job on a textured mesh under unknown light.

Highlights move over the surface with the camera while the albedo stays. `factorize_blind` recovers the light from
what differs between photographs of the same places. Textures are then solved for as if the light were given. Error bars
hold what either step leaves open. Where nothing shines, albedo and light can't be separated [RH01, section 6.4].
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from capture.photo import Photo
from capture.photoset import PhotoSet
from capture.progress import Track, counted
from capture.source_region import source_regions
from capture.tasks.stage import kept_result, stage_results
from invrender.estimate.quantities import FittedLighting, Quantity
from invrender.estimate.reference_scale import check_under
from invrender.estimate.solution import Solution
from invrender.estimate.textured.layout import SurfacePoints, scattered
from invrender.estimate.textured.observe import observe, points_for, squares_seen
from invrender.estimate.unknown_light import (
    BlindLight,
    BlindSolution,
    blind_steps,
    factorize_blind,
    predict_parts,
)
from invrender.estimate.unknown_light.absolute_scale import ScaleUnder, scale_under
from invrender.observation.clock import Clock
from invrender.observation.geometry import SceneGeometry
from invrender.observation.samples import PhotoReader
from invrender.process.held_out_light import used_tables
from invrender.process.recovered import recovered_lighting
from invrender.process.textured import Recovered, solve_textured
from invrender.process.unknown_light import orders_of
from invrender.result.run import TexturedRun
from invrender.theory.operator import irradiance_operator
from invrender.wording import sentences
from recon.harmonics.basis import degree_of
from recon.harmonics.latlong import project_latlong
from recon.mesh.bodies import Body, MeshBody
from recon.reference import find_references
from recon.sampling.draw import NO_SOURCES
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]

# Samples that the light is found from.
_SAMPLES = 12_000
# Pixels of a photograph that show whether it is usable, beside those that samples are taken from.
_AT_RANDOM = 100
# Of all light that reaches a point, this share of the brightest's is the least in which the albedo is judged.
_DARK = 1e-3
# Light that is uncertain by this share of itself is undetermined.
_UNDETERMINED = 0.5
_GAUGE = (
    "no light is known, so the overall scale of light against reflectance is free in each channel: Kd, its mean by the"
    " light that falls on it, and Ks add up to 1, and lighting is in units of the photographs over that"
)
_MATTE = (
    "{where}: [object] texture = true, but light {names} is unknown, and no highlights determine it: light and albedo"
    " of a matte object can't be separated (RH01, section 6.4): the albedo may be darker wherever light is brighter."
    " Measure the light, with a mirror ball say, or remove texture: light and one BRDF of the whole surface are then"
    " recovered together"
)


def solve_unknown_texture(
    photoset: PhotoSet, geometry: SceneGeometry, samples: int, clock: Clock, track: Track
) -> TexturedRun:
    """Recover Kd and Ks over a mesh, up to a scale per channel, and all of the lightings on it.

    A reference of known reflectance fixes the scale.

    Raises ValueError for lightings that are given, and for objects without highlights, whose light nothing determines.
    """
    assert isinstance(geometry.body, MeshBody)
    _check_unknown(photoset)
    orders = orders_of(photoset, ())
    fitted = photoset.fitted
    with clock.on("recon"):
        references = find_references(photoset, geometry.body)
    check_under(references, dict.fromkeys(photo.lighting for photo in fitted))
    names = [photo.lighting for photo in fitted]
    photos = _at_places(photoset, geometry, geometry.body, fitted, min(samples, _SAMPLES), clock, track)
    with clock.on("invrender"):
        regions = source_regions(photoset.lightings)

        def factorized() -> BlindSolution:
            with counted(track, blind_steps(orders), "Separating light and albedo") as on_step:
                given = photos, names, orders, regions
                return factorize_blind(*given, on_step=on_step, shadows=geometry.shadows)

        made_of = photos, names, orders, regions, geometry.shadows
        blind = kept_result("texture-light", factorized, made_of)
        unsure = [_unsure_light(light, light.numbers[1]).max() for light in blind.lights.values()]
        if blind.sigma is None or min(unsure) > _UNDETERMINED:
            unknown = " and ".join(f'"{name}"' for name in dict.fromkeys(names))
            raise ValueError(_MATTE.format(where=photoset.manifest, names=unknown))
        lights = _scaled(blind, photos, names, geometry)
        under = scale_under(lights, references) if references else None
        if under is not None:
            lights = {name: light.times(1 / under.scale.factor) for name, light in lights.items()}
    found = [recovered_lighting(name, light) for name, light in lights.items()]
    # What was recovered of a light is now given.
    given = {own.lighting.name: replace(own.lighting, recover_irradiance=False) for own in found}
    slopes = {name: _ScaleSlopes.of(name, lights, under) for name in lights}
    unsure_at = _unsure(blind, lights, found, slopes)
    stated = [
        recovered_lighting(name, light.with_std(slopes[name].std_of(light))) for name, light in lights.items()
    ]
    recovered = Recovered(given, unsure_at, lambda solution: _in_gauge(solution, blind, stated, under))
    run = solve_textured(photoset, geometry, samples, clock, track, recovered)
    warnings = (*sentences(blind.warnings), *run.warnings)
    if under is None:
        return replace(run, warnings=warnings)
    scores = under.scale.scores(under.scale.factor)
    return replace(run, warnings=(*warnings, *under.scale.remarks), references=scores)


def _check_unknown(photoset: PhotoSet) -> None:
    for table in used_tables(photoset):
        if not table.unknown:
            raise ValueError(
                f"{photoset.manifest}: [object] texture = true, and some photographs are under unknown light, others"
                f" under {table.name!r}, of which something is known; such sets are not solved together: process the"
                " photographs under known light alone, or write unknown = true into every [[lighting]]"
            )


def _at_places(
    photoset: PhotoSet,
    geometry: SceneGeometry,
    body: MeshBody,
    fitted: Sequence[Photo],
    samples: int,
    clock: Clock,
    track: Track,
) -> list[LightField]:
    """About so many samples of all photographs, at the same points of the surface; of those that two or more see."""
    count = points_for(samples, len(fitted))
    points = scattered(body, count, np.random.default_rng(0))
    at_points = _AtPoints(PhotoReader.of(photoset, geometry.found), points)
    work = stage_results("points", at_points, fitted, lambda photo: str(photo.file))
    photos = []
    for _ in track(fitted, "Reading photographs"):
        field, seconds = next(work)
        photos.append(field)
        clock.add(seconds)
    places = [np.asarray(photo.place) for photo in photos]
    times = np.bincount(np.concatenate(places), minlength=count)
    if times.max() < 2:
        raise ValueError(
            f"{photoset.manifest}: no part of the object shows in two photographs, so nothing separates its albedo"
            " from the unknown light; add photographs from sides between these"
        )
    return [photo.where(times[at] > 1) for photo, at in zip(photos, places, strict=True)]


@dataclass(frozen=True, eq=False)
class _AtPoints:
    """The samples of a photograph at some points of a mesh, and seconds by package."""

    reader: PhotoReader
    points: SurfacePoints

    def __call__(self, photo: Photo) -> tuple[LightField, Mapping[str, float]]:
        clock, rng = Clock(), np.random.default_rng(0)
        squares = squares_seen(photo.camera, self.points)
        field, _ = self.reader.pixels_around(photo, squares, _AT_RANDOM, NO_SOURCES, rng, clock)
        with clock.on("recon"):
            return _samples_at(field, self.reader.body, photo, self.points), clock.seconds


def _samples_at(field: LightField, body: Body, photo: Photo, points: SurfacePoints) -> LightField:
    """A sample for each of the points that a photograph shows: the radiance there, in the pixel around it."""
    seen = observe(body, photo.camera, field, points)
    nearest = seen.samples[np.arange(len(seen)), seen.weights.argmax(axis=1)]
    # Of points in one pixel the first.
    pixels, first = np.unique(nearest, return_index=True)
    marked = np.zeros(len(field), bool)
    marked[pixels] = True
    radiance = seen.at_points(field.radiance)[first]
    return replace(field.where(marked), radiance=radiance, place=seen.points[first])


def _scaled(
    blind: BlindSolution, photos: Sequence[LightField], names: Sequence[str], geometry: SceneGeometry
) -> dict[str, BlindLight]:
    """The lightings in which Kd, its mean weighted by what falls on it, and Ks add up to 1."""
    parts = [
        predict_parts(blind, photo, blind.lights[name], geometry.shadows)
        for photo, name in zip(photos, names, strict=True)
    ]
    left = sum((photo.radiance - lobe).sum(axis=0) for photo, (_, lobe) in zip(photos, parts, strict=True))
    of_paint = np.maximum(left / sum(base.sum(axis=0) for base, _ in parts), 0)
    scale = (1 - blind.brdf_share) * of_paint + blind.brdf_share
    return {name: light.times(scale) for name, light in blind.lights.items()}


def _unsure(
    blind: BlindSolution,
    lights: Mapping[str, BlindLight],
    found: Sequence[FittedLighting],
    slopes: Mapping[str, _ScaleSlopes],
) -> Callable[[SurfacePoints], Floats]:
    """Shares by which what was found first leaves Kd and Ks of points uncertain.

    Of several lightings the best known counts at each point. The share of Ks that they were found with is Ks itself, in
    their units. slopes : of the scale, by lighting: what makes light brighter at references and elsewhere alike moves
    neither.
    """
    std = _deviations(blind)
    of_share = np.array([std[f"share {c}"] for c in "rgb"]) / blind.brdf_share

    def at(points: SurfacePoints) -> Floats:
        each = [(light, own, slopes[name]) for (name, light), own in zip(lights.items(), found, strict=True)]
        of_kd = np.min([_unsure_base(*of, points.normals) for of in each], axis=0)
        of_light = np.min([_unsure_light(light, scale.std_of(light)) for light, _, scale in each], axis=0)
        of_ks = np.hypot(of_light, of_share)
        return np.hstack([of_kd, np.broadcast_to(of_ks, of_kd.shape)])

    return at


@dataclass(frozen=True, eq=False)
class _ScaleSlopes:
    """How the scale hangs on a light.

    slopes : (p, 3), of the scale's logarithm by the light's numbers. besides : (3,), squared shares by which what
    isn't this light leaves the scale uncertain.
    """

    slopes: Floats
    besides: Floats

    @staticmethod
    def of(name: str, lights: Mapping[str, BlindLight], under: ScaleUnder | None) -> _ScaleSlopes:
        numbers, _ = lights[name].numbers
        if under is None:
            return _ScaleSlopes(np.zeros_like(numbers), np.zeros(3))
        besides = under.scale.own_std**2
        for other, light in lights.items():
            if other != name:
                # Slopes are by the numbers as they were before the scale.
                besides = besides + (
                    under.slopes[other] ** 2 * (under.scale.factor * light.numbers[1]) ** 2
                ).sum(axis=0)
        return _ScaleSlopes(under.slopes[name] * under.scale.factor, besides)

    def std_of(self, light: BlindLight) -> Floats:
        """Standard deviations (p, 3) of the light's numbers in that scale."""
        level, std = light.numbers
        moved = self.slopes * std
        shared = (moved**2).sum(axis=0) - moved**2 + self.besides
        return np.sqrt((std - level * moved) ** 2 + level**2 * shared)


def _unsure_base(light: BlindLight, found: FittedLighting, scale: _ScaleSlopes, normals: Floats) -> Floats:
    """Standard deviation of the irradiance of normals (n, 3) over itself, (n, 3); without what the mesh hides.

    It holds by what the map of the light, which isn't negative, differs from the harmonics that were fitted.
    """
    lighting, l_max = found.lighting, degree_of(len(light.coefficients))
    assert lighting.radiance_map is not None
    sky, of_lamps = irradiance_operator(normals, l_max), np.clip(normals @ lighting.directions.T, 0, 1)
    falls = sky @ project_latlong(lighting.radiance_map, l_max) + of_lamps @ lighting.irradiances
    rows, (numbers, std) = np.hstack([sky, of_lamps]), light.numbers
    safe = np.maximum(falls, _DARK * falls.max(axis=0))
    variance = [((rows / safe[:, c, None] - scale.slopes[:, c]) ** 2) @ std[:, c] ** 2 for c in range(3)]
    apart = (falls - rows @ numbers) / safe
    return np.sqrt(np.stack(variance, axis=-1) + apart**2 + scale.besides)


def _unsure_light(light: BlindLight, std: Floats) -> Floats:
    """Standard deviations (p, 3) of a light's numbers over itself, (3,): RMS over its harmonics and lamps."""
    level = light.numbers[0]
    return np.asarray(np.sqrt((std**2).sum(axis=0) / np.maximum((level**2).sum(axis=0), 1e-300)))


def _in_gauge(
    solution: Solution, blind: BlindSolution, lights: Sequence[FittedLighting], under: ScaleUnder | None
) -> Solution:
    """A solution in recovered light, with what isn't known of that in the error bars of mu and sigma.

    under : the scale by references; None where nothing fixes it.
    """
    std = _deviations(blind)
    own = [std.get(name, 0.0) for name in solution.covariance_names]
    quantities = {
        name: _widened(quantity, blind.quantities.get(name), std.get(name, 0.0))
        for name, quantity in solution.quantities.items()
        if name != "albedo" or under is not None
    }
    return replace(
        solution,
        gauge=_GAUGE if under is None else under.scale.in_words,
        quantities=quantities,
        lightings=tuple(lights),
        covariance=solution.covariance + np.diag(np.square(own)),
    )


def _deviations(blind: BlindSolution) -> dict[str, float]:
    """Standard deviations by the covariance's names."""
    return dict(zip(blind.covariance_names, np.sqrt(np.diag(blind.covariance)).tolist(), strict=True))


def _widened(quantity: Quantity, first: Quantity | None, std: float) -> Quantity:
    """mu or sigma with what is not known of the light; undetermined where that and all else was found."""
    if first is not None and first.status == "undetermined" and std:
        return first
    if quantity.std is None:
        return quantity
    before = float(np.mean(quantity.std**2))
    variances = {cause: np.array([share * before]) for cause, share in quantity.shares.items()}
    variances["recovered_light"] = variances.get("recovered_light", np.zeros(1)) + std**2
    return replace(quantity, std=np.hypot(quantity.std, std)).with_shares(variances)
