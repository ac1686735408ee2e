"""What crossed filters pass of the lobe in unknown light, from the joint equations of light, BRDF and extinction."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from capture.polarisation import Extinction
from invrender.estimate.extinction import PassedLobe, stepped
from invrender.estimate.unknown_light.calibration import search_at
from invrender.estimate.unknown_light.lighting_design import LightingDesign
from invrender.estimate.unknown_light.projection import BlindFit, arrows_at, predicted, reduced, shared_rows
from invrender.estimate.unknown_light.rows import LightingRows
from invrender.estimate.unknown_light.solution import BlindSolution
from invrender.transport.visibility import Shadows
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]


def improve_blind_extinction(
    solution: BlindSolution,
    photos: Sequence[LightField],
    lighting_of: Sequence[str],
    shadows: Shadows | None,
    extinction: Extinction,
) -> Extinction:
    """The extinction a step further; as it was where no lobe is seen. photos : as `with_calibration` has them."""
    state = solution.candidates[solution.chosen].fit.state
    if state.sigma is None:
        return extinction
    whole = [(np.ones(len(field), bool), field) for field in photos]
    search = search_at(solution, photos, whole, lighting_of, shadows)
    fit = search.at(state, solution.l_max)

    def passed(design: LightingDesign, fit: BlindFit, rows: LightingRows, weight: Floats) -> PassedLobe:
        lobe = fit.state.specular_share * rows.parts(fit.light[design.lighting])[1]
        return PassedLobe.of(design.field, lobe, design.radiance - predicted(design, fit, rows), weight)

    def jacobian(design: LightingDesign, fit: BlindFit, rows: LightingRows) -> Floats:
        own = passed(design, fit, rows, np.ones((len(design.field), 3))).by_extinction
        return np.concatenate([shared_rows(design, fit, rows), own.T[..., None]], axis=-1)

    equations = reduced(arrows_at(search.designs, search.weights, fit, jacobian))
    parts = zip(search.designs, fit.rows, search.weights, strict=True)
    seen = [passed(design, fit, rows, weight) for design, rows, weight in parts]
    return stepped(extinction, equations.corner, equations.right, seen)
