"""A solution in unknown light in the scale that references fix, with what the fit leaves open of the light on them.

Kd is uncertain where light is, and the more of one is the less of the other: what a base sends is known far better than
either. So the error bars of absolute numbers are those of products, by the joint covariance of reflectance and light.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from capture.lighting import Lighting, cosines, seen_from
from invrender.estimate.reference_scale import ReferenceScale, check_under, places_of
from invrender.estimate.unknown_light.solution import BlindLight, BlindSolution
from invrender.estimate.unknown_light.state import turns
from invrender.theory.operator import irradiance_operator
from recon.harmonics.basis import degree_of
from recon.reference import Reference

Floats = NDArray[np.float64]

# Step of directions, radians, and of closeness, shares of itself, that shows what they do to irradiance.
_STEP = 1e-4


@dataclass(frozen=True, eq=False)
class AbsoluteBlind:
    """A solution's numbers in an absolute scale.

    scale : what the references say. covariance : (t + 3, t + 3), of the solution's numbers as
    `BlindSolution.covariance_names` has them, and of the logarithms of the scale's factors. lights : by name, in that
    scale.
    """

    scale: ReferenceScale
    covariance: Floats
    lights: Mapping[str, BlindLight]


def absolute_blind(
    solution: BlindSolution, references: Sequence[Reference], structured: float = 0.0
) -> AbsoluteBlind:
    """A solution in the scale of references.

    structured : share of the radiance that the fit leaves beyond noise; by so much is irradiance off, too.
    Raises ValueError where a reference is under a light that no fitted photograph is under, or faces away from it.
    """
    lights = solution.lights
    under = scale_under(lights, references)
    scale = under.scale
    joint = _JointSlopes.of(solution, under)
    own = scale.own_std**2 + structured**2
    covariance = joint.covariance.copy()
    covariance[-3:, -3:] += np.diag(own)
    scaled = {}
    for number, (name, light) in enumerate(lights.items()):
        std = np.sqrt(joint.variances_over(number, light) + own)
        level = np.abs(light.numbers[0])
        # What is zero in the fit isn't so for certain.
        std = np.where(level > 0, std * level, light.numbers[1])
        scaled[name] = light.with_std(std).times(1 / scale.factor)
    return AbsoluteBlind(scale, covariance, scaled)


@dataclass(frozen=True, eq=False)
class ScaleUnder:
    """What references say of the scale of recovered lights.

    scale : the references. slopes : of its factor's logarithm by the numbers of lights by name, (p, 3): coefficients
    and then the sources' irradiances.
    """

    scale: ReferenceScale
    slopes: Mapping[str, Floats]


def scale_under(lights: Mapping[str, BlindLight], references: Sequence[Reference]) -> ScaleUnder:
    """What references say of the scale of lights by name.

    Raises ValueError where a reference is under another light, or faces away from it.
    """
    check_under(references, lights)

    def falls(reference: Reference, normals: Floats) -> Floats:
        light = lights[reference.lighting]
        return np.asarray(_rows(light, reference, normals) @ light.numbers[0])

    scale = ReferenceScale.of(references, falls)
    slopes = {name: np.zeros_like(light.numbers[0]) for name, light in lights.items()}
    for reference, weight in zip(references, scale.weights, strict=True):
        light = lights[reference.lighting]
        rows = reference.mean(_rows(light, reference, reference.normals))
        slopes[reference.lighting] += weight * rows[:, None] / (rows @ light.numbers[0])
    return ScaleUnder(scale, slopes)


def _of_sources(lighting: Lighting, reference: Reference, normals: Floats) -> Floats:
    """What unit irradiance of each source gives of pixels of a reference, (n, k), with normals (n, 3)."""
    directions, factors = seen_from(lighting.sources, places_of(reference, lighting.sources))
    return np.asarray(np.clip(cosines(normals, directions), 0, 1) * factors)


def _rows(light: BlindLight, reference: Reference, normals: Floats) -> Floats:
    """Irradiance (n, p) of a reference's pixels per unit of a light's numbers."""
    sky = irradiance_operator(normals, degree_of(len(light.coefficients)))
    return np.hstack([sky, _of_sources(light.sources.lighting, reference, normals)])


@dataclass(frozen=True, eq=False)
class _JointSlopes:
    """How the logarithm of the irradiance on references moves, and what that leaves it uncertain by.

    by_light : (3, p) of each lighting's numbers. together : (3, t), with shared numbers, lights giving way to them.
    excess : (p, 3) of each lighting, variances of its numbers beyond those of noise.
    """

    solution: BlindSolution
    by_light: Mapping[int, Floats]
    together: Floats
    excess: Mapping[int, Floats]

    @staticmethod
    def of(solution: BlindSolution, under: ScaleUnder) -> _JointSlopes:
        certainty, names = solution.certainty, list(solution.lights)
        by_light = {names.index(name): slopes.T for name, slopes in under.slopes.items()}
        direct = np.zeros((3, len(solution.covariance_names)))
        for reference, weight in zip(under.scale.references, under.scale.weights, strict=True):
            light = solution.lights[reference.lighting]
            rows = reference.mean(_rows(light, reference, reference.normals))
            for place, slope in _source_slopes(solution, names.index(reference.lighting), light, reference):
                direct[:, place] += weight * slope / (rows @ light.numbers[0])
        together = direct - sum(
            np.einsum("cpt,cp->ct", certainty.leverage[number], own) for number, own in by_light.items()
        )
        excess = {}
        for number, light in enumerate(solution.lights.values()):
            std = light.numbers[1]
            excess[number] = np.maximum(std**2 - _variances(solution, number), 0)
        return _JointSlopes(solution, by_light, np.asarray(together), excess)

    @cached_property
    def covariance(self) -> Floats:
        """(t + 3, t + 3), of the shared numbers and of log irradiance."""
        shared = self.solution.covariance
        across = shared @ self.together.T
        among = self.together @ across + np.diag(
            sum(
                np.einsum("cp,cpq,cq->c", own, self.solution.certainty.alone[number], own)
                + np.einsum("cp,pc->c", own**2, self.excess[number])
                for number, own in self.by_light.items()
            )
        )
        return np.block([[shared, across], [across.T, among]])

    def variances_over(self, number: int, light: BlindLight) -> Floats:
        """Squared shares (p, 3) by which a light's numbers over the irradiance on the references are uncertain."""
        certainty, shared = self.solution.certainty, self.solution.covariance
        among = np.diag(self.covariance)[-3:]
        found = np.zeros((len(light.numbers[0]), 3))
        for c in range(3):
            level = light.numbers[0][:, c]
            across = -certainty.leverage[number][c] @ shared @ self.together[c]
            across += certainty.alone[number][c] @ self.by_light[number][c]
            across += self.excess[number][:, c] * self.by_light[number][c]
            own = _variances(self.solution, number)[:, c] + self.excess[number][:, c]
            over = own - 2 * level * across + level**2 * among[c]
            found[:, c] = np.maximum(over, 0) / np.maximum(level**2, 1e-300)
        return found


