"""The result of a run: BRDF, lighting, their uncertainty, and the evidence for them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.microfacet import Microfacet
from invrender.diagnostics.named import NamedCause
from invrender.estimate.evidence import MISFIT_REMEDY, Candidate
from invrender.estimate.interreflection.statement import Interreflection
from invrender.estimate.quantities import FittedLighting, PhotoScore, Quantity
from invrender.estimate.textured.textures import FittedTextures

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Factorization:
    """Everything that a run found.

    object : shape and place, as result.json has them.
    brdf : the chosen model's values, also those too uncertain to report: predictions use them.
    gauge : which scale the numbers are in, in words; `is_absolute` if the lighting fixes it.
    quantities : by name, "kd", "ks", "mu", "sigma", "exponent" (Phong's), "albedo", "kd_normalised", "ks_normalised";
        a name that the chosen model doesn't have is missing, and so is the albedo in a relative gauge.
    candidates, chosen : the ladder of models and the index of the chosen one.
    noise_floor, noise_relative : what the residuals look like: sqrt(floor^2 + (relative radiance)^2).
    structured : the part of the residuals that isn't noise, relative RMS.
    covariance, covariance_names : of the BRDF's numbers, in the order named.
    textures : Kd and Ks over the surface, where they vary; those of `brdf` and `quantities` are then means.
    causes : of what the model leaves beyond noise, the best supported first; none where nothing stands out.
    interreflection : light that bounces between the object's parts; None where there is none that matters.
    """

    name: str
    gauge: str
    object: Mapping[str, Any]
    brdf: Microfacet
    quantities: Mapping[str, Quantity]
    lightings: tuple[FittedLighting, ...]
    candidates: tuple[Candidate, ...]
    chosen: int
    photos: tuple[PhotoScore, ...]
    noise_floor: float
    noise_relative: float
    structured: float
    covariance: Floats
    covariance_names: tuple[str, ...]
    warnings: tuple[str, ...]
    textures: FittedTextures | None = None
    interreflection: Interreflection | None = None
    causes: tuple[NamedCause, ...] = ()

    @property
    def is_absolute(self) -> bool:
        """Whether Kd and Ks are in the lighting's own scale, not up to a factor per channel."""
        return "albedo" in self.quantities

    @property
    def misfits(self) -> bool:
        """Whether even the best model explains so little that no number is given."""
        return any(quantity.remedy == MISFIT_REMEDY for quantity in self.quantities.values())

    @property
    def model(self) -> Candidate:
        """The chosen candidate."""
        return self.candidates[self.chosen]

    def rms(self, held_out: bool) -> float | None:
        """Mean over photographs of their relative RMS, or None where there are none of the kind."""
        errors = [photo.rms for photo in self.photos if photo.held_out == held_out]
        return float(np.mean(errors)) if errors else None
