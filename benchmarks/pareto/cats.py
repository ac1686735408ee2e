"""The boards of a mesh that shadows itself: RH01's cat from three photographs, its lighting known and unknown."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.atlas.stage import truths
from benchmarks.contest import Found, Outcome, judged, relative_error
from benchmarks.pareto.boards import Board, Contestant
from benchmarks.pareto.spheres import DRAWS, PARAMETERS
from capture.files.imagefile import read_pixels, write_exr
from capture.manifest import LightingTable
from capture.photo import Photo
from capture.photoset import PhotoSet, load_photoset
from capture.progress import silent
from invrender.brdf.microfacet import Microfacet as Fitted
from invrender.estimate.rh01 import published_brdf
from invrender.estimate.unknown_light import BlindSolution, factorize_blind
from invrender.observation.clock import Clock
from invrender.observation.geometry import SceneGeometry, find_geometry
from invrender.observation.samples import read_samples
from invrender.process.known_light import solve_known_light
from invrender.process.pipeline import DEFAULT_SAMPLES
from invrender.process.unknown_light import solve_unknown_light
from invrender.result.run import Run
from invrender.transport.lobe_table import TRANSFERS, Transfer
from invrender.transport.predict import predict
from invrender.transport.transfer import light_elements
from recon.lighting import read_lighting
from recon.sampling.draw import NO_SOURCES
from recon.sampling.lightfield import LightField
from synthetic.materials.microfacet import MicrofacetMaterial
from synthetic.render.photograph import photographs
from synthetic.scene import Effort
from synthetic.scenes.build import read_staging
from synthetic.scenes.builtin import scene_path
from synthetic.sensing.noise import Noise
from synthetic.writer import write_photoset

# The default takes all that the three photographs have, some 35,000.
_BUDGETS = (500, 2000, 8000)
# What approximations and published procedures are shown at, and fits that know of no shadows.
_LEVEL, _BARE = _BUDGETS[1:], 20000
# Degree of unknown light where it is told; samples of the view that no fit sees.
_ORDER, _JUDGED = 10, 8000
# Directions and rays by which that view is integrated: eight and four times the photographs'.
_JUDGING = Effort(directions=8192, per_side=8)


@dataclass(frozen=True, eq=False)
class CatPhotos:
    """A photo set on disk with its specimen, as it is and as if it cast no shadows on itself.

    noise : of its photographs. known, unknown : the set, its first lighting told or not. unseen : the photograph of a
    new view under it. held_out : samples of that without noise, integrated more finely: at shadows' borders the
    photograph itself is off by 0.2%.
    """

    folder: TemporaryDirectory[str]
    noise: Noise
    known: PhotoSet
    unknown: PhotoSet
    geometry: SceneGeometry
    bare: SceneGeometry
    truth: dict[str, float | None]
    unseen: Photo
    held_out: tuple[LightField, ...]


@cache
def photographed() -> CatPhotos:
    """The built-in scene, photographed."""
    folder = TemporaryDirectory()
    staging = read_staging(scene_path("rh01-cat"))
    assert isinstance(staging.scene.material, MicrofacetMaterial)
    assert isinstance(staging.sensor, Noise)
    write_photoset(staging, Path(folder.name))
    known = load_photoset(Path(folder.name))
    first, *others = known.lightings
    unknown = replace(known, lightings=(LightingTable(name=first.name, unknown=True), *others))
    geometry = find_geometry(known)
    place, unseen = next(
        (k, photo) for k, photo in enumerate(known.photos) if photo.held_out and photo.lighting == first.name
    )
    clean = replace(
        known,
        photos=(replace(unseen, file=Path(folder.name) / "truth" / f"{place:03d}.exr", held_out=False),),
    )
    fields, _ = read_samples(clean, geometry.found, {first.name: NO_SOURCES}, _JUDGED, Clock(), silent)
    ((radiance, _),) = photographs(
        replace(staging.scene, shots=(staging.scene.shots[place],), effort=_JUDGING)
    )
    held_out = tuple(
        replace(field, radiance=radiance[field.rows, field.columns]) for field in fields.values()
    )
    truth = truths(staging.scene.material)
    bare = find_geometry(known, shadowing=False)
    return CatPhotos(folder, staging.sensor, known, unknown, geometry, bare, truth, unseen, held_out)


@cache
def with_noise(seed: int) -> CatPhotos:
    """The same with other noise."""
    cat = photographed()
    folder = Path(cat.folder.name)
    photos = []
    for index, photo in enumerate(cat.known.photos):
        clean = read_pixels(folder / "truth" / f"{index:03d}.exr").astype(float)
        noisy = folder / f"{index:03d}-{seed}.exr"
        rng = np.random.default_rng([seed, index])
        write_exr(noisy, cat.noise.applied(clean, np.asarray(clean.any(axis=2), float), rng))
        photos.append(replace(photo, file=noisy))
    known, unknown = (replace(photoset, photos=tuple(photos)) for photoset in (cat.known, cat.unknown))
    return replace(cat, known=known, unknown=unknown)


def told(cat: CatPhotos, samples: int, shadowing: bool = True) -> Found:
    """The BRDF in known light, as `process` does it."""
    geometry = cat.geometry if shadowing else cat.bare
    return _found(cat, solve_known_light(cat.known, geometry, samples, Clock(), silent))


def untold(
    cat: CatPhotos,
    samples: int,
    shadowing: bool = True,
    factorize: Callable[..., BlindSolution] | None = None,
) -> Found:
    """Light and BRDF, as `process` does it or by another factorization."""
    geometry = cat.geometry if shadowing else cat.bare
    return _found(cat, solve_unknown_light(cat.unknown, geometry, samples, Clock(), silent, factorize))


def _found(cat: CatPhotos, run: Run) -> Found:
    brdf = run.solution.brdf
    return Found(_share(brdf), brdf.mu, brdf.sigma, lambda field: run.radiance(cat.unseen, field))


def _share(brdf: Fitted) -> float:
    return float(brdf.ks[1] / (brdf.kd[1] + brdf.ks[1]))


def published(cat: CatPhotos, samples: int, transfer: Transfer) -> Found:
    """The BRDF in known light by RH01's simplex, with the visibility of section 6.4."""
    lighting = read_lighting(cat.known, cat.known.lightings[0])
    clock, shadows = Clock(), cat.geometry.shadows
    sources = {table.name: NO_SOURCES for table in cat.known.lightings} | {lighting.name: lighting.directions}
    fields, _ = read_samples(cat.known, cat.geometry.found, sources, samples, clock, silent)
    fitted = [fields[photo.label] for photo in cat.known.photos if not photo.held_out]
    brdf = published_brdf(fitted, lighting, transfer, shadows=shadows).brdf
    elements = light_elements(lighting)
    strengths = np.ones((len(elements), 3))
    return Found(
        _share(brdf),
        brdf.mu,
        brdf.sigma,
        lambda field: predict(brdf, elements, strengths, field, shadows),
    )


