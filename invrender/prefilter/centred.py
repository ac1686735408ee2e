"""BRDFs as lobes about directions of their own, in which they are nearly symmetric [R02, section 5.3.1].

A specular lobe is centred on the mirrored view, a diffuse one on the normal, a fibre's on the tangent. Each is
prefiltered about its own centre; what they reflect adds up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from capture.arrays import frozen_array
from invrender.brdf.form import Lobe
from invrender.prefilter.energy import degrees_reaching, isotropic_fraction
from invrender.prefilter.reflectionmap import (
    axial_coefficients,
    axial_lobe_coefficients,
    lobe_coefficients,
    mirrored_coefficients,
)

Floats = NDArray[np.float64]

# Where view factors are tabulated; beyond they stay as they are.
_FACTOR_DEGREES = np.linspace(89.9, 0, 60)
# Of their quadrature; lobes are divided by what pictures are multiplied by, so that its error is none of theirs.
_FACTOR_FINENESS = 0.5
# Orders that are tried for an accuracy, one after the other.
_TRIED = ((16, 4), (40, 8), (100, 12), (200, 16))


@dataclass(frozen=True, eq=False)
class ViewFactor:
    """A function of the view's cosine to the axis, linear between values (k,) at cosines (k,), which rise."""

    cos: Floats
    values: Floats

    def __call__(self, cos: Floats) -> Floats:
        """The factor (...) at cosines (...)."""
        return np.asarray(np.interp(cos, self.cos, self.values))


@dataclass(frozen=True, eq=False)
class CentredLobe:
    """A part of a BRDF that is a lobe about one direction.

    name : a word for its files. lobes : one for all channels, or three. strength : (3,), what they are multiplied by.
    mirrored : whether the centre is the mirrored view; else it is the axis itself, the normal or a tangent.
    view_factor : what of the lobe depends on the view's angle to the axis alone, or None; the lobes are given without
    it, so that maps need not hold it, and pictures are multiplied by it.
    """

    name: str
    lobes: Sequence[Lobe]
    strength: Floats
    mirrored: bool
    view_factor: ViewFactor | None = None

    def __post_init__(self) -> None:
        if len(self.lobes) not in (1, 3):
            raise ValueError(
                f"{self.name}: there are {len(self.lobes)} lobes; give one for all channels, or three"
            )
        object.__setattr__(self, "strength", frozen_array(np.broadcast_to(self.strength, 3)))

    def at_views(
        self, cos_view: Floats, l_max: int, q_max: int, fineness: float = 1.0
    ) -> tuple[Floats, Floats]:
        """Coefficients (3, k, l_max + 1, q_max + 1) and energies (3, k) at cosines (k,) between view and centre.

        Strengths are in both. Otherwise as of `mirrored_coefficients`.
        """
        found = [
            mirrored_coefficients(lobe, l_max, q_max, np.sqrt((1 + cos_view) / 2), fineness)
            if self.mirrored
            else axial_coefficients(lobe, l_max, q_max, cos_view, fineness)
            for lobe in self.lobes
        ]
        coefficients, energies = (np.stack(part) for part in zip(*found, strict=True))
        strength = self.strength[:, None, None, None]
        return coefficients * strength, energies * strength[..., 0, 0] ** 2

    def coefficients(self, l_max: int, p_max: int) -> tuple[Floats, Floats]:
        """rho_lpq (n, l_max + 1, p_max + 1, min + 1) and energies (n,) of each of the lobes, without strengths."""
        expand = lobe_coefficients if self.mirrored else axial_lobe_coefficients
        found = [expand(lobe, l_max, p_max) for lobe in self.lobes]
        return np.stack([rho for rho, _ in found]), np.array([energy for _, energy in found])

    def orders(self, epsilon: float) -> tuple[int, int]:
        """F and P that hold 1 - epsilon of the energy in all channels [R02, section 5.5.1 and 5.6.2, step 1].

        Larger ones are tried until that is so. Raises ValueError where degree 200 and order 16 don't reach it.
        """
        held = 0.0
        for l_max, p_max in _TRIED:
            rhos, energies = self.coefficients(l_max, p_max)
            shares = [
                isotropic_fraction(rho, energy) for rho, energy in zip(rhos, energies.tolist(), strict=True)
            ]
            held = min(float(share[-1, -1]) for share in shares)
            if held >= 1 - epsilon:
                found = [degrees_reaching(share, epsilon) for share in shares]
                return max(f for f, _ in found), max(p for _, p in found)
        f, p = _TRIED[-1]
        raise ValueError(
            f"the lobe {self.name!r} is too narrow for maps: degrees up to F = {f}, P = {p} hold {held:.3g} of its"
            f" energy, not 1 - {epsilon:g}; allow more error, or take a broader lobe"
        )

    def factor(self, cos_angles: Floats) -> Floats:
        """What the maps' values are multiplied by at cosines of the view to the axis."""
        return np.ones_like(cos_angles) if self.view_factor is None else self.view_factor(cos_angles)

    def cos_views(self, cos_angles: Floats) -> Floats:
        """Cosines between view and centre at cosines of the view to the axis."""
        return 2 * cos_angles**2 - 1 if self.mirrored else cos_angles

    def centres(self, axes: Floats, views: Floats) -> Floats:
        """Where the lobe is centred, (..., 3), at normals or tangents (..., 3) seen from views (..., 3), all unit."""
        if not self.mirrored:
            return np.broadcast_to(axes, np.broadcast_shapes(axes.shape, views.shape))
        return 2 * (axes * views).sum(axis=-1, keepdims=True) * axes - views


@dataclass(frozen=True, eq=False)
class CentredBrdf:
    """A BRDF as a sum of lobes, each about its centre.

    description : in words. lobes : the broadest first. axis : what surfaces turn: their normals, or a fibre's tangent.
    """

    description: str
    lobes: tuple[CentredLobe, ...]
    axis: Literal["normal", "tangent"] = "normal"


def specular_lobe(name: str, lobes: Sequence[Lobe], strength: Floats) -> CentredLobe:
    """One lobe about the mirrored view, or three: what they reflect over the cosine of the view is their view factor.

    Fresnel's factor rises 25-fold towards grazing views, and lobes over that cosine without bound. Left in the lobe,
    this is nearly all of its energy, and takes orders P of 10 and more; without it 2 to 3 do, as for R02's eq. 5.34.
    """
    cos = np.cos(np.radians(_FACTOR_DEGREES))
    whole = np.mean(
        [mirrored_coefficients(lobe, 0, 0, cos, _FACTOR_FINENESS)[0][:, 0, 0] for lobe in lobes], axis=0
    )
    factor = ViewFactor(cos, np.sqrt(4 * np.pi) * whole / cos)

    def evened(lobe: Lobe) -> Lobe:
        return lambda normals, wi, wo: np.asarray(lobe(normals, wi, wo) / factor((normals * wo).sum(axis=-1)))

    return CentredLobe(name, [evened(lobe) for lobe in lobes], strength, True, factor)


def lambertian_lobe(name: str, strength: Floats) -> CentredLobe:
    """Kd times the clamped cosine, about the normal; strength : Kd, 1/sr, (3,)."""

    def matte(normals: Floats, wi: Floats, wo: Floats) -> Floats:
        return np.maximum((normals * wi).sum(axis=-1), 0)

    return CentredLobe(name, (matte,), strength, mirrored=False)
