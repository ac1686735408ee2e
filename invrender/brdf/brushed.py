"""Facets whose slopes are drawn out along one tangent, as brushing draws them out: two widths in place of one.

    alpha_x = sigma sqrt(stretch) along the tangent,  alpha_y = sigma / sqrt(stretch) across it

Any distribution of slopes that falls with their size can be stretched. At each azimuth it is then the isotropic one of
another width, and so is what facets hide of each other [Heitz 2014, eq. 80, 85]:

    D(h) = D(theta_h; a) a^2 / (alpha_x alpha_y)        1 / a^2 = cos^2 phi / alpha_x^2 + sin^2 phi / alpha_y^2
    Lambda(w) = Lambda(theta; a)                        a^2 = alpha_x^2 cos^2 phi + alpha_y^2 sin^2 phi

The tangent follows from the normal: along circles about an axis, counterclockwise.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.form import Angles, Axis, LobeForm
from invrender.brdf.lobes import BECKMANN, GGX_FORM, PLASTICS
from invrender.brdf.microfacet import SIGMA_RANGE
from invrender.brdf.richer import NUMBER_RANGE
from invrender.brdf.smith import Smith

Floats = NDArray[np.float64]

# The part of a window, in logarithms, in whose middle a fit lies well.
_INNER = 0.7
# Sigma and stretch, from and to, for which columns are tabulated.
Window = tuple[tuple[float, float], tuple[float, float]]


class Brushed(LobeForm):
    """A form of facets, stretched.

    of : the isotropic form, above a Lambertian base or under an interface. stretch : alpha_x / alpha_y. about : the
    axis. window : that columns are tabulated for; None where none are.
    """

    def __init__(
        self,
        of: Smith,
        about: Axis,
        stretch: float = 1.0,
        window: Window | None = None,
        family: LobeForm | None = None,
    ) -> None:
        self.of, self.axis, self.window, self._family = of, about, window, family or self
        self.interface = of.interface
        self.numbers = MappingProxyType({"stretch": float(stretch)})
        self.name = f"brushed {of.name}"
        self.description = (
            f"{of.description}; brushed: two widths, along circles about an axis and across them"
        )
        if window is not None:
            self.ranges = MappingProxyType(dict(zip(("sigma", "stretch"), window, strict=True)))

    @property
    def lobe(self) -> LobeForm:
        if self.of.lobe is self.of:
            return self
        return brushed(_facets(self.of.lobe), self.tangent_axis, self.window).with_numbers(self.numbers)

    @property
    def tangent_axis(self) -> Axis:
        """The axis that tangents go about."""
        assert self.axis is not None
        return self.axis

    @property
    def family(self) -> LobeForm:
        return self._family

    def derived(self, sigma: float) -> Mapping[str, float]:
        root = float(np.sqrt(self.numbers["stretch"]))
        return {"alpha_x": sigma * root, "alpha_y": sigma / root}

    def with_numbers(self, numbers: Mapping[str, float]) -> LobeForm:
        return Brushed(
            self.of, self.tangent_axis, {**self.numbers, **numbers}["stretch"], self.window, self._family
        )

    def holds(self, sigma: float, stretch: float) -> bool:
        """Whether the inner part of the window has a sigma and a stretch."""
        assert self.window is not None
        ends = np.log(np.array(self.window))
        off = np.abs(np.log([sigma, stretch]) - ends.mean(axis=1))
        return bool((off < _INNER * np.diff(ends)[:, 0] / 2).all())

    def around(self, sigma: float, stretch: float, reach: tuple[float, float]) -> Brushed:
        """The same family with the window about a sigma and a stretch; reach : half its width in their logarithms."""
        return brushed(self.of, self.tangent_axis, window_about(sigma, stretch, reach))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Brushed) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    @property
    def _key(self) -> tuple[object, ...]:
        return self.of, self.axis, self.numbers["stretch"], self.window

    def shape(self, angles: Angles, sigma: float | Floats) -> Floats:
        assert angles.turns is not None, "the angles of a brushed form have turns"
        half, light, view = angles.turns
        stretch = self.numbers["stretch"]
        across = np.sqrt(2 / ((1 + half) / stretch + (1 - half) * stretch))
        hiding = (np.sqrt(((1 + turn) * stretch + (1 - turn) / stretch) / 2) for turn in (light, view))
        return self.of.shape_of_widths(angles, sigma, across, *hiding) * across**2

    def fresnel_cosine(self, angles: Angles) -> Floats:
        return self.of.fresnel_cosine(angles)


@lru_cache(maxsize=256)
def brushed(of: Smith, about: Axis, window: Window | None = None) -> Brushed:
    """The family of a form, brushed about an axis, whose columns are tabulated for a window of sigma and stretch."""
    return Brushed(of, about, window=window)


def window_about(sigma: float, stretch: float, reach: tuple[float, float]) -> Window:
    """The window about a sigma and a stretch; reach : half its width in the logarithms of both."""
    ranges = (SIGMA_RANGE, NUMBER_RANGE["stretch"])
    sigmas, stretches = (
        (max(low, middle * np.exp(-half)), min(high, middle * np.exp(half)))
        for middle, half, (low, high) in zip((sigma, stretch), reach, ranges, strict=True)
    )
    return sigmas, stretches


def _facets(form: LobeForm) -> Smith:
    assert isinstance(form, Smith)
    return form


# What may be brushed.
FACETS = tuple(_facets(form) for form in (GGX_FORM, BECKMANN, PLASTICS[GGX_FORM], PLASTICS[BECKMANN]))
