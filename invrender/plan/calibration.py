"""What errors of calibration that a scene states will do to the numbers of its fit, by the fit's own scores.

In unknown light, scores of the BRDF come before those of each light, as `information.Posterior` takes them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from invrender.estimate.calibration import calibration_scores, is_mapped, some_rays
from invrender.estimate.unknown_light.calibration import WeighedLitPhoto
from invrender.gradients.slopes import Light, PhotoRadiance
from invrender.plan.experiment import Experiment
from invrender.plan.shown import PlannedObject
from recon.displacement.rays import SeenBody
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]


def planned_scores(
    experiment: Experiment,
    made: PlannedObject,
    fields: Sequence[LightField],
    weighted: Sequence[tuple[Floats, Floats]],
) -> dict[str, Floats]:
    """Scores (t + l, q) of each cause, as `calibration_scores` has them: in the shared numbers, then in each light's.

    fields : of each photograph, its samples. weighted : (3, n, p) and (3, n, t) of each, derivatives of their radiance
    by its light's numbers and the shared ones, times weights.
    """
    views, elements, strengths = experiment.views, made.elements, np.ones((1, 3))
    *starts, total = np.cumsum([0, *(3 * light.size for light in made.unknowns.lights)]).tolist()
    photos = (
        WeighedLitPhoto(
            view.name,
            experiment.lights[view.light].lighting.name,
            SeenBody(view.camera, experiment.body),
            field,
            list(stands_for * shared[:, keep]),
            PhotoRadiance(made.brdf, Light(elements[view.light], strengths), field, made.shadows),
            strengths,
            list(stands_for * lit[:, keep]),
            starts[view.light],
            total,
        )
        for view, (lit, shared), (keep, field, stands_for) in zip(
            views, weighted, some_rays(fields, is_mapped(elements)), strict=True
        )
    )
    lightings = {light.lighting.name: light.lighting for light in experiment.lights if light.known}
    return calibration_scores(photos, experiment.body, experiment.found_place, experiment.errors, lightings)
