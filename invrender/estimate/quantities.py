"""Numbers with their uncertainty or the reason why there is none, and what holds them: lightings, scores."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from capture.lighting import Lighting

Floats = NDArray[np.float64]
Status = Literal["determined", "weak", "undetermined"]

# Share of a variance below which its cause isn't worth a word.
_NOTABLE = 0.05
# What makes error bars, by its name in files, in words: what calibrations and photo sets state, and all.
CALIBRATION = {
    "poses": "camera poses",
    "lenses": "lenses",
    "mesh_place": "mesh's place",
    "heights": "scan noise",
    "light_directions": "light directions",
    "color": "camera's colours",
    "extinction": "filters' extinction",
}
CAUSES = {
    "noise": "pixel noise",
    "quadratures": "quadratures",
    "misfit": "misfit",
    "forms": "other forms",
    "map_pixels": "map's pixels",
    "bounced_light": "bounced light",
    "sphere_place": "sphere's place",
    "lamp_distances": "lamp distances",
    "faults": "found faults",
    "reference": "the reference",
    "recovered_light": "recovered light",
    **CALIBRATION,
}


@dataclass(frozen=True, eq=False)
class Quantity:
    """A number (or one per channel) with its standard deviation, or the reason why there is none.

    value, std : (k,) arrays, k = 1 or 3; None where the photographs don't determine it.
    status : "determined", "weak" (std above a tenth of the value, or mu beyond common indices) or "undetermined".
    reason, remedy : plain words; empty where determined.
    shares : of its variance, mean of channels, by what causes it (`CAUSES`); they add up to 1. Empty where nobody split
        it.
    """

    value: Floats | None
    std: Floats | None
    status: Status
    reason: str = ""
    remedy: str = ""
    shares: Mapping[str, float] = field(default_factory=dict)

    def with_shares(self, variances: Mapping[str, Floats]) -> Quantity:
        """The same with what each cause has of its variance; variances : (k,) by cause."""
        own = {cause: float(np.mean(values)) for cause, values in variances.items() if len(values)}
        total = sum(own.values())
        if self.std is None or total <= 0:
            return self
        return replace(self, shares={cause: part / total for cause, part in own.items() if part > 0})


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

    def dimmed(self, factor: Floats) -> FittedLighting:
        """The same lighting and its deviations over factors (3,), without harmonics."""
        lighting, ambient = self.lighting, self.ambient
        map_ = lighting.radiance_map
        lighting = replace(
            lighting,
            irradiances=lighting.irradiances / factor,
            radiance_map=None if map_ is None else (map_ / factor).astype(np.float32),
        )
        ambient_std = self.ambient_std
        return replace(
            self,
            lighting=lighting,
            irradiance_std=self.irradiance_std / factor,
            ambient=None if ambient is None else ambient / factor,
            ambient_std=None if ambient_std is None else ambient_std / factor,
        )


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
class ReferenceScore:
    """How well one reference is explained, by its photograph's label and the name of its light.

    name : of the reference. weight : its share in the scale. stds : by what leaves the scale that it gives uncertain,
    ("reflectance", "tilt", "evenness"), shares (3,). over_shown : (3,), radiance that the light sends from it, over
    what it shows.
    """

    name: str
    photo: str
    lighting: str
    weight: float
    stds: Mapping[str, Floats]
    over_shown: Floats

    @property
    def std(self) -> Floats:
        """Share (3,) by which the scale that it gives is uncertain, the light on it being as the fit has it."""
        return np.asarray(np.sqrt(sum(own**2 for own in self.stds.values())))


def limits(shares: Mapping[str, float], most: int = 3) -> str:
    """What has most of a number's variance, in words: "camera poses 62%, pixel noise 30%"; empty if nobody split it."""
    largest = sorted(shares.items(), key=lambda entry: -entry[1])[:most]
    told = [f"{CAUSES.get(cause, cause)} {share:.0%}" for cause, share in largest if share >= _NOTABLE]
    return ", ".join(told)


def scaled(quantity: Quantity, factor: float) -> Quantity:
    """The same quantity in another unit: value and standard deviation times a factor."""
    if quantity.value is None or quantity.std is None:
        return quantity
    return replace(quantity, value=quantity.value * factor, std=quantity.std * factor)
