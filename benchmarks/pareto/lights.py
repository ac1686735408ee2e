"""The board of inverse lighting: a sphere of known BRDF, and what light its photographs show."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from benchmarks.contest import Outcome, held_out_error
from benchmarks.pareto.boards import Board, Contestant
from benchmarks.pareto.spheres import DRAWS, photographed
from benchmarks.spherephotos import SpherePhotos
from capture.parallel import parallel_map
from invrender.brdf.microfacet import Microfacet
from invrender.estimate.rh01.nodes import bilinear
from invrender.estimate.unknown_light import factorize_blind, predict_blind
from invrender.inverse_lighting.coefficients import candidate_degree, estimate_coefficients
from invrender.inverse_lighting.dual import DualLight, estimate_dual
from invrender.inverse_lighting.estimate import LightingChoices
from invrender.output.compare.lightings import first_coefficients
from invrender.transport.harmonic_rows import PhotoRows, mirrored_views, photo_rows

Floats = NDArray[np.float64]

_NINE = "largest error of the light's first nine coefficients, over degree 0"
_DEGREES, _QUICK_DEGREES = (4, 8, 12, 16, 20), (4,)
_BUDGETS, _QUICK_BUDGETS = (2000, LightingChoices.samples), (1000,)

# Photographs and samples of them: the light's first nine coefficients (9, 3), and radiance of unseen photographs.
Method = Callable[[SpherePhotos, Microfacet, int], tuple[Floats, list[Floats]]]


def light_board(quick: bool) -> Board:
    """Coefficients of several degrees, the dual map, and both light and BRDF at once."""
    entries = list(_entries(quick))
    return Board(
        "sphere, known BRDF",
        _NINE,
        lambda outcome: float(outcome.errors["nine"] or 0),
        [_contestant(quick, *entry) for entry in entries],
        1 if quick else DRAWS,
        lambda: None if quick else by_coefficients(photographed(quick), _brdf(photographed(quick)), 500),
    )


def _entries(quick: bool) -> Iterator[tuple[str, str, Method, int, bool]]:
    default = _QUICK_BUDGETS[-1] if quick else LightingChoices.samples
    yield "coefficients (lightfactor)", f"default, {default}", by_coefficients, default, True
    for budget in _QUICK_BUDGETS if quick else _BUDGETS:
        for degree in _QUICK_DEGREES if quick else _DEGREES:
            if (degree + 1) ** 2 < budget / 4:
                yield (
                    f"coefficients, {budget} samples",
                    f"l* = {degree}",
                    partial(by_coefficients, degree=degree),
                    budget,
                    False,
                )
        yield "dual map", str(budget), by_map, budget, False
        yield "joint: BRDF unknown too", str(budget), jointly, budget, False


def by_coefficients(
    photos: SpherePhotos, brdf: Microfacet, samples: int, degree: int | None = None
) -> tuple[Floats, list[Floats]]:
    """Linear least squares [RH01, eq. 25]; without a degree, the highest that the samples determine."""
    top = candidate_degree(brdf, samples) if degree is None else degree
    found = estimate_coefficients(_rows(photos, brdf, samples, top), brdf, degree)
    unseen = [photo_rows(field, brdf, found.degree).predict(brdf, found.values) for field in photos.held_out]
    return found.values[:9], unseen


def by_map(photos: SpherePhotos, brdf: Microfacet, samples: int) -> tuple[Floats, list[Floats]]:
    """The dual angular and frequency-space method [RH01, fig. 8]."""
    rows = _rows(photos, brdf, samples, candidate_degree(brdf, samples))
    found = estimate_dual(rows, brdf, estimate_coefficients(rows, brdf))
    return found.nine, [_seen(found, photo_rows(field, brdf, 2), brdf) for field in photos.held_out]


def jointly(photos: SpherePhotos, _: Microfacet, samples: int) -> tuple[Floats, list[Floats]]:
    """Light, lamps and BRDF at once: what is known of the BRDF isn't used."""
    found = factorize_blind(photos.samples(samples), orders=(10,), ladder=False)
    (light,) = found.lights.values()
    return light.normalised_coefficients[:9], [predict_blind(found, field) for field in photos.held_out]


def _rows(photos: SpherePhotos, brdf: Microfacet, samples: int, l_max: int) -> Sequence[PhotoRows]:
    return list(parallel_map(lambda field: photo_rows(field, brdf, max(l_max, 2)), photos.samples(samples)))


def _seen(light: DualLight, rows: PhotoRows, brdf: Microfacet) -> Floats:
    """Radiance (n, 3): the nine coefficients' by diffuse reflection, the map's in the mirror direction."""
    assert rows.specular is not None
    height = len(light.radiance)
    nodes, weights = bilinear(mirrored_views(rows.field), height)
    mirrored = np.einsum("nk,nkc->nc", weights, light.radiance.reshape(-1, 3)[nodes])
    gain = np.sqrt(4 * np.pi) * rows.specular[:, :1]
    return np.asarray(brdf.kd * (rows.diffuse[:, :9] @ light.nine) + brdf.ks * gain * mirrored)


def _brdf(photos: SpherePhotos) -> Microfacet:
    true = photos.stage.material
    return Microfacet(true.kd, true.ks, true.mu, true.sigma)


def _contestant(
    quick: bool, family: str, setting: str, method: Method, samples: int, is_default: bool
) -> Contestant:
    def judge(seed: int) -> Outcome:
        photos = photographed(quick).with_noise(seed)
        begin = time.perf_counter()
        nine, unseen = method(photos, _brdf(photos), samples)
        seconds = time.perf_counter() - begin
        truth = first_coefficients(photos.stage.lighting)
        error = np.abs(nine / nine[0] - truth / truth[0]).max()
        return Outcome(
            family, False, setting, seconds, {"nine": float(error)}, held_out_error(photos.held_out, unseen)
        )

    return Contestant(family, setting, judge, is_default, method is jointly)
