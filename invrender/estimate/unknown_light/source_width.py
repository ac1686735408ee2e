"""What lamps that are no points put elsewhere, and how wide photographs show them to be.

The mean of f over a disc of angular radius a about d is f(d) + (a^2 / 8) Laplacian f(d), to the first order: the square
of a lamp's radius is one more number that radiance is linear in, beside all that was fitted. In half-vectors, which
grazing light stretches, a wide lamp is no wide lobe, so that the two can be separated.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from invrender.estimate.unknown_light.lighting_design import LightingDesign
from invrender.estimate.unknown_light.projection import BlindFit, arrows_at, reduced, shared_rows
from invrender.estimate.unknown_light.rows import LightingRows, source_rows
from invrender.estimate.unknown_light.source_evidence import design_effect
from invrender.estimate.unknown_light.start import Search
from invrender.estimate.unknown_light.state import turn

Floats = NDArray[np.float64]

# Angular distance, radians, over which the Laplacian is taken.
_STEP = 0.02
# Standard deviations beyond which a lamp is seen to be wide.
_SEEN = 2.0


@dataclass(frozen=True, eq=False)
class SourceWidths:
    """How wide lamps look, and what this would change.

    radii : (j,) radians, of discs of even radiance; 0 of lamps that may be points. moved : (t,), change of what was
    fitted, as `State.names` lists it, were they so wide. light_moved : (k + j, 3) of each lighting, likewise.
    """

    radii: Floats
    moved: Floats
    light_moved: Mapping[int, Floats]


def source_widths(search: Search, fit: BlindFit, precision: Floats, noise: float) -> SourceWidths:
    """How wide the lamps look from a fit that has them as points, by one Gauss-Newton step over all unknowns.

    precision : (t,), what is known beforehand of the nonlinear parameters. noise : variance in units of the weights'.
    """
    t, count = len(fit.state.names), len(fit.state.directions)
    radii, moved = np.zeros(count), np.zeros(t)
    light_moved = {lighting: np.zeros_like(light) for lighting, light in fit.light.items()}
    equations = reduced(arrows_at(search.designs, search.weights, fit, _rows)) if count else None
    # What a model of the light or of the material lacks looks like a width, too.
    witnesses = design_effect(search, fit, search.lightings)
    wide = np.arange(count)
    while equations is not None and len(wide):
        free = np.concatenate([np.arange(t), t + wide])
        corner = equations.corner[np.ix_(free, free)] / noise
        corner[:t, :t] += np.diag(precision)
        covariance = np.linalg.inv(corner)
        # The nonlinear parameters are at their optimum: what a width changes of them it does by itself.
        squared = covariance[t:, t:] @ equations.right[t + wide] / noise
        seen = squared > _SEEN * np.sqrt(witnesses * np.diag(covariance)[t:])
        if seen.all():
            radii[wide] = np.sqrt(squared)
            moved = covariance[:t, t:] @ equations.right[t + wide] / noise
            step = np.concatenate([moved, squared])
            light_moved = {k: -(by[:, :, free] @ step).T for k, by in equations.leverage.items()}
            break
        wide = wide[seen]
    return SourceWidths(radii, moved * fit.state.scales(), light_moved)


def _rows(design: LightingDesign, fit: BlindFit, rows: LightingRows) -> Floats:
    """Jacobian (3, n, t + j) of a design's samples: the squared radii after all other shared parameters."""
    return np.concatenate([shared_rows(design, fit, rows), _columns(design, fit)], axis=-1)


def _columns(design: LightingDesign, fit: BlindFit) -> Floats:
    """Derivatives (3, n, j) of a photograph's radiance by the squared radii (radians^2) of all sources."""
    state = fit.state.under(design.lighting)
    columns = np.zeros((3, len(design.field), len(fit.state.directions)))
    if not len(state.directions):
        return columns

    def lit(way: Floats) -> Floats:
        directions = np.array([turn(direction, *way) for direction in state.directions])
        rows = source_rows(design, replace(state, directions=directions))
        return rows.of_channels(state.specular_share)

    around = [lit(_STEP * way) for way in (*np.eye(2), *-np.eye(2))]
    laplacian = (np.sum(around, axis=0) - 4 * lit(np.zeros(2))) / _STEP**2
    irradiances = fit.light[design.lighting][-len(state.directions) :]
    columns[:, :, fit.state.owners == design.lighting] = laplacian / 8 * irradiances.T[:, None, :]
    return columns
