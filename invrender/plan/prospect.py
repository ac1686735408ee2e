"""What a set of photographs will determine, in the words that `process` uses afterwards."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.microfacet import Microfacet
from invrender.estimate.identifiability import (
    UNIFORM_LIGHT,
    Scalar,
    assess_linear,
    assess_mu,
    assess_sigma,
)
from invrender.estimate.quantities import Quantity
from invrender.estimate.uncertainty import FINEST, NUMERICAL
from invrender.plan.information import Posterior, Spread
from invrender.plan.unknowns import Unknowns
from invrender.transport.columns import PhotoColumns
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Expected:
    """One quantity, (k,) numbers, as it is and as it will be known. Of a direction, a unit vector, std is one angle.

    name : as in result.json, such as "ks_normalised"; of a lighting with its name, such as "lab/source 1 irradiance".
    std : what noise forces, and what `process` always counts on top. noise_std : what noise alone forces. quantity :
    with status, reason and remedy. size : what a std is relative to, (k,): the truth's absolute value for most.
    reducible : (k,), the part of std that other photographs would change; the rest is a share of the number itself.
    """

    name: str
    label: str
    truth: Floats
    std: Floats
    noise_std: Floats
    quantity: Quantity
    size: Floats
    reducible: Floats

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


def brdf_prospect(
    brdf: Microfacet,
    unknowns: Unknowns,
    posterior: Posterior,
    absolute: bool,
    degree: int | None,
    fields: Sequence[LightField],
) -> list[Expected]:
    """The BRDF's quantities: Kd and Ks, or their shares where no light is known; sigma and mu.

    degree : of `identifiability.lighting_degree`. fields : samples, the most grazing ones among them.
    """
    rows = brdf_rows(brdf, unknowns, absolute)
    if not rows:
        return []
    names = list(rows)
    spread = posterior.of_shared(np.concatenate(list(rows.values())) * unknowns.std)
    weight = brdf.kd + brdf.ks
    share = float(np.mean(brdf.ks / np.maximum(weight, 1e-300)))
    found, start = [], 0
    for name in names:
        part = slice(start, start + len(rows[name]))
        start = part.stop
        one = Spread(spread.std[part], spread.fragility[part])
        truth = _truth(brdf, name)
        # As `solve.factorize` has it: shares are of 1, Kd and Ks of their sum.
        scale = np.ones(3) if name.endswith("normalised") else weight if name in ("kd", "ks") else truth
        std, reducible = counted(one, scale)
        size = np.maximum(truth, 1e-3 * scale.max())
        quantity = _assessed(name, truth, std, one.fragility, scale, degree, share, fields)
        found.append(Expected(name, LABELS[name], truth, std, one.std, quantity, size, reducible))
    return found


LABELS = {
    "kd": "Kd (1/sr)",
    "ks": "Ks",
    "ks_normalised": "Ks / (Kd + Ks)",
    "sigma": "sigma (rad)",
    "mu": "mu",
}


def counted(spread: Spread, scale: Floats) -> tuple[Floats, Floats]:
    """Standard deviations as `process` states them, noise and its quadratures, and what of them is reducible.

    Quadratures count as a model error of the radiance, propagated, and as a share of a `scale`, which stays.
    """
    reducible = np.hypot(spread.std, NUMERICAL * spread.fragility)
    return np.asarray(np.hypot(reducible, FINEST * scale)), np.asarray(reducible)


def brdf_rows(brdf: Microfacet, unknowns: Unknowns, absolute: bool) -> dict[str, Floats]:
    """Derivatives (k, t) of the quantities in the shared numbers, by name."""
    rows = {name: np.eye(len(unknowns.std))[place] for name, place in unknowns.brdf.places.items()}
    if brdf.sigma is None:
        # A matte object's colour is its light's: without a scale there is nothing to determine.
        return rows if absolute else {}
    shape: dict[str, Floats] = {name: rows[name] for name in ("sigma", "mu") if name in rows}
    if absolute:
        return {"kd": rows["kd"], "ks": rows["ks"], **shape}
    weight = np.maximum(brdf.kd + brdf.ks, 1e-300)[:, None]
    share = (brdf.kd[:, None] * rows["ks"] - brdf.ks[:, None] * rows["kd"]) / weight**2
    return {"ks_normalised": share, **shape}


def _truth(brdf: Microfacet, name: str) -> Floats:
    if name == "ks_normalised":
        return np.asarray(brdf.ks / np.maximum(brdf.kd + brdf.ks, 1e-300))
    return np.atleast_1d(np.asarray(getattr(brdf, name), float))


def _assessed(
    name: str,
    truth: Floats,
    std: Floats,
    fragility: Floats,
    scale: Floats,
    degree: int | None,
    share: float,
    fields: Sequence[LightField],
) -> Quantity:
    if degree == 0:
        return Quantity(None, None, "undetermined", *UNIFORM_LIGHT)
    if name == "sigma":
        return assess_sigma(Scalar(float(truth[0]), float(std[0]), float(fragility[0])), degree, share)
    if name == "mu":
        found = Scalar(float(truth[0]), float(std[0]), float(fragility[0]))
        return assess_mu(found, [_without_columns(field) for field in fields], share)
    return assess_linear(truth, std, scale, name[:2].capitalize())


def _without_columns(field: LightField) -> PhotoColumns:
    """A photograph for `assess_mu`, which asks for its samples only."""
    return PhotoColumns("", (), np.zeros((1, len(field), 0, 0), np.float32), field)
