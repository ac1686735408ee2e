"""Microfacets that hide each other, by Smith's theory."""

from __future__ import annotations

from abc import abstractmethod

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.form import Angles, LobeForm

Floats = NDArray[np.float64]


class Smith(LobeForm):
    """Fresnel's factor at the half vector, D G2 / (4 cos cos).

    correlated : whether facets that the viewer sees are the likelier lit, for standing out [Heitz 2014, eq. 99];
    False if the one says nothing of the other, as in many renderers [Walter et al. 2007, eq. 23]. over : the same form
    above a Lambertian base, where this one's is under an interface.
    """

    def __init__(self, correlated: bool = True, over: LobeForm | None = None) -> None:
        self.correlated, self.interface, self._over = correlated, over is not None, over
        self.name = self.name if correlated else f"uncorrelated {self.name}"
        if over is not None:
            self.name = f"{self.name} plastic"
        if over is not None:
            self.description += ", above a diffuse base under a smooth interface, as of plastic"
        if not correlated:
            self.description += "; what hides the light and what hides the viewer are taken for independent"

    @property
    def lobe(self) -> LobeForm:
        return self._over or self

    def shape(self, angles: Angles, sigma: float | Floats) -> Floats:
        return self.shape_of_widths(angles, sigma, 1.0, 1.0, 1.0)

    def shape_of_widths(
        self,
        angles: Angles,
        sigma: float | Floats,
        half: float | Floats,
        light: float | Floats,
        view: float | Floats,
    ) -> Floats:
        """`shape` where sigma is times a factor each in the density, and in what hides light and viewer."""
        lit = (angles.cos_i > 0) & (angles.cos_o > 0)
        # Each by itself: many lamps share an exitant angle.
        cos_i, cos_o = (np.where(cos > 0, cos, 1.0) for cos in (angles.cos_i, angles.cos_o))
        # cos_i cos_o / G2, finite at grazing.
        lost_i, lost_o = self.hidden(cos_i, sigma * light), self.hidden(cos_o, sigma * view)
        shown = cos_i * cos_o + cos_o * lost_i + cos_i * lost_o
        if not self.correlated:
            shown = shown + lost_i * lost_o
        return np.where(lit, self.density(angles.theta_h, sigma * half) * cos_i / (4 * shown), 0)

    def fresnel_cosine(self, angles: Angles) -> Floats:
        return angles.cos_d

    @abstractmethod
    def density(self, theta_h: Floats, sigma: float | Floats) -> Floats:
        """D, 1/sr; D cos theta_h integrates to 1 over the hemisphere."""

    @abstractmethod
    def hidden(self, cos: Floats, sigma: float | Floats) -> Floats:
        """Lambda times the cosine: what facets hide of each other."""
