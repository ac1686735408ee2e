"""Forms with numbers of their own: a haze around the core of a highlight, a coat on the base, a table of normals.

    W = (1 - haze) W(sigma) + haze W(spread sigma)            two lobes of one family
    W = sum_k s_k W(2^k sigma), k = 0..4, s_k >= 0            any distribution of normals that falls with the half angle
    rho_d = Kd t(theta_i) t(theta_o),  t = (1 - coat (1 - cos)^5) over its mean

The table has no formula: lobes an octave apart with shares of any size. Sums of Gaussians are all distributions whose
derivatives in tan^2 theta_h alternate in sign [Bernstein 1929; Widder 1941, theorem IV.12b], GGX among them. It judges
the forms that have one: where it predicts unseen photographs no better, they miss nothing that falls.

The coat is the coupled base of Shirley et al. 1997, "A practitioners' assessment of light reflection models" (eq. 5),
times a strength: 0 is a Lambertian base, 1 what Schlick's interface transmits. Real coatings lie between the two.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from invrender.brdf.form import Angles, LobeForm, Numbers, part_width
from invrender.brdf.lobes import BECKMANN, GGX_FORM, PLASTICS, UNCORRELATED
from invrender.brdf.smith import Smith

Floats = NDArray[np.float64]

# Widths of a table's lobes over sigma, and by name, what of the share that lies beyond one lies beyond the next.
_TABLE = (1.0, 2.0, 4.0, 8.0, 16.0)
SHARES_BEYOND = ("beyond", "beyond_2", "beyond_4", "beyond_8")
# Between which values fits look.
NUMBER_RANGE = {
    "coat": (0.0, 1.0),
    "haze": (0.0, 0.9),
    "spread": (1.5, 10.0),
    **dict.fromkeys(SHARES_BEYOND, (0.0, 1.0)),
    # The rest has sigma's width, which would be anything otherwise.
    "beyond": (0.0, 0.9),
    "stretch": (0.02, 50.0),
}
# What a family's own form has, from which fits start.
FIRST_NUMBER = {"coat": 0.5, "haze": 0.25, "spread": 4.0, **dict.fromkeys(SHARES_BEYOND, 0.4), "stretch": 1.0}


class Richer(LobeForm):
    """A form of facets with a coat, and with a haze or a table of normals.

    of : the single lobe, above a Lambertian base or under an interface; a coat needs the first. numbers : "coat";
    "haze" with "spread", or "beyond" (the share of the lobe that is wider than sigma), "beyond_2" (what of that is
    wider than 2 sigma), "beyond_4" and "beyond_8".
    """

    def __init__(self, of: LobeForm, numbers: Mapping[str, float], family: LobeForm | None = None) -> None:
        coat = numbers.get("coat")
        self._of, self._family, self.numbers = of, family or self, MappingProxyType(dict(numbers))
        self.interface, self.coat = of.interface, coat
        coated, base = ("", "") if coat is None else (" on a coated base", ", above a coated base")
        lobes, normals = "", ""
        if "haze" in numbers:
            lobes, normals = " with haze", ", with a haze around the core"
        elif "beyond" in numbers:
            lobes, normals = " tabulated", "; normals tabulated: a sum of lobes, no formula"
        self.name = f"{of.name}{coated}{lobes}"
        self.description = f"{of.description}{base}{normals}"
        self.parts = tuple((float(share), float(factor)) for share, factor in self.parts_at(numbers))

    @property
    def lobe(self) -> LobeForm:
        return self._of.lobe

    @property
    def family(self) -> LobeForm:
        return self._family

    def with_numbers(self, numbers: Mapping[str, float]) -> LobeForm:
        return Richer(self._of, {**self.numbers, **numbers}, self._family)

    def parts_at(self, numbers: Numbers) -> Sequence[tuple[float | Floats, float | Floats]]:
        if "haze" in numbers:
            return [(1 - numbers["haze"], 1.0), (numbers["haze"], numbers["spread"])]
        if "beyond" not in numbers:
            return [(1.0, 1.0)]
        reached = np.cumprod(
            [np.ones_like(numbers["beyond"]), *(numbers[name] for name in SHARES_BEYOND)], axis=0
        )
        stays = 1 - np.array([numbers[name] for name in SHARES_BEYOND])
        return list(zip([*(reached[:-1] * stays), reached[-1]], _TABLE, strict=True))

    def shape(self, angles: Angles, sigma: float | Floats) -> Floats:
        lobes = [share * self._of.shape(angles, part_width(factor, sigma)) for share, factor in self.parts]
        return np.asarray(sum(lobes))

    def fresnel_cosine(self, angles: Angles) -> Floats:
        return self._of.fresnel_cosine(angles)


def facet_density(form: LobeForm, theta: Floats, sigma: float) -> Floats:
    """The distribution of normals D (n,), 1/sr, of a form of facets at half angles theta (n,), radians.

    Raises ValueError for a form without facets.
    """
    own = form.lobe
    if not isinstance(own, Smith):
        raise ValueError(f"{form.name} has no distribution of normals; give a form of facets")
    parts = [share * own.density(theta, part_width(factor, sigma)) for share, factor in form.parts]
    return np.asarray(sum(parts))


def core_width(form: LobeForm, sigma: float, lobe: LobeForm) -> float:
    """Width of a form's core: of the single lobe of a kind as wide at half its height, over sigma.

    1 of a form that is a single lobe itself, and where one of the two isn't of facets.
    """
    own = form.lobe
    if len(form.parts) == 1 or not isinstance(own, Smith) or not isinstance(lobe, Smith):
        return 1.0

    def density(theta: float) -> float:
        return float(np.sum(facet_density(form, np.array(theta), sigma)))

    def half_width(of: Callable[[float], float]) -> float:
        return float(brentq(lambda theta: of(theta) - of(0.0) / 2, 0.0, np.pi / 2))

    return half_width(density) / half_width(lambda theta: float(lobe.density(np.array(theta), sigma)))


def _family(of: LobeForm, *names: str) -> Richer:
    return Richer(of, {name: FIRST_NUMBER[name] for name in names})


_LAMBERTIAN = (BECKMANN, GGX_FORM, UNCORRELATED[BECKMANN], UNCORRELATED[GGX_FORM])
_FACETS = (*_LAMBERTIAN, *PLASTICS.values(), *(UNCORRELATED[form] for form in PLASTICS.values()))
# By the form without: on a coated base; with a haze; with both.
COATED = {form: _family(form, "coat") for form in _LAMBERTIAN}
HAZY = {form: _family(form, "haze", "spread") for form in _FACETS}
COATED_HAZY = {form: _family(form, "coat", "haze", "spread") for form in _LAMBERTIAN}
# Of Gaussians, the narrowest parts that such a distribution can have: on a coated base, and under an interface.
TABULATED = {
    BECKMANN: _family(BECKMANN, "coat", *SHARES_BEYOND),
    PLASTICS[BECKMANN]: _family(PLASTICS[BECKMANN], *SHARES_BEYOND),
}
RICHER = {form.name: form for each in (COATED, HAZY, COATED_HAZY, TABULATED) for form in each.values()}


def extended(form: Smith) -> tuple[Richer, ...]:
    """What a form of facets extends to: on a coated base, with a haze, with both."""
    return COATED[form.lobe], HAZY[form], COATED_HAZY[form.lobe]


def tabulated(form: Smith) -> tuple[Richer, ...]:
    """Distributions of normals without a formula, above the bases that a form of facets may have."""
    return tuple(TABULATED.values()) if form.interface else (TABULATED[BECKMANN],)
