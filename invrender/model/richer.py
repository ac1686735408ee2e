"""Forms with numbers of their own: a haze around the core of a highlight, and a coat on the base.

    W = (1 - haze) W(sigma) + haze W(spread sigma)            two lobes of one family
    rho_d = Kd t(theta_i) t(theta_o),  t = (1 - coat (1 - cos)^5) over its mean

The coat is the coupled base of Shirley et al. 1997, "A practitioners' assessment of light reflection models" (eq. 5),
times a strength: 0 is a Lambertian base, 1 what Schlick's interface lets through. Real paints lie between the two.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from invrender.model.lobes import BECKMANN, GGX_FORM, PLASTICS, UNCORRELATED, Angles, LobeForm, part_width

Floats = NDArray[np.float64]

# Between which values fits look.
NUMBER_RANGE = {"coat": (0.0, 1.0), "haze": (0.0, 0.9), "spread": (1.5, 10.0)}
# What a family's own form has, from which fits start.
FIRST_NUMBER = {"coat": 0.5, "haze": 0.25, "spread": 4.0}


class Richer(LobeForm):
    """A form of facets with a haze, a coat, or both.

    of : the single lobe, above a Lambertian base or under an interface; a coat needs the first. numbers : "coat", and
    "haze" with "spread", as the module has them.
    """

    def __init__(self, of: LobeForm, numbers: Mapping[str, float], family: LobeForm | None = None) -> None:
        coat, haze = numbers.get("coat"), numbers.get("haze")
        self._of, self._family, self.numbers = of, family or self, MappingProxyType(dict(numbers))
        self.interface, self.coat = of.interface, coat
        coated = "" if coat is None else " on a coated base"
        self.name = f"{of.name}{coated}{' with haze' if haze is not None else ''}"
        if haze is not None:
            self.parts = ((1 - haze, 1.0), (haze, numbers["spread"]))

    @property
    def lobe(self) -> LobeForm:
        return self._of.lobe

    @property
    def family(self) -> LobeForm:
        return self._family

    def with_numbers(self, numbers: Mapping[str, float]) -> LobeForm:
        return Richer(self._of, {**self.numbers, **numbers}, self._family)

    def shape(self, angles: Angles, sigma: float | Floats) -> Floats:
        lobes = [share * self._of.shape(angles, part_width(factor, sigma)) for share, factor in self.parts]
        return np.asarray(sum(lobes))

    def fresnel_cosine(self, angles: Angles) -> Floats:
        return self._of.fresnel_cosine(angles)


def _family(of: LobeForm, *names: str) -> Richer:
    return Richer(of, {name: FIRST_NUMBER[name] for name in names})


_LAMBERTIAN = (BECKMANN, GGX_FORM, UNCORRELATED[BECKMANN], UNCORRELATED[GGX_FORM])
_FACETS = (*_LAMBERTIAN, *PLASTICS.values(), *(UNCORRELATED[form] for form in PLASTICS.values()))
# By the form without: on a coated base; with a haze; with both.
COATED = {form: _family(form, "coat") for form in _LAMBERTIAN}
HAZY = {form: _family(form, "haze", "spread") for form in _FACETS}
COATED_HAZY = {form: _family(form, "coat", "haze", "spread") for form in _LAMBERTIAN}
RICHER = {form.name: form for each in (COATED, HAZY, COATED_HAZY) for form in each.values()}
