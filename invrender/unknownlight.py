"""The main job where nothing is known of the lighting: light and BRDF from the same photographs."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from capture.lighting import Lighting
from capture.photoset import Photo, PhotoSet
from capture.progress import Track
from invrender.clock import Clock
from invrender.factorization import FittedLighting, HarmonicLight, Quantity
from invrender.findings import find_warnings
from invrender.model.microfacet import Microfacet
from invrender.reading import read_samples
from invrender.solve.blind import ORDERS, BlindSolution, factorize_blind, predict_blind
from invrender.solve.blind.state import State
from invrender.solve.clusters import structured_rms
from invrender.solve.evidence import Rung
from invrender.solve.factorize import Solution, unless_misfit
from invrender.solve.search import Estimate, Model
from invrender.solved import Solved, factorization
from invrender.specimen import Specimen
from invrender.theory.latlong import synthesise_latlong
from recon.lightfield import LightField

Floats = NDArray[np.float64]

_MAP_HEIGHT = 64
# Steps of the ladder: each order with a lobe and without, the first fit, and what may be left out.
_STEPS = 2 * len(ORDERS) + 4
_NO_SCALE = Quantity(
    None,
    None,
    "undetermined",
    "without highlights, photographs in unknown light show only the product of Kd and light",
    "measure the light, with a mirror ball say, or photograph something of known albedo beside the object",
)


def solve_unknown_light(
    photoset: PhotoSet,
    specimen: Specimen,
    samples: int,
    clock: Clock,
    track: Track,
    factorize: Callable[..., BlindSolution] = factorize_blind,
) -> Solved:
    """Recover the BRDF of a sphere, up to a scale per channel, and all of the one lighting on it.

    factorize : `factorize_blind`, or that with some of its options chosen.
    """
    _check_one_lighting(photoset)
    fields = read_samples(photoset, specimen.found, {}, samples, clock, track)
    fitted = [fields[photo.label] for photo in photoset.photos if not photo.held_out]
    with clock.on("invrender"):
        steps = iter(track(range(_STEPS), "Fitting light and BRDF"))
        next(steps)
        blind = factorize(fitted, on_step=lambda: next(steps, None))
        for _ in steps:
            pass
        residuals = {label: field.radiance - predict_blind(blind, field) for label, field in fields.items()}
        chosen = [residuals[photo.label] for photo in photoset.photos if not photo.held_out]
        solution = _solution(blind, photoset.photos[0].lighting, fitted, chosen)
    warnings = (*_sentences(blind.warnings), *find_warnings(photoset, solution, specimen, {}))
    result = factorization(photoset, specimen, solution, fields, residuals, warnings)

    def radiance(_: Photo, field: LightField) -> Floats:
        return predict_blind(blind, field)

    return Solved(result, fields, residuals, radiance)


def _check_one_lighting(photoset: PhotoSet) -> None:
    used = {photo.lighting for photo in photoset.photos}
    if len(used) > 1:
        raise ValueError(
            f"{photoset.manifest}: photographs are under {len(used)} lightings, one of them unknown; such light is"
            " recovered where all photographs share one lighting: process them in sets of their own"
        )


def _solution(
    blind: BlindSolution, name: str, fields: Sequence[LightField], residuals: Sequence[Floats]
) -> Solution:
    """The solution in the terms of those under known light; Kd + Ks is 1 in each channel."""
    rungs = tuple(
        Rung(
            Estimate(
                Model(
                    rung.name,
                    specular=rung.fit.state.sigma is not None,
                    fresnel=rung.fit.state.mu is not None,
                    form=rung.fit.state.form,
                ),
                _brdf(rung.fit.state),
                {},
                rung.fit.cost,
            ),
            rung.photo_errors,
            np.zeros(1),
            rung.parameters,
        )
        for rung in blind.rungs
    )
    names, of_brdf = _brdf_numbers(blind.covariance_names)
    trusted = [np.sqrt(own.trust) * residual for own, residual in zip(blind.weights, residuals, strict=True)]
    energy = np.sqrt(np.mean([np.mean(field.radiance**2) for field in fields]))
    return Solution(
        estimate=rungs[blind.chosen].estimate,
        rungs=rungs,
        chosen=blind.chosen,
        noise=blind.noise,
        weights=blind.weights,
        structured=structured_rms(fields, trusted) / float(energy),
        quantities=unless_misfit(_quantities(blind), rungs[blind.chosen].error),
        lightings=(_lighting(blind, name),),
        covariance=of_brdf @ blind.covariance @ of_brdf.T,
        covariance_names=names,
        gauge=blind.gauge,
    )


def _brdf(state: State) -> Microfacet:
    return Microfacet(1 - state.kappa, state.kappa, state.mu, state.sigma, state.form)


def _brdf_numbers(fitted: Sequence[str]) -> tuple[tuple[str, ...], Floats]:
    """Names of the BRDF's numbers, and how those that were fitted (t,) make them up, (n, t): Kd falls as Ks rises."""
    made_of: dict[str, dict[str, float]] = {}
    for name, sign in (("kd", -1.0), ("ks", 1.0)):
        made_of |= {f"{name}.{c}": {f"kappa {c}": sign} for c in "rgb" if f"kappa {c}" in fitted}
    made_of |= {name: {name: 1.0} for name in ("mu", "sigma") if name in fitted}
    parts = [[parts.get(name, 0.0) for name in fitted] for parts in made_of.values()]
    return tuple(made_of), np.array(parts).reshape(-1, len(fitted))


def _quantities(blind: BlindSolution) -> dict[str, Quantity]:
    quantities = {name: found for name, found in blind.quantities.items() if name != "lighting"}
    if blind.sigma is None:
        return {"kd": _NO_SCALE}
    # In this gauge the shares are Kd and Ks themselves.
    return {"kd": quantities["kd_normalised"], "ks": quantities["ks_normalised"], **quantities}


def _lighting(blind: BlindSolution, name: str) -> FittedLighting:
    # Harmonics ring below zero around what is sharp; a map of light is not negative.
    radiance = np.maximum(synthesise_latlong(blind.coefficients, _MAP_HEIGHT), 0).astype(np.float32)
    sources = blind.sources
    lighting = Lighting(
        name,
        radiance,
        sources.directions,
        np.maximum(sources.irradiances, 0),
        recover_irradiance=True,
        direction_std_deg=sources.direction_std_deg,
        origin="recovered",
    )
    doubt = blind.quantities.get("lighting")
    harmonics = HarmonicLight(
        blind.coefficients,
        blind.coefficients_std,
        blind.degree_shares,
        blind.determined_degree,
        "" if doubt is None else doubt.reason,
        "" if doubt is None else doubt.remedy,
    )
    return FittedLighting(lighting, sources.irradiance_std, None, None, harmonics)


def _sentences(texts: Sequence[str]) -> list[str]:
    return [f"{text[0].upper()}{text[1:]}." for text in texts]
