"""Light and BRDF of a photo set, by our factorization or RH01's. No terminal, no files."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial

from capture.parallel import one_blas_thread
from capture.photoset import PhotoSet
from capture.progress import Track, silent
from capture.source_region import source_regions
from invrender.estimate.unknown_light import factorize_blind
from invrender.factor.choices import FactorChoices
from invrender.factor.published import solve_as_published
from invrender.observation.clock import Clock
from invrender.observation.geometry import find_geometry
from invrender.process.unknown_light import solve_unknown_light
from invrender.result.run import Run
from recon.sampling.find import check_has_body, check_unfiltered


def factor(photoset: PhotoSet, choices: FactorChoices, track: Track = silent) -> Run:
    """Recover the one lighting and the BRDF of an object; what the set says of the light is not looked at."""
    _check_scope(photoset, choices)
    begun, clock = time.perf_counter(), Clock()
    regions = source_regions(photoset.lightings)
    if choices.region is not None:
        regions = {photo.lighting: choices.region for photo in photoset.photos}
    with one_blas_thread():
        with clock.on("recon"):
            geometry = find_geometry(photoset, track)
        given = (photoset, geometry, choices.samples, clock, track)
        if choices.published:
            run = solve_as_published(*given, regions.get(photoset.photos[0].lighting), *choices.orders)
        else:
            run = solve_unknown_light(
                *given,
                partial(
                    factorize_blind,
                    orders=choices.orders,
                    source_regions=regions,
                    ladder=choices.ladder,
                    transfer=choices.transfer,
                ),
            )
    return replace(run, seconds={**clock.seconds, "total": time.perf_counter() - begun})


def _check_scope(photoset: PhotoSet, choices: FactorChoices) -> None:
    where = photoset.manifest
    check_has_body(photoset)
    check_unfiltered(photoset)
    if photoset.object.shape != "sphere" and choices.published and not choices.orders:
        raise ValueError(
            f"{where}: [object] shape = 'mesh': RH01's dual lighting is of spheres, which don't shadow themselves; give"
            " --order 12, and the light's harmonics are recovered as RH01 did for a cat"
        )
    if photoset.object.shape != "sphere" and not choices.published:
        raise ValueError(
            f"{where}: [object] shape = 'mesh': `factor` compares ways of solving on spheres only, which don't shadow"
            " themselves; `lightfactor process` recovers light and BRDF from meshes, and RH01's procedure does"
            " (--published --order 12)"
        )
    if photoset.object.texture:
        raise ValueError(
            f"{where}: [object] texture = true: texture and light can't be separated; give a sphere of one BRDF"
        )
    names = list(dict.fromkeys(photo.lighting for photo in photoset.photos))
    if len(names) > 1:
        raise ValueError(
            f"{where}: photographs are under {len(names)} lightings ({', '.join(map(repr, names))}), of which one is"
            " recovered at a time: factor them in sets of their own"
        )
    fitted = sum(not photo.held_out for photo in photoset.photos)
    if fitted < 2:
        raise ValueError(
            f"{where}: has {fitted} photo(s) to fit; one can't separate light from reflectance, since any image is"
            " explained by a mirror ball under some light: add photographs from other sides"
        )
