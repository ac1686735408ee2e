"""What errors of calibration that a scene states will do to the numbers of its fit, by the fit's own scores."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from invrender.estimate.calibration import WeighedPhoto, calibration_scores, is_mapped, some_rays
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
    weighted: Sequence[Floats],
) -> dict[str, Floats]:
    """Scores (t, q) of each cause, as `calibration_scores` has them, in the shared numbers under known light.

    fields : of each photograph, its samples. weighted : (3, n, t) of each, derivatives of their radiance times weights.
    """
    views, elements, strengths = experiment.views, made.elements, np.ones((1, 3))
    photos = (
        WeighedPhoto(
            view.name,
            experiment.lights[view.light].lighting.name,
            SeenBody(view.camera, experiment.body),
            field,
            list(stands_for * own[:, keep]),
            PhotoRadiance(made.brdf, Light(elements[view.light], strengths), field, made.shadows),
            strengths,
        )
        for view, own, (keep, field, stands_for) in zip(
            views, weighted, some_rays(fields, is_mapped(elements)), strict=True
        )
    )
    lightings = {light.lighting.name: light.lighting for light in experiment.lights}
    return calibration_scores(photos, experiment.body, experiment.found_place, experiment.errors, lightings)
