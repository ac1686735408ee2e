"""The main job: a photo set in, a factorization and predicted photographs out. No terminal, no result files."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

from capture.parallel import one_blas_thread
from capture.photo import Photo
from capture.photoset import PhotoSet
from capture.progress import Track, silent
from invrender.observation.clock import Clock
from invrender.observation.geometry import find_geometry
from invrender.process.extinction import with_found_extinction
from invrender.process.known_light import solve_known_light
from invrender.process.published import solve_known_light_as_published
from invrender.process.textured import solve_textured
from invrender.process.unknown_light import solve_unknown_light
from invrender.process.unknown_texture import solve_unknown_texture
from invrender.result.run import Run
from recon.sampling.find import check_unfiltered

DEFAULT_SAMPLES = 60_000


def process(
    photoset: PhotoSet,
    samples: int = DEFAULT_SAMPLES,
    track: Track = silent,
    shadowing: bool = True,
    causes: bool = True,
    published: bool = False,
) -> Run:
    """Recover the BRDF of an object, and what of its lighting is free, from a photo set.

    samples : about how many pixels of all photographs together enter the fit. shadowing : False leaves the
    shadows of a mesh on itself out, to show what they amount to. causes : False leaves the search for causes of what
    a model without textures under known light doesn't explain out; error bars then don't hold them.
    published : whether known light is solved by RH01's section 6.1 instead, without error bars.
    """
    with one_blas_thread():
        return _process(photoset, samples, track, shadowing, causes, published)


def _process(
    photoset: PhotoSet, samples: int, track: Track, shadowing: bool, causes: bool, published: bool
) -> Run:
    begun = time.perf_counter()
    clock = Clock()
    _check_scope(photoset, photoset.fitted)
    with clock.on("recon"):
        geometry = find_geometry(photoset, track, shadowing)
    unknown = {table.name for table in photoset.lightings if table.unknown}
    is_unknown = bool(unknown & {photo.lighting for photo in photoset.photos})
    if not published:
        photoset = with_found_extinction(photoset, geometry, samples, clock, track, is_unknown)
    given = photoset, geometry, samples, clock, track
    if published:
        _check_published(photoset, is_unknown)
        run = solve_known_light_as_published(*given)
    elif is_unknown:
        run = (solve_unknown_texture if photoset.object.texture else solve_unknown_light)(*given)
    else:
        run = solve_textured(*given) if photoset.object.texture else solve_known_light(*given, causes)
    return replace(run, seconds={**clock.seconds, "total": time.perf_counter() - begun})


def _check_published(photoset: PhotoSet, is_unknown: bool) -> None:
    check_unfiltered(photoset)
    if is_unknown:
        raise ValueError(
            f"{photoset.manifest}: the light is unknown, but --published is RH01's section 6.1, of known light;"
            " `lightfactor factor --published` is its section 6.3, of unknown light"
        )
    if photoset.object.texture:
        raise ValueError(
            f"{photoset.manifest}: [object] texture = true: --published recovers one BRDF; leave it out for textures"
        )


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
