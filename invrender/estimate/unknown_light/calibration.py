"""What errors of calibration do to a fit in unknown light: to the BRDF, the sources and the light's harmonics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from capture.calibrationerrors import CalibrationErrors
from capture.camera import Camera
from invrender.estimate.calibration import WeighedPhoto, calibration_scores, some_rays
from invrender.estimate.unknown_light.cross_validation import joint_equations
from invrender.estimate.unknown_light.lamp_frame import LampFrame
from invrender.estimate.unknown_light.lighting_design import LightingDesign
from invrender.estimate.unknown_light.projection import light_scale, reduced
from invrender.estimate.unknown_light.solution import BlindSolution, sky_parts, with_certainty
from invrender.estimate.unknown_light.start import Search
from invrender.estimate.unknown_light.uncertainty import BlindUncertainty
from invrender.gradients.slopes import Light, PhotoRadiance
from invrender.transport.transfer import light_elements
from invrender.transport.visibility import Shadows
from recon.displacement.rays import SeenBody
from recon.mesh.bodies import Body
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]

# Share of each number's information that is added, so that what nothing tells of can be solved for.
_RIDGE = 1e-9


def with_calibration(
    solution: BlindSolution,
    photos: Sequence[LightField],
    labels: Sequence[str],
    cameras: Sequence[Camera],
    lighting_of: Sequence[str],
    body: Body,
    found: NDArray[np.bool_],
    errors: CalibrationErrors,
    shadows: Shadows | None,
) -> BlindSolution:
    """A solution whose standard deviations hold errors of calibration, too, as `calibration_scores` takes them.

    photos : the fitted ones, with their labels, cameras and lightings' names. found : (4,), what of a sphere's place
    its outlines gave.
    """
    if not errors.named:
        return solution
    kept = list(some_rays(photos, slow=solution.l_max > 0))
    search = search_at(solution, photos, [(keep, field) for keep, field, _ in kept], lighting_of, shadows)
    fit = search.at(solution.candidates[solution.chosen].fit.state, solution.l_max)
    sizes = {number: 3 * len(light) for number, light in fit.light.items()}
    starts = dict(zip(sizes, np.cumsum([0, *sizes.values()]).tolist(), strict=False))
    joint = joint_equations(search, fit)
    equations = reduced(joint.whole)
    weighed = []
    for k, (design, weight) in enumerate(zip(search.designs, search.weights, strict=True)):
        lit = fit.rows[k].of_channels(fit.state.specular_share)
        own = (joint.shared[k] - lit @ equations.leverage[design.lighting]) * weight.T[:, :, None]
        light = solution.lights[lighting_of[k]]
        sky = partial(_sky, solution, light.coefficients, shadows)
        lamps = Light(light_elements(light.sources.lighting), light.sources.irradiances)
        weighed.append(
            WeighedLitPhoto(
                labels[k],
                lighting_of[k],
                SeenBody(cameras[k], body),
                design.field,
                list(own),
                PhotoRadiance(fit.state.brdf, lamps, design.field, shadows, sky),
                lamps.strengths,
                list(lit * weight.T[:, :, None]),
                starts[design.lighting],
                sum(sizes.values()),
            )
        )
    scores = calibration_scores(weighed, body, found, errors, {})
    if not scores:
        return solution
    # A column for each error of one standard deviation.
    scored = np.hstack(list(scores.values()))
    ends = np.cumsum([own.shape[1] for own in scores.values()])[:-1]
    count = len(fit.state.names)
    off = np.linalg.solve(equations.corner + _RIDGE * np.diag(np.diag(equations.corner)), scored[:count])
    light_std: dict[int, Floats] = {}
    for number, std in solution.certainty.light_std.items():
        own_scores = scored[count + starts[number] :][: sizes[number]].reshape(3, -1, scored.shape[1])
        alone = np.stack([np.linalg.solve(*of) for of in zip(fit.grams[number], own_scores, strict=True)])
        moved = alone - equations.leverage[number] @ off
        light_std[number] = np.asarray(np.hypot(std, np.sqrt((moved**2).sum(axis=2)).T), float)
    stated = {
        cause: (parts**2).sum(axis=1)
        for cause, parts in zip(
            scores, np.split(fit.state.scales()[:, None] * off, ends, axis=1), strict=True
        )
    }
    certainty = replace(_beyond(solution.certainty, stated), light_std=light_std)
    return with_certainty(solution, certainty, search.designs)


def _beyond(certainty: BlindUncertainty, stated: Mapping[str, Floats]) -> BlindUncertainty:
    """Certainty that holds what errors move, variances (t,) by cause, and misfit as far as it exceeds this.

    Poses that are off leave residuals that repeat: as under known light, what these imply isn't counted twice.
    """
    misfit, explained = certainty.variances["misfit"], sum(stated.values())
    lacking = np.maximum(explained - misfit, 0)
    return replace(
        certainty,
        covariance=certainty.covariance + np.diag(lacking),
        causes={**certainty.causes, **stated},
    )


@dataclass(frozen=True, eq=False)
class WeighedLitPhoto(WeighedPhoto):
    """Some of a photograph's samples, and how much each counts in the shared numbers, then in all lights' (l).

    lit : per channel (n, k + j), derivatives of their radiance by their lighting times weights. first : where these
    numbers begin among the l of all lightings, channel by channel.
    """

    lit: Sequence[Floats]
    first: int
    total: int

    def score(self, change: Floats) -> Floats:
        by_light = np.zeros(self.total)
        own = np.concatenate([rows.T @ change[:, c] for c, rows in enumerate(self.lit)])
        by_light[self.first : self.first + len(own)] = own
        return np.concatenate([super().score(change), by_light])


def _sky(
    solution: BlindSolution, coefficients: Floats, shadows: Shadows | None, field: LightField
) -> tuple[Floats, Floats]:
    brdf = solution.candidates[solution.chosen].fit.state.brdf
    return sky_parts(brdf, coefficients, field, shadows, solution.transfer)


def search_at(
    solution: BlindSolution,
    photos: Sequence[LightField],
    kept: Sequence[tuple[NDArray[np.bool_], LightField]],
    lighting_of: Sequence[str],
    shadows: Shadows | None,
) -> Search:
    """Some samples, a design for each photograph, weighed as the solution has them."""
    names, frame = list(solution.lights), LampFrame.of(photos)
    designs = [
        LightingDesign.of([field], solution.l_max, names.index(name), solution.transfer, shadows, True, frame)
        for (_, field), name in zip(kept, lighting_of, strict=True)
    ]
    weights = [own.weight[keep] for own, (keep, _) in zip(solution.weights, kept, strict=True)]
    trust = [own.trust[keep] for own, (keep, _) in zip(solution.weights, kept, strict=True)]
    return Search(designs, weights, trust, light_scale(designs))
