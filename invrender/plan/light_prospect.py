"""How much of an unknown lighting a set of photographs will determine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from invrender.estimate.identifiability import ACCURACY, WEAK, Scalar
from invrender.estimate.quantities import Quantity
from invrender.estimate.reached import reached_share
from invrender.estimate.unknown_light.state import turns
from invrender.plan.experiment import PlannedLight
from invrender.plan.information import Posterior, Spread
from invrender.plan.prospect import Expected, counted
from invrender.plan.unknowns import Unknowns
from recon.harmonics.basis import degree_of, degrees, evaluate_harmonics
from recon.harmonics.complex import project_sources
from recon.harmonics.latlong import map_coefficients
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]

# A diffuse surface sees degrees up to this [RH01, eq. 16].
FIRST_NINE = 2
# Shares of degrees from which on they count as determined, and as weak: a posterior a tenth, and half, of the prior.
DETERMINED, HALF = 1 - WEAK**2, 0.75
_STEP = 1e-5
_HIDDEN = "its highlight can't be separated from the rest of the light"
_MIRROR_BALL = "photograph a mirror ball in the object's place"
_SHOW_IT = f"{_MIRROR_BALL}, or add photographs that show its highlight"


@dataclass(frozen=True, eq=False)
class LightProspect:
    """What will be known of all light under one name, its sources among it.

    coefficients, std : ((l_max + 1)^2, 3), of all the light as harmonics. shares : (l_max + 1,), how much of each
    degree the photographs determine, 0 to 1: 1 less the mean variance relative to the prior's, a model error of 0.5%
    included.
    reached : share of all directions that mirrored rays look at.
    """

    name: str
    coefficients: Floats
    std: Floats
    shares: Floats
    reached: float

    @property
    def l_max(self) -> int:
        return len(self.shares) - 1

    @property
    def highest(self) -> int:
        """The degree up to which all are determined; -1 if none is."""
        lacking = np.flatnonzero(self.shares < DETERMINED)
        return int(lacking[0]) - 1 if len(lacking) else self.l_max

    @property
    def effective_rank(self) -> float:
        """How many coefficients of a channel are determined: the sum of their shares."""
        return float((self.shares * (2 * np.arange(self.l_max + 1) + 1)).sum())


@dataclass(frozen=True, eq=False)
class UnknownLight:
    """A light that is not given, and what is asked of it.

    index : which of the lights of `unknowns`. coefficients : ((l_max + 1)^2, 3), of all of it, its sources among it.
    rows : (3 (l_max + 1)^2, s), their derivatives in its own numbers and the shared ones, as `Tally` has them, in units
    of the prior, channels fastest. radius : metres, of the object; a near source's closeness is counted in it.
    """

    light: PlannedLight
    unknowns: Unknowns
    index: int
    coefficients: Floats
    rows: Floats
    radius: float

    @classmethod
    def of(cls, light: PlannedLight, unknowns: Unknowns, index: int, radius: float) -> UnknownLight:
        """One of the lights of `unknowns`."""
        lighting, own = light.lighting, unknowns.lights[index]
        l_max = degree_of(own.size - own.sources)
        total = project_sources(lighting.directions, lighting.irradiances, l_max)
        if lighting.radiance_map is not None:
            total = total + map_coefficients(lighting.radiance_map, l_max)
        rows = coefficient_rows(light, unknowns, index)
        return cls(light, unknowns, index, np.asarray(total), rows, radius)

    @property
    def l_max(self) -> int:
        return degree_of(len(self.coefficients))

    @property
    def prior(self) -> Floats:
        """(3,), of any coefficient."""
        return self.unknowns.lights[self.index].std[:, 0]

    def prospect(self, posterior: Posterior, fields: Sequence[LightField]) -> LightProspect:
        """How much of it is known after a posterior."""
        spread = posterior.asked(self.index, self.rows).of_lighting(self.index)
        std, _ = counted(spread, np.abs(self.coefficients).ravel())
        doubt = (std**2 + (ACCURACY * spread.fragility) ** 2).reshape(-1, 3) / self.prior**2
        per_degree = np.bincount(degrees(self.l_max), doubt.mean(axis=1)) / (
            2 * np.arange(self.l_max + 1) + 1
        )
        shares = np.clip(1 - per_degree, 0, 1)
        return LightProspect(
            self.light.lighting.name, self.coefficients, std.reshape(-1, 3), shares, reached_share(fields)
        )

    @cached_property
    def asked(self) -> Floats:
        """Rows (r, s) of `quantities`: the first nine coefficients, sources' irradiances, directions and closeness."""
        own = self.unknowns.lights[self.index]
        unit = np.diag(_std(self.unknowns, self.index))
        irradiance = np.arange(3 * own.size).reshape(3, -1)[:, own.size - own.sources :]
        return np.concatenate(
            [
                self.rows[: 3 * (FIRST_NINE + 1) ** 2],
                unit[irradiance.T.ravel()],
                unit[3 * own.size :][own.moves],
            ]
        )

    def quantities(self, posterior: Posterior) -> list[Expected]:
        """Its first nine coefficients as one quantity, and each source's irradiance, direction, and distance if near.

        The posterior's marginal of the light must have been asked the rows `asked`.
        """
        lighting = self.light.lighting
        highest = min(FIRST_NINE, self.l_max)
        nine, count = 3 * (highest + 1) ** 2, len(lighting.directions)
        spread = posterior.of_lighting(self.index)
        found = [
            _assessed(
                f"{lighting.name}/degrees 0 to {highest}",
                f"light {lighting.name!r}, degrees 0 to {highest}",
                _norm(self.coefficients.ravel()[:nine]),
                spread.of(slice(nine)).together,
                _norm(self.prior),
                "these views show too little of the light that falls on the object",
                _MIRROR_BALL,
            )
        ]
        for k in range(count):
            first, second = nine + 3 * k, nine + 3 * count + 2 * k
            at, towards = slice(first, first + 3), slice(second, second + 2)
            irradiance = _assessed(
                f"{lighting.name}/source {k + 1} irradiance",
                f"source {k + 1} of {lighting.name!r}, irradiance",
                lighting.irradiances[k],
                spread.of(at),
                self.unknowns.lights[self.index].std[:, -1],
                _HIDDEN,
                _SHOW_IT,
            )
            direction = _assessed(
                f"{lighting.name}/source {k + 1} direction",
                f"source {k + 1} of {lighting.name!r}, direction",
                np.ones(1),
                spread.of(towards).together,
                np.ones(1),
                _HIDDEN,
                _SHOW_IT,
            )
            found += [irradiance, replace(direction, truth=lighting.directions[k])]
        for k, source in enumerate(self.light.near):
            assert lighting.closeness is not None
            distance = 1 / lighting.closeness[[source]]
            per_closeness, at = (
                distance**2 / self.radius,
                slice(nine + 5 * count + k, nine + 5 * count + k + 1),
            )
            found.append(
                _assessed(
                    f"{lighting.name}/source {source + 1} distance",
                    f"source {source + 1} of {lighting.name!r}, distance",
                    distance,
                    spread.of(at).times(per_closeness),
                    per_closeness,
                    _HIDDEN,
                    _SHOW_IT,
                )
            )
        return found


