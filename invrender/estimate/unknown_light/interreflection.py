"""Light that bounces between an object's parts where its light is unknown, and so its albedo.

As in known light (`interreflection`) fit and prediction take turns, and the photographs judge. The light that was
recovered shows what falls on each part, but for a scale that photographs in unknown light don't fix. How much of it is
sent on hangs on the albedo alone. That is one more number per channel: the one with which the light, solved for beside
it, leaves least of the photographs unexplained.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BarycentricInterpolator
from scipy.linalg import cho_factor, cho_solve

from invrender.brdf.microfacet import Microfacet
from invrender.estimate.clusters import tiles_of
from invrender.estimate.interreflection import (
    MATTERS,
    SUPPOSED,
    Interreflection,
    asked_for,
    highest_share,
    left_of,
    rms,
    settled,
)
from invrender.estimate.unknown_light import BlindSolution
from invrender.estimate.unknown_light.cross_validation import cross_validate
from invrender.estimate.unknown_light.identifiability import quantities_of
from invrender.estimate.unknown_light.lighting_design import LightingDesign
from invrender.estimate.unknown_light.projection import BlindFit, light_scale, predicted
from invrender.estimate.unknown_light.source_evidence import design_effect
from invrender.estimate.unknown_light.start import Search, thinned
from invrender.estimate.unknown_light.state import BlindState
from invrender.transport.diffuse_base import base_irradiance, sky_factors
from invrender.transport.radiosity import BRIGHTEST, Bounced, ConcaveMesh
from invrender.transport.transfer import LightElement
from invrender.transport.visibility import Shadows
from recon.harmonics.basis import degree_of, evaluate_harmonics
from recon.mesh.tangents import tangents
from recon.sampling.lightfield import LightField, pools

Floats = NDArray[np.float64]

# Samples, in all or of each lighting, by which what bounces is judged.
_SAMPLES, _PER_LIGHTING = 6000, 1500
# Albedos at which what bounces is computed; between them it is interpolated at those that are compared.
_NODES = BRIGHTEST * (1 - np.cos(np.pi * np.linspace(0, 1, 6))) / 2
_ALBEDOS = np.linspace(0, BRIGHTEST, 400)
# Iterations of fits that start near their end, and of those that start where bounced light had drawn them.
_FEW, _MORE = 6, 12
# Squared residuals in noise units that an albedo must save, per log of the count of numbers [Schwarz 1978's criterion].
_PER_ALBEDO = 5
# How often the ladder of models is climbed with bounced light taken off, at most; of what the model leaves unexplained,
# the share (RMS) that what is taken off must change by for another time.
_LADDERS, _STEADY = 2, 0.1


@dataclass(frozen=True, eq=False)
class Sent:
    """What an object's parts send each other under recovered lightings.

    bounced : by the lighting's number. brdf : which reflects it towards the camera. albedo : (3,), of the parts.
    """

    parts: ConcaveMesh
    bounced: Mapping[int, Bounced]
    brdf: Microfacet
    albedo: Floats

    def radiance(self, lighting: int, field: LightField) -> Floats:
        """Radiance (n, 3) of samples by it."""
        return self.bounced[lighting].radiance(field, self.brdf)

    def of(self, search: Search) -> list[Floats]:
        """Its radiance (n, 3) in each design."""
        return [self.radiance(design.lighting, design.field) for design in search.designs]


@dataclass(frozen=True, eq=False)
class CorrectedSolution:
    """A solution with bounced light accounted for.

    sent : what was taken off; None if nothing was, which then is in the photographs' numbers.
    """

    blind: BlindSolution
    found: Interreflection
    sent: Sent | None


def account_for_bounces(
    parts: ConcaveMesh,
    photos: Sequence[LightField],
    lighting_of: Sequence[str],
    blind: BlindSolution,
    factorize: Callable[[list[LightField]], BlindSolution],
) -> CorrectedSolution | None:
    """Take light that bounces off photographs in unknown light if they bear it out; None where it can't matter.

    blind : the solution of the photographs as they are. factorize : that of photographs without what bounces.
    """
    numbers = [list(blind.lights).index(name) for name in lighting_of]
    search, plain = _refitted(blind, photos, numbers, parts.shadows)
    radiance = [design.radiance for design in search.designs]
    once = _sent(parts, plain, np.full(3, SUPPOSED))
    if rms(once.of(search)) < MATTERS * rms(radiance):
        return None
    sent, better = None, blind
    for _ in range(_LADDERS):
        agreed = _agreed(parts, search, plain)
        if agreed is None:
            break
        before, sent = sent, agreed
        taken = [sent.radiance(*pair) for pair in zip(numbers, photos, strict=True)]
        if before is not None:
            earlier = [before.radiance(*pair) for pair in zip(numbers, photos, strict=True)]
            change = rms([new - old for new, old in zip(taken, earlier, strict=True)])
            if change < _STEADY * better.candidates[better.chosen].error * rms(radiance):
                sent, taken = before, earlier
                break
        corrected = [_less(photo, off) for photo, off in zip(photos, taken, strict=True)]
        better = factorize(corrected)
        search, plain = _refitted(better, photos, numbers, parts.shadows)
    if sent is not None:
        found, moved = _judged(search, plain, sent)
        if found.taken_off:
            trust = [own.trust for own in better.weights]
            shares = left_of([photo.radiance for photo in photos], trust, taken)
            candidates = tuple(
                replace(candidate, photo_errors=shares * candidate.photo_errors)
                for candidate in better.candidates
            )
            return CorrectedSolution(
                _widened(replace(better, candidates=candidates), search, moved), found, sent
            )
        search, plain = _refitted(blind, photos, numbers, parts.shadows)
    found, moved = _judged(search, plain, once, may_be=False)
    return CorrectedSolution(_widened(blind, search, moved), found, None)


def _refitted(
    blind: BlindSolution, photos: Sequence[LightField], numbers: Sequence[int], shadows: Shadows
) -> tuple[Search, BlindFit]:
    """Some samples of photographs as they are, weighed as a solution has them, and its model fitted to these."""
    together = pools(photos, numbers)
    designs = [
        LightingDesign.of([photos[k] for k in pool], 0, numbers[pool[0]], blind.transfer, shadows)
        for pool in together
    ]
    weights, trust = (
        [np.concatenate([getattr(blind.weights[k], name) for k in pool]) for pool in together]
        for name in ("weight", "trust")
    )
    search = Search(designs, weights, trust, light_scale(designs))
    search = thinned(search, blind.l_max, _SAMPLES, _PER_LIGHTING)
    return search, search.fit(blind.candidates[blind.chosen].fit.state, blind.l_max, _FEW)


def _agreed(parts: ConcaveMesh, search: Search, plain: BlindFit) -> Sent | None:
    """What bounces by the fit without it, at the best albedo; None where it isn't worth three more numbers."""
    saved = _albedo(parts, search, plain)[1]
    numbers = search.numbers
    noise = plain.cost / numbers * design_effect(search, plain, search.lightings)
    if saved < 3 * _PER_ALBEDO * np.log(numbers) * noise:
        return None

    def predict(fit: BlindFit) -> list[Floats]:
        return _sent(parts, fit, _albedo(parts, search, fit)[0]).of(search)

    def refit(less: list[Floats]) -> BlindFit:
        return _without(search, less).fit(plain.state, plain.l_max, _MORE)

    agreed = settled(plain, predict, refit, [design.radiance for design in search.designs])
    return None if agreed is None else _sent(parts, agreed[1], _albedo(parts, search, agreed[1])[0])


