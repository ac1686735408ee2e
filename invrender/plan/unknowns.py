"""What is not known beforehand, in the layout of a fit: numbers that all photographs share, and those of each lighting.

All are counted in standard deviations of a weak prior, so that the prior's precision is the identity and the share
of a number that photographs determine is 1 less its variance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.microfacet import Microfacet
from invrender.estimate.jacobian import Parameters, pack
from invrender.estimate.models import Estimate, Model
from invrender.estimate.uncertainty import PRIOR_STD
from invrender.estimate.unknown_light.projection import prior_precision
from invrender.plan.experiment import PlannedLight
from recon.harmonics.basis import check_degree

Floats = NDArray[np.float64]

# Kd and Ks beforehand: up to so many times their sum.
_WEIGHT_PRIOR = 10.0
# Of a source's direction along either tangent, radians, and of its closeness: from anywhere.
_MOVE_PRIOR = 1.0
# The scale that light and BRDF share is taken for known to this.
_GAUGE_STD = 1e-4


@dataclass(frozen=True, eq=False)
class LightUnknowns:
    """A lighting's p numbers in each channel: coefficients, then its sources' irradiances; none where it is known.

    std : (3, p), the prior's. precision : (3, p, p), of the prior in its own units, with what the gauge adds. moves :
    places, among the shared numbers, of its sources' turns along two tangents, a pair each, then of their closeness, in
    the object's radii, as far as they are near. near : which of its sources these are.
    """

    std: Floats
    precision: Floats
    moves: slice
    near: tuple[int, ...] = ()

    @property
    def size(self) -> int:
        return self.std.shape[1]

    @property
    def turns(self) -> slice:
        return slice(self.moves.start, self.moves.stop - len(self.near))

    @property
    def closeness(self) -> slice:
        return slice(self.turns.stop, self.moves.stop)

    @property
    def sources(self) -> int:
        return (self.turns.stop - self.turns.start) // 2


@dataclass(frozen=True, eq=False)
class Unknowns:
    """What is not known of a set of photographs.

    estimate : the true BRDF, as a fit would find it. brdf : its numbers, which are the first of the t shared ones;
    moves of unknown lightings' sources follow. std : (t,), the prior's. lights : one per lighting.
    """

    estimate: Estimate
    brdf: Parameters
    std: Floats
    lights: tuple[LightUnknowns, ...]


def unknowns_of(
    brdf: Microfacet, lights: Sequence[PlannedLight], degree: int, gauge_light: int | None
) -> Unknowns:
    """The unknowns of photographs under some lights; degree : the highest of unknown ones' coefficients, >= 0.

    A priori a coefficient of any degree is as large as that of degree 0 of all the light: no light of this
    total has larger ones in the mean, and a single source has such. gauge_light : whose total sets the scale, if any.
    """
    check_degree(degree, "degree")
    model = Model("planned", brdf.sigma is not None, brdf.mu is not None)
    estimate = Estimate(model, brdf, {}, 0.0)
    parameters = pack(estimate, {})
    weight = np.maximum(brdf.kd + brdf.ks, 1e-3 * (brdf.kd + brdf.ks).max())
    prior = {"kd": _WEIGHT_PRIOR * weight, "ks": _WEIGHT_PRIOR * weight, **PRIOR_STD}
    std = [
        np.broadcast_to(prior[name], place.stop - place.start) for name, place in parameters.places.items()
    ]
    start, found = len(parameters.vector), []
    for k, light in enumerate(lights):
        sources, near = (0, 0) if light.known else (len(light.lighting.directions), len(light.near))
        moves = slice(start, start + 2 * sources + near)
        start = moves.stop
        found.append(_of_light(light, degree, moves, k == gauge_light))
    std.append(np.full(start - len(parameters.vector), _MOVE_PRIOR))
    return Unknowns(estimate, parameters, np.concatenate(std), tuple(found))


def _of_light(light: PlannedLight, degree: int, moves: slice, is_gauge: bool) -> LightUnknowns:
    if light.known:
        return LightUnknowns(np.zeros((3, 0)), np.zeros((3, 0, 0)), moves)
    total = np.maximum(light.total, 1e-3 * light.total.max())
    sources = len(light.lighting.directions)
    std = prior_precision(total / np.sqrt(4 * np.pi), degree, sources) ** -0.5
    precision = np.broadcast_to(np.eye(std.shape[1]), (3, std.shape[1], std.shape[1])).copy()
    if is_gauge:
        # What coefficients of degree 0 and irradiances add to the total of a channel's light.
        per_total = np.zeros(std.shape)
        per_total[:, 0] = np.sqrt(4 * np.pi)
        per_total[:, len(std[0]) - sources :] = 1
        held = per_total * std / total[:, None] / _GAUGE_STD
        precision += held[:, :, None] * held[:, None, :]
    return LightUnknowns(std, precision, moves, light.near)
