"""The result of a run: BRDF, lighting, their uncertainty, and the evidence for them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from capture.lighting import Lighting
from invrender.diagnostics.named import NamedCause
from invrender.interreflection import Interreflection
from invrender.model.microfacet import Microfacet
from invrender.solve.evidence import HOPELESS, Rung
from invrender.texture.textures import Textures

Floats = NDArray[np.float64]
Status = Literal["determined", "weak", "undetermined"]


@dataclass(frozen=True, eq=False)
class Quantity:
    """A number (or one per channel) with its standard deviation, or the reason why there is none.

    value, std : (k,) arrays, k = 1 or 3; None where the photographs don't determine it.
    status : "determined", "weak" (std above a tenth of the value, or mu beyond common indices) or "undetermined".
    reason, remedy : plain words; empty where determined.
    """

    value: Floats | None
    std: Floats | None
    status: Status
    reason: str = ""
    remedy: str = ""


@dataclass(frozen=True, eq=False)
class HarmonicLight:
    """Light that nobody knew, without its sources, as harmonics.

    coefficients, std : ((l_max + 1)^2, 3). shares : (l_max + 1,), of what is known of a degree's coefficients, how much
    comes from the photographs. determined_degree : up to which that is most; -1 if of none. reason, remedy : why not of
    all, and what would help; empty where it is of all.
    """

    coefficients: Floats
    std: Floats
    shares: Floats
    determined_degree: int
    reason: str
    remedy: str


@dataclass(frozen=True, eq=False)
class FittedLighting:
    """A lighting as the fit leaves it.

    lighting : with recovered irradiances filled in. irradiance_std : (k, 3), zero where given, NaN where
        fitted to held-out photographs only, to score them.
    ambient, ambient_std : (3,) recovered uniform radiance, or None where it was not recovered.
    harmonics : of light of which nothing was known, beside its sources; its map is in `lighting`, cut at zero.
    up_to_scale : known light, times what suits held-out photographs best in a gauge that no light fixes.
    """

    lighting: Lighting
    irradiance_std: Floats
    ambient: Floats | None
    ambient_std: Floats | None
    harmonics: HarmonicLight | None = None
    up_to_scale: bool = False


@dataclass(frozen=True)
class PhotoScore:
    """How well one photograph is explained; errors are RMS residual over RMS radiance.

    cross_validated : by a fit that had not seen it; None for a held-out photo, whose `rms` is just that.
    """

    label: str
    lighting: str
    held_out: bool
    samples: int
    rms: float
    cross_validated: float | None


@dataclass(frozen=True, eq=False)
class Factorization:
    """Everything that a run found.

    object : shape and place, as result.json has them.
    brdf : the chosen model's values, also those too uncertain to report: predictions use them.
    gauge : which scale the numbers are in, in words; `is_absolute` if the lighting fixes it.
    quantities : by name, "kd", "ks", "mu", "sigma", "exponent" (Phong's), "albedo", "kd_normalised", "ks_normalised";
        a name that the chosen model doesn't have is missing, and so is the albedo in a relative gauge.
    rungs, chosen : the ladder of models and the index of the chosen one.
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
    rungs: tuple[Rung, ...]
    chosen: int
    photos: tuple[PhotoScore, ...]
    noise_floor: float
    noise_relative: float
    structured: float
    covariance: Floats
    covariance_names: tuple[str, ...]
    warnings: tuple[str, ...]
    textures: Textures | None = None
    interreflection: Interreflection | None = None
    causes: tuple[NamedCause, ...] = ()

    @property
    def is_absolute(self) -> bool:
        """Whether Kd and Ks are in the lighting's own scale, not up to a factor per channel."""
        return "albedo" in self.quantities

    @property
    def misfits(self) -> bool:
        """Whether even the best model explains so little that no number is given."""
        return self.model.error >= HOPELESS

    @property
    def model(self) -> Rung:
        """The chosen rung."""
        return self.rungs[self.chosen]

    def rms(self, held_out: bool) -> float | None:
        """Mean over photographs of their relative RMS, or None where there are none of the kind."""
        errors = [photo.rms for photo in self.photos if photo.held_out == held_out]
        return float(np.mean(errors)) if errors else None
