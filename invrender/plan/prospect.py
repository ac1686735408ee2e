"""What a set of photographs will determine, in the words that `process` uses afterwards."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from invrender.estimate.identifiability import UNIFORM_LIGHT
from invrender.estimate.jacobian import numerical_jacobian
from invrender.estimate.quantities import Quantity
from invrender.estimate.reported import Report
from invrender.estimate.uncertainty import FINEST, NUMERICAL
from invrender.plan.information import Posterior, Spread
from invrender.plan.unknowns import Unknowns
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Expected:
    """One quantity, (k,) numbers, as it is and as it will be known. Of a direction, a unit vector, std is one angle.

    name : as in result.json, such as "ks_normalised"; of a lighting with its name, such as "lab/source 1 irradiance".
    std : what noise forces, and what `process` always counts on top. noise_std : what noise alone forces. quantity :
    with status, reason and remedy. size : what a std is relative to, (k,): the truth's absolute value for most.
    reducible : (k,), the part of std that other photographs would change; the rest is a share of the number itself.
    causes : variances (k,) by errors of calibration, each by its name.
    """

    name: str
    label: str
    truth: Floats
    std: Floats
    noise_std: Floats
    quantity: Quantity
    size: Floats
    reducible: Floats
    causes: Mapping[str, Floats]

    @property
    def shares(self) -> dict[str, float]:
        """What each cause has of the variance, mean of channels; they add up to 1."""
        own = {"noise": self.noise_std**2, **self.causes}
        own["quadratures"] = self.std**2 - np.sum(list(own.values()), axis=0)
        total = float(np.mean(self.std**2))
        return {cause: float(np.mean(part)) / total for cause, part in own.items() if total > 0}

    def improved(self, cause: str) -> Floats:
        """The standard deviations (k,) if errors of one cause were half as large."""
        less = 0.75 * self.causes.get(cause, np.zeros(len(self.std)))
        return np.asarray(np.sqrt(self.std**2 - less))

    @property
    def is_direction(self) -> bool:
        """Whether the truth is a unit vector and std one angle."""
        return len(self.truth) != len(self.std)

    @property
    def relative(self) -> float:
        """The largest of the standard deviations relative to what they are of."""
        return float(np.max(self.std / np.maximum(self.size, 1e-300)))

    @property
    def doubt(self) -> float:
        """The largest of the reducible parts, likewise."""
        return float(np.max(self.reducible / np.maximum(self.size, 1e-300)))

    @property
    def rank(self) -> tuple[bool, float]:
        """How badly off it is; sorts."""
        return self.quantity.status == "undetermined", self.doubt


def worth_improving(expected: Sequence[Expected]) -> list[tuple[str, float]]:
    """Errors of calibration, the most harmful first: by what factor, twice as sure, each would shrink a std at best.

    Of quantities that stay undetermined no std counts.
    """
    known = [one for one in expected if one.causes and one.quantity.status != "undetermined"]
    causes = dict.fromkeys(cause for one in known for cause in one.causes)
    gains = {cause: max(float(np.max(one.std / one.improved(cause))) for one in known) for cause in causes}
    return sorted(gains.items(), key=lambda entry: -entry[1])


@dataclass(frozen=True, eq=False)
class AskedBrdf:
    """What is asked of the BRDF: Kd and Ks, or their shares where no light is known; sigma and mu.

    names : of these among the reported numbers. rows : (k, t), derivatives of all reported numbers in the shared ones,
    in units of the prior.
    """

    report: Report
    names: tuple[str, ...]
    rows: Floats

    @classmethod
    def of(cls, unknowns: Unknowns, absolute: bool) -> AskedBrdf:
        """absolute : whether some light is known."""
        report = Report(unknowns.brdf, has_known=True)
        by_brdf = numerical_jacobian(report, unknowns.brdf.vector)
        rows = np.zeros((len(by_brdf), len(unknowns.std)))
        rows[:, : by_brdf.shape[1]] = by_brdf
        # A matte object's colour is its light's: without a scale there is nothing to determine.
        asked = ("kd", "ks", "sigma", "mu") if absolute else ("ks_normalised", "sigma", "mu")
        return cls(report, tuple(name for name in asked if name in report.places), rows * unknowns.std)

    def quantities(
        self, posterior: Posterior, degree: int | None, fields: Sequence[LightField]
    ) -> list[Expected]:
        """How well they will be known.

        degree : of `identifiability.lighting_degree`. fields : samples, the most grazing ones among them.
        """
        values = self.report(self.report.parameters.vector)
        scale = self.report.scale(values)
        spread = posterior.of_shared(self.rows)
        std, reducible = counted(spread, scale)
        quantities = self.report.quantities(values, std, spread.fragility, fields, degree)
        unknown = Quantity(None, None, "undetermined", *UNIFORM_LIGHT)
        found = []
        for name in self.names:
            own = self.report.places[name]
            size = np.maximum(values[own], 1e-3 * scale[own].max())
            found.append(
                Expected(
                    name,
                    LABELS[name],
                    values[own],
                    std[own],
                    spread.std[own],
                    unknown if degree == 0 else quantities[name],
                    size,
                    reducible[own],
                    {cause: variance[own] for cause, variance in spread.causes.items()},
                )
            )
        return found


LABELS = {
    "kd": "Kd (1/sr)",
    "ks": "Ks",
    "ks_normalised": "Ks / (Kd + Ks)",
    "sigma": "sigma (rad)",
    "mu": "mu",
}


def counted(spread: Spread, scale: Floats) -> tuple[Floats, Floats]:
    """Standard deviations as `process` states them, and what of them is reducible: all but a share of the numbers.

    Quadratures count as a model error of the radiance, propagated, and as a share of a `scale`, which stays.
    """
    calibration = np.sum([np.zeros(len(spread.std)), *spread.causes.values()], axis=0)
    reducible = np.sqrt(spread.std**2 + (NUMERICAL * spread.fragility) ** 2 + calibration)
    return np.asarray(np.hypot(reducible, FINEST * scale)), np.asarray(reducible)
