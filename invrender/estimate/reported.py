"""The numbers that are reported, as a function of the fitted ones, in a fixed gauge."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from invrender.estimate.jacobian import Parameters

Floats = NDArray[np.float64]


class Report:
    """The numbers that are reported, as one vector of the fitted ones, in a fixed gauge.

    places : block -> slice: "mu", "sigma", the form's numbers, "kd", "ks", "kd_normalised", "ks_normalised",
    "strengths".
    """

    def __init__(self, parameters: Parameters, has_known: bool) -> None:
        self.parameters = parameters
        self.has_known = has_known
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
        """Whether some known light fixes the scale of Kd and Ks."""
        return self.has_known or not self.strengths

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
        scale = np.ones(3)
        if not self.is_absolute:
            scale = vector[self._gauge_places].mean(axis=0)
        scalars = ("mu", "sigma", *parameters.form.numbers)
        blocks = {name: vector[parameters.places[name]] for name in scalars if name in parameters.places}
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

    def strength(self, values: Floats, name: str) -> Floats:
        """The three numbers of a recovered strength in a vector laid out as reported."""
        first = self.places["strengths"].start + 3 * self.strengths.index(name)
        return values[first : first + 3]


def _indices(parameters: Parameters, name: str) -> NDArray[np.int64]:
    place = parameters.places[name]
    return np.arange(place.start, place.stop)
