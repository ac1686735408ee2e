"""Light that bounces between an object's parts where its light is unknown, and so its albedo.

The light that was recovered shows what falls on each part, but for a scale that photographs in unknown light don't fix.
How much of it is sent on hangs on the albedo alone. That is one more number per channel: the one with which the light,
solved for beside it, leaves least of the photographs unexplained. Three more numbers explain a little of any
photographs, so that they must be worth it before anything is taken off.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BarycentricInterpolator
from scipy.linalg import cho_factor, cho_solve

from invrender.estimate.clusters import tiles_of
from invrender.estimate.interreflection.correction import Correction, Sent, corrected, settled
from invrender.estimate.interreflection.known_light import SUPPOSED
from invrender.estimate.interreflection.statement import Interreflection, asked_for, of_all, stated
from invrender.estimate.unknown_light import BlindSolution
from invrender.estimate.unknown_light.alternatives import widened
from invrender.estimate.unknown_light.cross_validation import cross_validate
from invrender.estimate.unknown_light.lamp_frame import LampFrame
from invrender.estimate.unknown_light.projection import BlindFit
from invrender.estimate.unknown_light.solution import weighed_search, with_certainty
from invrender.estimate.unknown_light.source_evidence import design_effect
from invrender.estimate.unknown_light.start import Search, thinned
from invrender.estimate.unknown_light.state import BlindState
from invrender.transport.diffuse_base import base_irradiance, sky_factors
from invrender.transport.radiosity import BRIGHTEST, ConcaveMesh
from invrender.transport.transfer import LightElement
from invrender.transport.visibility import Shadows
from recon.harmonics.basis import degree_of, evaluate_harmonics
from recon.sampling.lightfield import LightField

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


@dataclass(frozen=True, eq=False)
class UnknownLightEvidence:
    """Some samples of photographs as they are, weighed as a solution has them, and its model fitted to these.

    names : of the lightings, by their numbers.
    """

    parts: ConcaveMesh
    names: Sequence[str]
    search: Search
    fit: BlindFit

    @property
    def shown(self) -> list[Floats]:
        return [design.radiance for design in self.search.designs]

    def sent(self, fit: BlindFit, albedo: Floats) -> Sent:
        """What parts of a given albedo (3,) send each other by a fit."""
        shadows, frame = self.parts.shadows, self.search.designs[0].frame
        bounced = {
            self.names[number]: self.parts.exchanged(
                _irradiance(shadows, fit.state.under(number), light, frame), albedo
            )
            for number, light in fit.light.items()
        }
        return Sent(self.parts, bounced, fit.state.brdf, albedo)

    def radiance(self, light: Sent) -> list[Floats]:
        return [light.radiance(self.names[design.lighting], design.field) for design in self.search.designs]

    def refitted(self, less: Sequence[Floats]) -> BlindFit:
        """The fit with some radiance (n, 3) of each design taken off."""
        return self.search.less(less).fit(self.fit.state, self.fit.l_max, _MORE)

    def agreed(self) -> Sent | None:
        def predicted(fit: BlindFit) -> Sent:
            return self.sent(fit, self._albedo(fit)[0])

        numbers, search = self.search.numbers, self.search
        noise = self.fit.cost / numbers * design_effect(search, self.fit, search.lightings)
        if self._albedo(self.fit)[1] < 3 * _PER_ALBEDO * np.log(numbers) * noise:
            return None
        fit = settled(
            self.fit,
            lambda fit: self.radiance(predicted(fit)),
            self.refitted,
            self.shown,
            lambda fit: fit.cost > self.fit.cost,
        )
        return None if fit is None else predicted(fit)

    def judged(self, light: Sent) -> Interreflection:
        less, search = self.radiance(light), self.search
        taken, without = search.less(less), self.refitted(less)
        shown, trust, off = (
            [of for design, own in zip(search.designs, each, strict=True) for of in design.split(own)]
            for each in (self.shown, search.trust, less)
        )
        (better,) = of_all([cross_validate("", taken, without)], shown, trust, off)
        asked = asked_for(
            [tiles_of(design.photos) for design in search.designs],
            search.weights,
            search.residuals(self.fit),
            taken.residuals(without),
        )
        errors = cross_validate("", search, self.fit).error, better.error
        brdfs = self.fit.state.brdf, without.state.brdf
        return stated(self.shown, less, asked, errors, brdfs, light.albedo)

    def _albedo(self, fit: BlindFit) -> tuple[Floats, float]:
        """The albedo (3,) with which a fit's BRDF and sources explain most, and the squared residuals that it saves.

        What bounces is predicted from the fit; the light's strengths and harmonics are solved for beside it.
        """
        state, shown = fit.state, [self.radiance(self.sent(fit, np.full(3, albedo))) for albedo in _NODES]
        between = BarycentricInterpolator(_NODES, np.eye(len(_NODES)))(_ALBEDOS)
        ways = np.hstack([np.ones((len(_ALBEDOS), 1)), -between])
        best, saved = np.zeros(3), 0.0
        for c in range(3):
            gram = np.zeros((ways.shape[1], ways.shape[1]))
            for number, whole in fit.grams.items():
                right = np.zeros((len(whole[c]), ways.shape[1]))
                for k, design in enumerate(self.search.designs):
                    if design.lighting == number:
                        columns = np.column_stack([design.radiance[:, c], *(of[k][:, c] for of in shown)])
                        weighted = self.search.weights[k][:, c, None] * columns
                        gram += columns.T @ weighted
                        right += fit.rows[k].of_channel(state.specular_share[c]).T @ weighted
                gram -= right.T @ cho_solve(cho_factor(whole[c]), right)
            costs = np.einsum("ai,ij,aj->a", ways, gram, ways)
            best[c] = _ALBEDOS[costs.argmin()]
            saved += float(costs[0] - costs.min())
        return best, saved


def correct_unknown_light(
    parts: ConcaveMesh,
    photos: Sequence[LightField],
    lighting_of: Sequence[str],
    blind: BlindSolution,
    factorized: Callable[[list[LightField], BlindSolution | None], BlindSolution],
) -> Correction[BlindSolution, Sent, UnknownLightEvidence] | None:
    """`correction.corrected` in unknown light, what isn't known of it in the standard deviations.

    blind : the solution of the photographs as they are. factorized : that of photographs without what bounces, near
    another such if there is one.
    """

    def solved(light: Sent, last: BlindSolution | None) -> tuple[BlindSolution, UnknownLightEvidence]:
        less = [light.radiance(name, photo) for name, photo in zip(lighting_of, photos, strict=True)]
        better = factorized([photo.less(off) for photo, off in zip(photos, less, strict=True)], last)
        shown, trust = [photo.radiance for photo in photos], [own.trust for own in better.weights]
        better = replace(better, candidates=of_all(better.candidates, shown, trust, less))
        return better, evidence_of(better)

    def evidence_of(solution: BlindSolution) -> UnknownLightEvidence:
        l_max, state = solution.l_max, solution.candidates[solution.chosen].fit.state
        whole = weighed_search(solution, photos, lighting_of, parts.shadows)
        search = thinned(whole, l_max, _SAMPLES, _PER_LIGHTING)
        return UnknownLightEvidence(parts, tuple(solution.lights), search, search.fit(state, l_max, _FEW))

    photographs = evidence_of(blind)
    once = photographs.sent(photographs.fit, np.full(3, SUPPOSED))
    # The light that predicts what bounces is itself of a fit that bounced light had spoilt.
    correction = corrected(blind, photographs, once, solved, times=2)
    if correction is None:
        return None
    solution, evidence, found = correction.solution, correction.evidence, correction.found
    less = evidence.radiance(correction.light)
    own = evidence.refitted(less) if found.taken_off else evidence.fit
    more = evidence.search.less([(found.taken_off + found.doubt) * of for of in less])
    certainty = widened(
        solution.certainty, own, [more.fit(own.state, own.l_max, _FEW)], [1.0], "bounced_light"
    )
    return replace(correction, solution=with_certainty(solution, certainty, evidence.search.designs))


def _irradiance(shadows: Shadows, state: BlindState, light: Floats, frame: LampFrame) -> Floats:
    """Irradiance (v, 3) of vertices, as far as it counts for the base, by harmonic light and a state's sources.

    light : (k + j, 3), coefficients, then the sources' irradiances. frame : of near ones.
    """
    mesh = shadows.body.mesh
    normals = mesh.normals
    sky, irradiances = np.split(light, [len(light) - len(state.directions)])
    lamps = LightElement("lamps", frame.world(state.sources), irradiances)
    seen = shadows.of_vertices(lamps)
    falls = base_irradiance(state.form, state.mu, lamps.at(mesh.vertices), normals, seen)
    l_max = degree_of(len(sky))
    factors = sky_factors(state.form, state.mu, l_max)[:, None]
    return np.asarray(falls + evaluate_harmonics(normals, l_max) @ (factors * sky) - shadows.kept_off(sky))
