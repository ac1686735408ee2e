"""What each method makes of the photographs of a sphere, and how far that is from the truth, ready to be kept."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.atlas.stage import SOURCE, Stage
from benchmarks.spheres.bench import (
    LIGHT_DEGREE,
    MATERIALS,
    OTHER_AREA,
    OTHER_SOURCE,
    true_coefficients,
    unseen_ratio,
)
from capture.files.documents import numbers
from capture.lighting import Lighting
from invrender.brdf.microfacet import Microfacet
from invrender.estimate.rh01 import (
    PublishedFactors,
    published_brdf,
    published_factors,
    published_factors_direct,
)
from invrender.estimate.solution import factorize
from invrender.estimate.unknown_light import BlindSolution, factorize_blind, predict_blind
from invrender.transport.columns import photo_columns
from invrender.transport.predict import predict
from invrender.transport.transfer import light_elements
from recon.harmonics.basis import to_degree
from recon.harmonics.latlong import map_coefficients
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]
Entry = dict[str, Any]

# What is told of the light, or of that under which a BRDF is tried out.
LIGHT = Stage().lighting
OTHER_LIGHT = Stage(areas=(OTHER_AREA,), sources=(OTHER_SOURCE,)).lighting


def known(name: str, photos: Sequence[LightField]) -> Entry:
    """Ours, under known light."""
    begun = time.perf_counter()
    elements = light_elements(LIGHT)
    solution = factorize([photo_columns("light", elements, photo) for photo in photos], [LIGHT])
    return _told(name, solution.brdf, time.perf_counter() - begun)


def known_as_published(transfer: str) -> Callable[[str, Sequence[LightField]], Entry]:
    """RH01's section 6.1, under known light."""

    def measure(name: str, photos: Sequence[LightField]) -> Entry:
        begun = time.perf_counter()
        found = published_brdf(photos, LIGHT, transfer, MATERIALS[name].mu is not None)  # type: ignore[arg-type]
        return _told(name, found.brdf, time.perf_counter() - begun)

    return measure


def unknown(transfer: str, ladder: bool) -> Callable[[str, Sequence[LightField]], Entry]:
    """Ours, the light unknown."""

    def measure(name: str, photos: Sequence[LightField]) -> Entry:
        begun = time.perf_counter()
        solution = factorize_blind(photos, ladder=ladder, transfer=transfer)  # type: ignore[arg-type]
        seconds = time.perf_counter() - begun
        brdf = Microfacet(1 - solution.brdf_share, solution.brdf_share, solution.mu, solution.sigma)
        light = to_degree(solution.light.normalised_coefficients, LIGHT_DEGREE)
        entry = _factored(name, brdf, solution.light.sources.directions, light, seconds)
        return entry | {
            "model": solution.model,
            "view": unseen_ratio(name, lambda field: predict_blind(solution, field), False, False),
        }

    return measure


def unknown_as_published(
    solve: Callable[..., PublishedFactors],
) -> Callable[[str, Sequence[LightField]], Entry]:
    """RH01's section 6.3, the light unknown; metals without Fresnel's factor, as in Fig. 11."""

    def measure(name: str, photos: Sequence[LightField]) -> Entry:
        begun = time.perf_counter()
        found = solve(photos, fresnel=MATERIALS[name].mu is not None)
        seconds = time.perf_counter() - begun
        brdf = Microfacet(1 - found.share, found.share, found.mu, found.sigma)
        directions = np.zeros((0, 3)) if found.peak is None else found.peak.direction[None]
        entry = _factored(name, brdf, directions, published_light(found), seconds)
        return entry | {"view": unseen_ratio(name, found.radiance, False, False)}

    return measure


def published_light(found: PublishedFactors) -> Floats:
    """Coefficients (49, 3) of the published procedure's light over that of degree 0."""
    coefficients = map_coefficients(found.light, LIGHT_DEGREE)
    return np.asarray(coefficients / coefficients[0])


KNOWN: Mapping[str, Callable[[str, Sequence[LightField]], Entry]] = {
    "exact": known,
    **{
        f"published, {transfer}": known_as_published(transfer) for transfer in ("mirror", "filtered", "exact")
    },
}
UNKNOWN: Mapping[str, Callable[[str, Sequence[LightField]], Entry]] = {
    "exact": unknown("exact", ladder=True),
    "exact, one model": unknown("exact", ladder=False),
    "filtered": unknown("filtered", ladder=False),
    "mirror": unknown("mirror", ladder=False),
    "published": unknown_as_published(published_factors),
    "published, direct": unknown_as_published(published_factors_direct),
}


def source_z(solution: BlindSolution) -> float | None:
    """The angle between the source and the truth in its standard deviations; None unless there is one source."""
    if len(solution.light.sources.directions) != 1:
        return None
    # The larger deviation of two ways, of which a direction's error is the root sum of squares.
    off = _degrees_off(solution.light.sources.directions)
    return None if off is None else off / (float(solution.light.sources.direction_std_deg[0]) * np.sqrt(2))


def _told(name: str, brdf: Microfacet, seconds: float) -> Entry:
    truth = MATERIALS[name]
    return {
        "kd": float(np.abs(brdf.kd / truth.kd - 1).max()),
        "ks": float(np.abs(brdf.ks / truth.ks - 1).max()),
        **_scalars(brdf),
        "view": unseen_ratio(name, _predictor(brdf, LIGHT), False, False),
        "light": unseen_ratio(name, _predictor(brdf, OTHER_LIGHT), True, False),
        "seconds": seconds,
    }


def _factored(name: str, brdf: Microfacet, directions: Floats, light: Floats, seconds: float) -> Entry:
    truth = MATERIALS[name]
    off = brdf.ks / (brdf.kd + brdf.ks) - truth.ks / (truth.kd + truth.ks)
    return {
        "share": float(np.abs(off).max()),
        **_scalars(brdf),
        "source": _degrees_off(directions),
        "nine": float(np.abs((light - true_coefficients())[:9]).max()),
        "light": unseen_ratio(name, _predictor(brdf, OTHER_LIGHT), True, True),
        "coefficients": numbers(light),
        "seconds": seconds,
    }


def _scalars(brdf: Microfacet) -> Entry:
    share = brdf.ks / np.maximum(brdf.kd + brdf.ks, 1e-300)
    return {"found share": share.tolist(), "found mu": brdf.mu, "found sigma": brdf.sigma}


def _degrees_off(directions: Floats) -> float | None:
    if len(directions) != 1:
        return None
    return float(np.degrees(2 * np.arcsin(np.linalg.norm(directions[0] - SOURCE.direction) / 2)))


def _predictor(brdf: Microfacet, lighting: Lighting) -> Callable[[LightField], Floats]:
    elements = light_elements(lighting)
    ones = np.ones((len(elements), 3))
    return lambda field: predict(brdf, elements, ones, field)
