"""The numbers that are reported, as a function of the fitted ones, in a fixed gauge, and their statuses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.lobes import PHONG
from invrender.brdf.phong import phong_exponent
from invrender.estimate.identifiability import (
    UNIFORM_LIGHT,
    Scalar,
    assess_linear,
    assess_mu,
    assess_number,
    assess_sigma,
    assess_width,
)
from invrender.estimate.jacobian import Parameters
from invrender.estimate.quantities import Quantity, scaled
from invrender.estimate.reference_scale import ReferenceGauge
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]


class Report:
    """The numbers that are reported, as one vector of the fitted ones, in a fixed gauge.

    gauge : the scale by references, which hangs on strengths; None where there are none. places : block -> slice: "mu",
    "sigma", the form's numbers, what follows from these, "kd", "ks", "kd_normalised", "ks_normalised", "strengths".
    """

    def __init__(self, parameters: Parameters, has_known: bool, gauge: ReferenceGauge | None = None) -> None:
        self.parameters = parameters
        self.has_known = has_known
        self.gauge = gauge
        self.strengths = [name for name in parameters.places if "/" in name]
        gauged = [name for name in self.strengths if "/source" in name] or self.strengths
        self._gauge_places = np.array([_indices(parameters, name) for name in gauged])
        blocks = self._blocks(parameters.vector)
        self.places: dict[str, slice] = {}
        start = 0
        for name, block in blocks.items():
            self.places[name] = slice(start, start + len(block))
            start += len(block)

    @property
    def is_absolute(self) -> bool:
        """Whether some known light, or a reference, fixes the scale of Kd and Ks."""
        return self.has_known or not self.strengths or self.gauge is not None

    def scale(self, values: Floats) -> Floats:
        """What a share of each reported number means: of itself, but for Kd and Ks of their sum."""
        result = values.copy()
        if "ks" in self.places:
            kd, ks = self.places["kd"], self.places["ks"]
            result[kd] = result[ks] = values[kd] + values[ks]
            result[self.places["kd_normalised"]] = result[self.places["ks_normalised"]] = 1.0
        return result

    @property
    def names(self) -> tuple[str, ...]:
        """A name for each number before the strengths: "mu", "kd.r", ..."""
        result: list[str] = []
        for name, place in self.places.items():
            if name != "strengths":
                size = place.stop - place.start
                result += [name] if size == 1 else [f"{name}.{channel}" for channel in "rgb"]
        return tuple(result)

    def __call__(self, vector: Floats) -> Floats:
        return np.concatenate(list(self._blocks(vector).values()))

    def _blocks(self, vector: Floats) -> dict[str, Floats]:
        parameters = self.parameters
        brdf = parameters.brdf(vector)
        scale = self.factor(vector)
        scalars = ("mu", "sigma", *parameters.form.numbers)
        blocks = {name: vector[parameters.places[name]] for name in scalars if name in parameters.places}
        if brdf.sigma is not None:
            blocks |= {name: np.array([value]) for name, value in brdf.form.derived(brdf.sigma).items()}
        blocks["kd"] = brdf.kd * scale
        total = brdf.kd + brdf.ks
        safe = np.where(total > 0, total, 1.0)
        if "ks" in parameters.places:
            blocks["ks"] = brdf.ks * scale
            blocks["kd_normalised"] = brdf.kd / safe
            blocks["ks_normalised"] = brdf.ks / safe
        strengths = [vector[parameters.places[name]] / scale for name in self.strengths]
        blocks["strengths"] = np.concatenate(strengths) if strengths else np.zeros(0)
        return blocks

    def factor(self, vector: Floats) -> Floats:
        """Reported Kd and Ks over those of a vector, (3,)."""
        if self.gauge is not None:
            places = self.parameters.places
            return self.gauge.factor({name: vector[places[name]] for name in self.strengths})
        return np.ones(3) if self.is_absolute else np.asarray(vector[self._gauge_places].mean(axis=0))

    def moved_by_scale(self, values: Floats) -> Floats:
        """By how much reported numbers rise for each channel's scale, per share of it: (k, 3)."""
        moved = np.zeros((len(values), 3))
        for name in ("kd", "ks"):
            if name in self.places:
                place = self.places[name]
                moved[place] = np.diag(values[place])
        place = self.places["strengths"]
        moved[place] = -values[place, None] * np.tile(np.eye(3), (len(self.strengths), 1))
        return moved

    def quantities(
        self,
        values: Floats,
        std: Floats,
        fragility: Floats,
        fields: Sequence[LightField],
        degree: int | None,
    ) -> dict[str, Quantity]:
        """Those of reported numbers that results state, each with its status.

        values, std, fragility : laid out as reported. fields : samples of photographs. degree : of `lighting_degree`.
        """

        def block(name: str) -> tuple[Floats, Floats]:
            return values[self.places[name]], std[self.places[name]]

        if degree == 0:
            unknown = Quantity(None, None, "undetermined", *UNIFORM_LIGHT)
            return {name: unknown for name in ("kd", "ks", "sigma", "mu") if name in self.places}
        kd, kd_std = block("kd")
        ks, ks_std = block("ks") if "ks" in self.places else (np.zeros(3), np.zeros(3))
        scale = kd + ks
        quantities = {"kd": assess_linear(kd, kd_std, scale, "Kd")}
        if self.is_absolute:
            quantities["albedo"] = scaled(quantities["kd"], np.pi)
        if "ks" not in self.places:
            return quantities
        quantities["ks"] = assess_linear(ks, ks_std, scale, "Ks")
        for name in ("kd_normalised", "ks_normalised"):
            share, share_std = block(name)
            quantities[name] = assess_linear(share, share_std, np.ones(3), name[:2].capitalize())
        ks_share = float(np.mean(values[self.places["ks_normalised"]]))
        places = {name: self.places[name].start for name in ("mu", "sigma") if name in self.places}
        scalars = {
            name: Scalar(*(float(a[k]) for a in (values, std, fragility))) for name, k in places.items()
        }
        quantities["sigma"] = assess_sigma(scalars["sigma"], degree, ks_share)
        form = self.parameters.form
        if form is PHONG:
            quantities["exponent"] = _as_exponent(quantities["sigma"])
        for name in form.numbers:
            quantities[name] = assess_number(*block(name))
        for name in form.derived(scalars["sigma"].value):
            quantities[name] = assess_width(*block(name), quantities["sigma"])
        if "mu" in scalars:
            quantities["mu"] = assess_mu(scalars["mu"], fields, ks_share)
        return quantities

    def with_shares(self, name: str, quantity: Quantity, variances: Mapping[str, Floats]) -> Quantity:
        """A quantity with what each cause has of its variance; variances : by cause, laid out as reported."""
        # Albedo follows from Kd, and an exponent from sigma, by factors.
        place = self.places[{"albedo": "kd", "exponent": "sigma"}.get(name, name)]
        return quantity.with_shares({cause: values[place] for cause, values in variances.items()})

    def strength(self, values: Floats, name: str) -> Floats:
        """The three numbers of a recovered strength in a vector laid out as reported."""
        first = self.places["strengths"].start + 3 * self.strengths.index(name)
        return values[first : first + 3]


def _as_exponent(sigma: Quantity) -> Quantity:
    """The exponent of Phong's lobe of a width."""
    if sigma.value is None or sigma.std is None:
        return sigma
    exponent = phong_exponent(sigma.value)
    # To the first order: the exponent goes as 1 / sigma squared.
    return replace(sigma, value=exponent, std=2 * exponent * sigma.std / sigma.value)


def _indices(parameters: Parameters, name: str) -> NDArray[np.int64]:
    place = parameters.places[name]
    return np.arange(place.start, place.stop)
