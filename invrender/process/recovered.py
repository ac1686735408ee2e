"""Numbers and lightings of a solution in unknown light, in the terms of those under known light."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.richer import NUMBER_RANGE
from invrender.estimate.evidence import MISFIT_REMEDY
from invrender.estimate.identifiability import assess_linear
from invrender.estimate.quantities import FittedLighting, HarmonicLight, scaled
from invrender.estimate.solution import Solution
from invrender.estimate.unknown_light import BlindLight, BlindSolution
from invrender.estimate.unknown_light.absolute_scale import AbsoluteBlind
from recon.harmonics.basis import degree_of
from recon.harmonics.latlong import project_latlong, synthesise_latlong

Floats = NDArray[np.float64]

_MAP_HEIGHT = 64
# Turns to a map that is nowhere negative; the degree up to which it keeps the light's harmonics.
_CUTS, _SHADED = 30, 4


def in_absolute_scale(solution: Solution, blind: BlindSolution, absolute: AbsoluteBlind) -> Solution:
    """A solution in the scale that references fix, its lightings too.

    blind : that it was made of.
    """
    factor, fitted = absolute.scale.factor, len(blind.covariance_names)
    kd, ks = (values * factor for values in (solution.brdf.kd, solution.brdf.ks))
    names, of_brdf = brdf_numbers(blind.covariance_names)
    if blind.sigma is None:
        names = tuple(f"kd.{c}" for c in "rgb")
        of_brdf = np.zeros((3, fitted))
    slopes = np.hstack([of_brdf, np.zeros((len(names), 3))])
    for k, name in enumerate(names):
        block, _, channel = name.partition(".")
        if channel:
            c = "rgb".index(channel)
            slopes[k] *= factor[c]
            slopes[k, fitted + c] = (kd if block == "kd" else ks)[c]
    covariance = slopes @ absolute.covariance @ slopes.T
    std = np.sqrt(np.diag(covariance))
    quantities = dict(solution.quantities)
    for name, values in (("kd", kd), ("ks", ks)):
        places = [names.index(own) for own in (f"{name}.{c}" for c in "rgb") if own in names]
        if not places or (name in quantities and quantities[name].remedy == MISFIT_REMEDY):
            continue
        found = assess_linear(values, std[places], kd + ks, name.capitalize())
        of_reference = (values * absolute.scale.own_std) ** 2
        quantities[name] = found.with_shares(
            {"reference": of_reference, "recovered_light": np.maximum(std[places] ** 2 - of_reference, 0)}
        )
    quantities["albedo"] = scaled(quantities["kd"], np.pi)
    lightings = [
        recovered_lighting(own.lighting.name, absolute.lights[own.lighting.name])
        if own.lighting.name in absolute.lights
        else own.dimmed(factor)
        for own in solution.lightings
    ]
    return replace(
        solution,
        estimate=replace(solution.estimate, brdf=replace(solution.brdf, kd=kd, ks=ks)),
        quantities=quantities,
        lightings=tuple(lightings),
        covariance=covariance,
        covariance_names=names,
        gauge=absolute.scale.in_words,
    )


def brdf_numbers(fitted: Sequence[str]) -> tuple[tuple[str, ...], Floats]:
    """Names of the BRDF's numbers, and how those that were fitted (t,) make them up, (n, t): Kd falls as Ks rises."""
    made_of: dict[str, dict[str, float]] = {}
    for name, sign in (("kd", -1.0), ("ks", 1.0)):
        made_of |= {f"{name}.{c}": {f"share {c}": sign} for c in "rgb" if f"share {c}" in fitted}
    made_of |= {name: {name: 1.0} for name in ("mu", "sigma", *NUMBER_RANGE) if name in fitted}
    parts = [[parts.get(name, 0.0) for name in fitted] for parts in made_of.values()]
    return tuple(made_of), np.array(parts).reshape(len(made_of), len(fitted))


def recovered_lighting(name: str, light: BlindLight) -> FittedLighting:
    """A recovered light as results have it."""
    radiance, sources = _map_of(light.coefficients), light.sources
    lighting = replace(sources.lighting, name=name, radiance_map=radiance, origin="recovered")
    doubt = light.doubt
    harmonics = HarmonicLight(
        light.coefficients,
        light.coefficients_std,
        light.degree_shares,
        light.determined_degree,
        "" if doubt is None else doubt.reason,
        "" if doubt is None else doubt.remedy,
    )
    return FittedLighting(lighting, sources.irradiance_std, None, None, harmonics)


def _map_of(coefficients: Floats) -> NDArray[np.float32]:
    """The map (64, 128, 3) of harmonics ((l_max + 1)^2, 3), nowhere negative.

    Harmonics ring below zero around what is sharp. A map cut there would be brighter than the light is: so it is cut
    and given back its harmonics up to the degree that shading shows, in turns [Youla & Webb 1982, eq. 2.1].
    """
    radiance = synthesise_latlong(coefficients, _MAP_HEIGHT)
    degree = min(_SHADED, degree_of(len(coefficients)))
    kept = coefficients[: (degree + 1) ** 2]
    for _ in range(_CUTS):
        cut = np.maximum(radiance, 0)
        radiance = cut + synthesise_latlong(kept - project_latlong(cut, degree), _MAP_HEIGHT)
    return np.maximum(radiance, 0).astype(np.float32)
