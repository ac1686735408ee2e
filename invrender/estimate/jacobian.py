"""The Jacobian under known light: derivatives of predicted radiance in an estimate's numbers, as one vector.

Fits state their standard deviations by it, and `plan` what photographs will determine before they are taken.
`unknown_light.projection.shared_rows` is the Jacobian under unknown light.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.form import LobeForm
from invrender.brdf.microfacet import Microfacet
from invrender.estimate.models import Estimate
from invrender.transport.columns import PhotoColumns
from invrender.transport.predict import transfer_slope, transfers

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Parameters:
    """An estimate as one vector: mu, sigma, the form's own numbers (where the model has them), Kd, Ks, free strengths.

    places : name of a block -> slice. Names are "mu", "sigma", those of the form's numbers, "kd", "ks" and
    "lighting/element"; the last three have three numbers each, and a neutral Ks one. form : of the specular part.
    """

    vector: Floats
    places: Mapping[str, slice]
    form: LobeForm

    def brdf(self, vector: Floats) -> Microfacet:
        """The BRDF of a vector of this layout."""
        mu = float(vector[self.places["mu"]][0]) if "mu" in self.places else None
        sigma = float(vector[self.places["sigma"]][0]) if "sigma" in self.places else None
        ks = vector[self.places["ks"]] if "ks" in self.places else np.zeros(3)
        form = self.form.with_numbers(
            {name: float(vector[self.places[name]][0]) for name in self.form.numbers}
        )
        return Microfacet(vector[self.places["kd"]], np.broadcast_to(ks, 3), mu, sigma, form)


def pack(estimate: Estimate, elements: Mapping[str, Sequence[str]]) -> Parameters:
    """The parameters of an estimate; `elements` gives each lighting's element names."""
    blocks: dict[str, Floats] = {}
    if estimate.brdf.mu is not None:
        blocks["mu"] = np.array([estimate.brdf.mu])
    if estimate.brdf.sigma is not None:
        blocks["sigma"] = np.array([estimate.brdf.sigma])
        blocks |= {name: np.array([value]) for name, value in estimate.brdf.form.numbers.items()}
    blocks["kd"] = estimate.brdf.kd
    if estimate.model.specular:
        blocks["ks"] = estimate.brdf.ks[:1] if estimate.model.neutral else estimate.brdf.ks
    for lighting, names in elements.items():
        for name, strength in zip(names, estimate.strengths[lighting], strict=True):
            if name != "known":
                blocks[f"{lighting}/{name}"] = strength
    places, start = {}, 0
    for name, values in blocks.items():
        places[name] = slice(start, start + len(values))
        start += len(values)
    return Parameters(np.concatenate(list(blocks.values())), places, estimate.brdf.form)


def jacobians(photo: PhotoColumns, parameters: Parameters, estimate: Estimate) -> list[Floats]:
    """Derivatives (n, parameters) of a photograph's radiance, one per channel."""
    brdf, strengths = estimate.brdf, estimate.strengths[photo.lighting]
    diffuse, specular = transfers(photo, brdf)
    scalars = ("mu", "sigma", *brdf.form.numbers)
    slopes = {name: transfer_slope(photo, brdf, name) for name in scalars if name in parameters.places}
    result = []
    for c in range(3):
        row = min(c, diffuse.shape[0] - 1)
        jacobian = np.zeros((len(photo.field), len(parameters.vector)))
        jacobian[:, parameters.places["kd"].start + c] = diffuse[row] @ strengths[:, c]
        if "ks" in parameters.places:
            ks = parameters.places["ks"]
            jacobian[:, min(ks.start + c, ks.stop - 1)] = specular[row] @ strengths[:, c]
        for name, slope in slopes.items():
            moved = brdf.kd[c] * slope[0][row] + brdf.ks[c] * slope[1][row]
            jacobian[:, parameters.places[name].start] = moved @ strengths[:, c]
        for e, name in enumerate(photo.elements):
            place = parameters.places.get(f"{photo.lighting}/{name}")
            if place is not None:
                shading = brdf.kd[c] * diffuse[row][:, e] + brdf.ks[c] * specular[row][:, e]
                jacobian[:, place.start + c] = shading
        result.append(jacobian)
    return result


def numerical_jacobian(report: Callable[[Floats], Floats], vector: Floats) -> Floats:
    """Derivatives (k, p) of reported numbers, `report(vector)`, in a vector (p,), by central differences."""
    columns = []
    for k in range(len(vector)):
        step = 1e-6 * max(abs(vector[k]), 1e-3)
        ends = []
        for sign in (-1, 1):
            moved = vector.copy()
            moved[k] += sign * step
            ends.append(report(moved))
        columns.append((ends[1] - ends[0]) / (2 * step))
    return np.stack(columns, axis=-1)