def _sent(parts: ConcaveMesh, fit: BlindFit, albedo: Floats) -> Sent:
    bounced = {
        number: parts.exchanged(_irradiance(parts.shadows, fit.state.under(number), light), albedo)
        for number, light in fit.light.items()
    }
    return Sent(parts, bounced, fit.state.brdf, albedo)


def _irradiance(shadows: Shadows, state: BlindState, light: Floats) -> Floats:
    """Irradiance (v, 3) of vertices, as far as it counts for the base, by harmonic light and a state's sources.

    light : (k + j, 3), coefficients, then the sources' irradiances.
    """
    normals = shadows.body.mesh.normals
    sky, irradiances = np.split(light, [len(light) - len(state.directions)])
    lamps = LightElement("lamps", state.directions, irradiances)
    falls = base_irradiance(state.form, state.mu, lamps, normals, shadows.of_vertices(lamps))
    l_max = degree_of(len(sky))
    factors = sky_factors(state.form, state.mu, l_max)[:, None]
    return np.asarray(falls + evaluate_harmonics(normals, l_max) @ (factors * sky) - shadows.kept_off(sky))


def _albedo(parts: ConcaveMesh, search: Search, fit: BlindFit) -> tuple[Floats, float]:
    """The albedo (3,) with which a fit's BRDF and sources explain most, and the squared residuals that it saves.

    What bounces is predicted from the fit; the light's strengths and harmonics are solved for beside it.
    """
    state, shown = fit.state, [_sent(parts, fit, np.full(3, albedo)).of(search) for albedo in _NODES]
    between = BarycentricInterpolator(_NODES, np.eye(len(_NODES)))(_ALBEDOS)
    ways = np.hstack([np.ones((len(_ALBEDOS), 1)), -between])
    best, saved = np.zeros(3), 0.0
    for c in range(3):
        gram = np.zeros((ways.shape[1], ways.shape[1]))
        for number, whole in fit.grams.items():
            right = np.zeros((len(whole[c]), ways.shape[1]))
            for k, design in enumerate(search.designs):
                if design.lighting == number:
                    columns = np.column_stack([design.radiance[:, c], *(of[k][:, c] for of in shown)])
                    weighted = search.weights[k][:, c, None] * columns
                    gram += columns.T @ weighted
                    right += fit.rows[k].of_channel(state.specular_share[c]).T @ weighted
            gram -= right.T @ cho_solve(cho_factor(whole[c]), right)
        costs = np.einsum("ai,ij,aj->a", ways, gram, ways)
        best[c] = _ALBEDOS[costs.argmin()]
        saved += float(costs[0] - costs.min())
    return best, saved