def _variances(solution: BlindSolution, number: int) -> Floats:
    """Variances (p, 3) of a light's numbers by the joint covariance."""
    certainty = solution.certainty
    lever, alone = certainty.leverage[number], certainty.alone[number]
    shared = np.einsum("cpt,tu,cpu->pc", lever, solution.covariance, lever)
    return np.asarray(np.einsum("cpp->pc", alone) + shared)


def _source_slopes(
    solution: BlindSolution, number: int, light: BlindLight, reference: Reference
) -> list[tuple[int, Floats]]:
    """Places among the shared numbers of what moves a light's sources, and slopes (3,) of the irradiance with it."""
    state, sources = solution.candidates[solution.chosen].fit.state, light.sources
    first = len(state.names) - state.numbers_of_sources
    own = np.flatnonzero(state.owners == number)

    def fallen(lighting: Lighting) -> Floats:
        return reference.mean(_of_sources(lighting, reference, reference.normals))

    here, found = fallen(sources.lighting), []
    for k, place in enumerate(own.tolist()):
        for way, turned in enumerate(turns(sources.directions[k][None], _STEP)[0]):
            directions = sources.directions.copy()
            directions[k] = turned
            there = fallen(replace(sources.lighting, directions=directions))
            found.append((first + 2 * place + way, (there - here)[k] / _STEP * sources.irradiances[k]))
        if place in state.near and sources.closeness is not None and state.closeness is not None:
            closeness = sources.closeness.copy()
            closeness[k] *= 1 + _STEP
            there = fallen(replace(sources.lighting, closeness=closeness))
            slope = (there - here)[k] / (_STEP * state.closeness[place]) * sources.irradiances[k]
            found.append((first + 2 * len(state.directions) + state.near.index(place), slope))
    return found
