"""The side on which a source lies if only Lambertian shading shows it.

max(n.d, 0) = max(-n.d, 0) + n.d: a convex Lambertian body shows a lamp and its antipode alike where light of degree 1
beside it makes up for the difference, since it passes no other odd degree [RH01, section 5.1]. Only one fact separates
them: light is not negative, so its first moment, the integral of L w, can't be longer than its power, that of L.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from invrender.estimate.unknown_light.projection import BlindFit
from invrender.estimate.unknown_light.start import Search

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SourceAmbiguity:
    """A fit with each lamp on the likelier side, and what else may be.

    open : (k,) whether a source may as well be at its antipode. moved : of each lighting, by how much its numbers
    (coefficients and irradiances, 3) would be others then.
    """

    fit: BlindFit
    open: NDArray[np.bool_]
    moved: Mapping[int, Floats]


def likelier_sides(search: Search, fit: BlindFit) -> SourceAmbiguity | None:
    """Lamps on the sides that leave the rest of the light most even; None where the photographs determine their sides.

    They do where there is a lobe, where shadows are cast, and where nothing is beside the lamps but uniform light.
    """
    state = fit.state
    shadowed = any(design.shadows is not None for design in search.designs)
    if state.sigma is not None or not len(state.directions) or not fit.l_max or shadowed:
        return None
    signs, undecided = np.ones(len(state.directions)), np.zeros(len(state.directions), bool)
    for lighting in search.lightings:
        own = np.flatnonzero(state.owners == lighting)
        if len(own):
            ways = state.directions[own]
            open_to = np.array([search.may_hold(lighting, sign * ways) for sign in (1, -1)])
            signs[own], undecided[own] = _signs(ways, fit.light[lighting], fit.l_max, open_to)
    if (signs < 0).any():
        turned = replace(state, directions=signs[:, None] * state.directions)
        fit = search.fit(turned, fit.l_max)
    other = np.where(undecided, -1, 1)[:, None] * fit.state.directions
    across = search.at(replace(fit.state, directions=other), fit.l_max)
    return SourceAmbiguity(
        fit, undecided, {k: np.abs(across.light[k] - light) for k, light in fit.light.items()}
    )


def _signs(
    directions: Floats, light: Floats, l_max: int, open_to: NDArray[np.bool_]
) -> tuple[Floats, NDArray[np.bool_]]:
    """Signs (j,) of directions that leave the rest of a light the least moment, and which others light allows too.

    light : ((l_max + 1)^2 + j, 3), coefficients and the lamps' irradiances. open_to : (2, j), whether lamps may be
    where they are, and at their antipodes.
    """
    size = (l_max + 1) ** 2
    power = np.sqrt(4 * np.pi) * light[0]
    # Y_1m are y, z, x times sqrt(3 / 4 pi). The moment of all light together is what shading shows.
    moment = np.sqrt(4 * np.pi / 3) * light[[3, 1, 2]]
    lamps = directions[:, :, None] * light[size:, None, :]
    sides = [[sign for sign, may in zip((1.0, -1.0), own, strict=True) if may] or [1.0] for own in open_to.T]
    choices = np.array(list(product(*sides)))
    rest = moment + np.einsum("sj,jkc->skc", 1 - choices, lamps)
    lengths = np.linalg.norm(rest, axis=1)
    best = int(lengths.sum(axis=1).argmin())
    allowed = (lengths <= np.maximum(power, 0)).all(axis=1)
    allowed[best] = True
    return choices[best], (choices[allowed] != choices[best]).any(axis=0)