def _judged(
    search: Search, plain: BlindFit, sent: Sent, may_be: bool = True
) -> tuple[Interreflection, tuple[Floats, dict[int, Floats]]]:
    """What photographs say of bounced light; by how much what isn't known of it moves the state (t,) and the lightings.

    plain : the fit to photographs as they are. may_be : whether it may be taken off.
    """
    less = sent.of(search)
    taken = _without(search, less)
    corrected = taken.fit(plain.state, plain.l_max, _MORE)
    shown = [design.radiance for design in search.designs]
    asked, asked_std = asked_for(
        [tiles_of(design.photos) for design in search.designs],
        search.weights,
        _residuals(search, plain),
        _residuals(taken, corrected),
    )
    radiance, trust, off = (
        [of for design, own in zip(search.designs, each, strict=True) for of in design.split(own)]
        for each in (shown, search.trust, less)
    )
    error = float((cross_validate("", taken, corrected).photo_errors * left_of(radiance, trust, off)).mean())
    as_they_are = cross_validate("", search, plain).error
    found = Interreflection(
        relative=rms(less) / rms(shown),
        highest=highest_share(less, shown),
        taken_off=may_be and error < as_they_are,
        asked=asked,
        asked_std=asked_std,
        error_with=error,
        error_without=as_they_are,
        without=plain.state.brdf,
        corrected=corrected.state.brdf,
        albedo=sent.albedo,
    )
    own, share = (corrected, 1 + found.doubt) if found.taken_off else (plain, found.doubt)
    there = _without(search, [share * of for of in less]).fit(own.state, own.l_max, _FEW)
    light = {number: there.light[number] - of for number, of in own.light.items()}
    return found, (_moved(own.state, there.state), light)


def _without(search: Search, less: Sequence[Floats]) -> Search:
    """The same with photographs whose radiance is lower by some (n, 3) in each design."""
    designs = [
        replace(design, field=_less(design.field, off))
        for design, off in zip(search.designs, less, strict=True)
    ]
    return replace(search, designs=designs)


def _less(field: LightField, off: Floats) -> LightField:
    return replace(field, radiance=field.radiance - off)


def _residuals(search: Search, fit: BlindFit) -> list[Floats]:
    return [
        design.radiance - predicted(design, fit, rows)
        for design, rows in zip(search.designs, fit.rows, strict=True)
    ]


def _moved(here: BlindState, there: BlindState) -> Floats:
    """By how much another state of the same model has each number elsewhere, (t,), as `BlindState.names` lists them."""
    numbers = [
        np.array([*state.specular_share, *(x for x in (state.mu, state.sigma) if x is not None)])
        for state in (here, there)
    ]
    of_brdf = numbers[1] - numbers[0] if here.sigma is not None else np.zeros(0)
    turns = np.einsum("kaj,kj->ka", tangents(here.directions), there.directions)
    return np.concatenate([of_brdf, turns.ravel()])


def _widened(blind: BlindSolution, search: Search, moved: tuple[Floats, dict[int, Floats]]) -> BlindSolution:
    """A solution whose standard deviations hold what isn't known of bounced light."""
    state, light = moved
    fit, own = blind.candidates[blind.chosen].fit, blind.certainty
    certainty = replace(
        own,
        covariance=own.covariance + np.diag(state**2),
        light_std={number: np.hypot(std, light[number]) for number, std in own.light_std.items()},
    )
    turns = np.degrees(np.abs(state[len(state) - 2 * len(fit.state.directions) :]).reshape(-1, 2).max(axis=1))
    lights = {}
    for number, (name, of) in enumerate(blind.lights.items()):
        size, std = len(of.coefficients), certainty.light_std[number]
        sources = replace(
            of.sources,
            irradiance_std=std[size:],
            direction_std_deg=np.hypot(of.sources.direction_std_deg, turns[fit.state.owners == number]),
        )
        lights[name] = replace(of, coefficients_std=std[:size], sources=sources)
    return replace(
        blind,
        lights=lights,
        quantities=quantities_of(fit, certainty, search.designs),
        covariance=certainty.covariance,
        certainty=certainty,
    )