def coefficient_rows(light: PlannedLight, unknowns: Unknowns, index: int) -> Floats:
    """Derivatives (3 (l_max + 1)^2, s) of all the light's coefficients in what is unknown of it, in prior's units."""
    lighting, own = light.lighting, unknowns.lights[index]
    count = own.size - own.sources
    l_max = degree_of(count)
    lit, shared = np.zeros((count, 3, 3, own.size)), np.zeros((count, 3, len(unknowns.std)))
    for channel in range(3):
        lit[:, channel, channel, :count] = np.eye(count)
        lit[:, channel, channel, count:] = evaluate_harmonics(lighting.directions, l_max).T
    ends = (
        evaluate_harmonics(turns(lighting.directions, step).reshape(-1, 3), l_max) for step in (-_STEP, _STEP)
    )
    before, after = ends
    by_turn = ((after - before) / (2 * _STEP)).T
    shared[:, :, own.turns] = by_turn[:, None] * np.repeat(lighting.irradiances.T, 2, axis=1)
    rows = np.hstack([lit.reshape(3 * count, -1), shared.reshape(3 * count, -1)])
    return rows * _std(unknowns, index)


def _std(unknowns: Unknowns, index: int) -> Floats:
    """The prior's standard deviations (s,) of a lighting's numbers, channel by channel, then of the shared ones."""
    return np.concatenate([unknowns.lights[index].std.ravel(), unknowns.std])


def _norm(values: Floats) -> Floats:
    """Several numbers as one, (1,): the root of the summed squares."""
    return np.sqrt(np.sum(values**2, keepdims=True))


def _assessed(
    name: str, label: str, size: Floats, spread: Spread, prior: Floats, why: str, remedy: str
) -> Expected:
    std, reducible = counted(spread, size)
    unknown = [
        Scalar(*map(float, numbers[:3])).unknown(float(numbers[3]), (0.0, np.inf))
        for numbers in zip(size, std, spread.fragility, prior, strict=True)
        if numbers[0] > 0
    ]
    reasons = [text for text in unknown if text]
    if reasons:
        quantity = Quantity(None, None, "undetermined", f"{reasons[0]}: {why}", remedy)
    elif np.any(std > WEAK * size):
        quantity = Quantity(
            size, std, "weak", f"its standard deviation is above a tenth of its value: {why}", remedy
        )
    else:
        quantity = Quantity(size, std, "determined")
    relative_to = np.maximum(size, 1e-3 * size.max())
    return Expected(name, label, size, std, spread.std, quantity, relative_to, reducible, spread.causes)