Method = Callable[[CatPhotos, int], Found]


def cat_boards() -> list[Board]:
    """In known light, and in unknown light; what depends on samples only once is done before: decoding, visibility."""
    return [
        Board(
            title,
            PARAMETERS,
            lambda outcome: relative_error(outcome, photographed().truth),
            [_contestant(known, *entry) for entry in entries],
            DRAWS,
            partial(_warm_up, method),
        )
        for title, known, method, entries in (
            ("cat, known light", True, told, _known()),
            ("cat, unknown light", False, untold, _unknown()),
        )
    ]


def _warm_up(method: Method) -> Found:
    return method(photographed(), 500)


def _known() -> Iterator[tuple[str, str, Method, int, bool]]:
    yield "statistics (lightfactor)", f"default, {DEFAULT_SAMPLES}", told, DEFAULT_SAMPLES, True
    for budget in _BUDGETS:
        yield "statistics (lightfactor)", str(budget), told, budget, False
    for budget in _LEVEL:
        for transfer in TRANSFERS:
            simplex = partial(published, transfer=transfer)
            yield f"simplex, {transfer} [RH01]", str(budget), simplex, budget, False
    yield "without shadows", str(_BARE), partial(told, shadowing=False), _BARE, False


def _unknown() -> Iterator[tuple[str, str, Method, int, bool]]:
    yield "whole ladder (lightfactor)", f"default, {DEFAULT_SAMPLES}", untold, DEFAULT_SAMPLES, True
    for budget in _BUDGETS:
        yield "whole ladder (lightfactor)", str(budget), untold, budget, False
    for transfer in TRANSFERS:
        newton = partial(factorize_blind, orders=(_ORDER,), ladder=False, transfer=transfer)
        for budget in _BUDGETS if transfer == "exact" else _LEVEL:
            yield (
                f"Gauss-Newton, {transfer}, l* = {_ORDER}",
                str(budget),
                partial(untold, factorize=newton),
                budget,
                False,
            )
    yield "without shadows", str(_BARE), partial(untold, shadowing=False), _BARE, False


def _contestant(
    known: bool, family: str, setting: str, method: Method, samples: int, is_default: bool
) -> Contestant:
    def judge(seed: int) -> Outcome:
        cat = with_noise(seed)
        return judged(cat, family, known, setting, partial(method, cat, samples))

    return Contestant(family, setting, judge, is_default, family.startswith("Gauss-Newton"))
