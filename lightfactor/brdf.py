"""The numbers of a fitted BRDF as arrays, each with its standard deviation, or the reason why there is none."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from invrender.estimate.quantities import limits
from invrender.result.saved import SavedQuantity, SavedResult
from invrender.wording import parameter_lines

Floats = NDArray[np.float64]

NOT_NEEDED = "not needed"


@dataclass(frozen=True, eq=False, repr=False)
class FittedNumber:
    """A number of the BRDF, or one per channel.

    value, std : (3,) float64, red, green, blue, or a float; None where the photographs don't determine it, or the model
        that they need doesn't have it. std is None, too, where a published procedure gives none.
    status : "determined", "weak" (std above a tenth of the value, or mu a metal's), "undetermined", or "not needed".
    reason, remedy : why it isn't determined, and what would settle it; empty where it is.
    variance_shares : what each cause has of its variance, by name ("noise", "poses", ...); they add up to 1. Empty
        where nobody split it.
    """

    name: str
    value: Floats | float | None
    std: Floats | float | None
    status: str
    reason: str = ""
    remedy: str = ""
    variance_shares: Mapping[str, float] = field(default_factory=dict)

    def lines(self, is_absolute: bool = True) -> list[tuple[str, str]]:
        """Label and text, "value ± std", of each channel."""
        value, std = (None if of is None else np.atleast_1d(of) for of in (self.value, self.std))
        if value is not None and std is None:
            std = np.zeros_like(value)
        return parameter_lines(self.name, value, std, is_absolute)

    @property
    def limits(self) -> str:
        """What has most of its variance, in words; empty where nobody split it."""
        return limits(self.variance_shares)

    def __repr__(self) -> str:
        numbers = ", ".join(text for _, text in self.lines())
        why = f": {self.reason}. To settle it: {self.remedy}" if self.reason else ""
        return f"<{self.name} {numbers}, {self.status}{why}>"


@dataclass(frozen=True, eq=False)
class FittedBrdf:
    """A fitted BRDF.

    model : the form of the lobe, or "lambertian". specular : "neutral", "coloured", or None where nothing tells.
    kd : 1/sr, or in a relative gauge up to a factor per channel. ks, mu : dimensionless. sigma : radians. exponent :
    Phong's. albedo : pi Kd. kd_normalised, ks_normalised : shares of Kd + Ks. form_numbers : the form's own, by name.
    Of textures kd and ks are means over the part of the surface that the photographs determine.
    """

    model: str
    specular: str | None
    kd: FittedNumber
    ks: FittedNumber
    mu: FittedNumber
    sigma: FittedNumber
    exponent: FittedNumber
    albedo: FittedNumber
    kd_normalised: FittedNumber
    ks_normalised: FittedNumber
    form_numbers: Mapping[str, FittedNumber]

    @property
    def shown(self) -> tuple[FittedNumber, ...]:
        """Kd, Ks, mu and sigma, and what else the model has."""
        more = (self.exponent, *self.form_numbers.values())
        return (self.kd, self.ks, self.mu, self.sigma, *(one for one in more if one.value is not None))


def fitted_brdf(result: SavedResult) -> FittedBrdf:
    """The BRDF of a result."""
    saved = result.content.brdf
    absent = "undetermined" if result.misfits else NOT_NEEDED

    def number(name: str, quantity: SavedQuantity | None) -> FittedNumber:
        found = result.finding(name)
        why = (found.reason, found.remedy)
        if quantity is None:
            return FittedNumber(name, None, None, absent, *why)
        value, std = _array(quantity.value), _array(quantity.std)
        return FittedNumber(name, value, std, quantity.status, *why, quantity.variance_shares)

    return FittedBrdf(
        model=saved.model,
        specular=saved.specular,
        **{
            name: number(name, getattr(saved, name))
            for name in ("kd", "ks", "mu", "sigma", "exponent", "albedo")
        },
        kd_normalised=number("kd_normalised", saved.normalised.kd),
        ks_normalised=number("ks_normalised", saved.normalised.ks),
        form_numbers={name: number(name, quantity) for name, quantity in saved.form_numbers.items()},
    )


def _array(value: float | tuple[float, float, float] | None) -> Floats | float | None:
    return np.array(value, float) if isinstance(value, tuple) else value
