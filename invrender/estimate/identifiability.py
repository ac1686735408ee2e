"""What the photographs determine, and where they don't: why, and what photograph would settle it.

The reasons are RH01's: roughness is invisible under light without high frequencies (section 5.2), the
Fresnel factor without grazing views (section 6.1), and diffuse and specular reflection can't be separated
where they send the same signal.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture.lighting import Lighting
from invrender.brdf.fresnel import MU_RANGE
from invrender.brdf.microfacet import SIGMA_RANGE
from invrender.estimate.quantities import Quantity, Status
from invrender.estimate.uncertainty import PRIOR_STD
from recon.harmonics.complex import project_sources
from recon.harmonics.latlong import map_coefficients
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]

# Beyond half of the prior's width a posterior is as wide as the prior for all a user can do with it.
_PRIOR_SHARE = 0.5
# Standard deviation, over the value, beyond which a number is weak.
WEAK = 0.1
# Specular share below which a highlight may be too faint to be measured.
_FAINT = 0.3
_DEGREE = 30
# Relative accuracy that cameras, light and shape can be counted on for, however small the noise.
ACCURACY = 0.005
_FRAGILE_SHARE = 0.5
# Of glass, plastic and coatings none has a higher index (diamond's is 2.42). Reason and remedy where one is found.
_MOST_COMMON = 2.5
_METAL = (
    "an index so high stands for a metal, whose own is complex (n + ik): it says how little highlights brighten towards"
    " grazing angles, and is no refractive index",
    "of a metal take Ks for the reflectance at normal incidence, and mu to render with only",
)
# Reason and remedy where all light is the same from all sides.
UNIFORM_LIGHT = (
    "the light is uniform: it shows how much the object reflects in all, but not which part of it is diffuse",
    "add a photograph under a small, bright source",
)
_SMALL_SOURCE = "add a photograph under a small, bright source"
# Power relative to degree 0 below which light is uniform: a coarse map's pixels alone leave as much.
_UNIFORM = 1e-5


def lighting_degree(lightings: Sequence[Lighting], share: float = 0.99) -> int | None:
    """The degree up to which lies `share` of the power of the best-suited lighting; None beyond 30.

    The power of degree l is the sum of squared coefficients; degree 0, which shows nothing of a lobe's
    width, is left out.
    """
    best: int | None = 0
    for lighting in lightings:
        total = np.zeros((_DEGREE + 1) ** 2)
        if len(lighting.directions):
            total += project_sources(lighting.directions, lighting.irradiances, _DEGREE).mean(axis=1)
        if lighting.radiance_map is not None and not lighting.recover_ambient:
            total += map_coefficients(lighting.radiance_map, _DEGREE).mean(axis=1)
        degrees = np.repeat(np.arange(_DEGREE + 1), 2 * np.arange(_DEGREE + 1) + 1)
        power = np.bincount(degrees, total**2)[1:]
        if power.sum() <= _UNIFORM * total[0] ** 2:
            continue
        reached = 1 + int(np.searchsorted(np.cumsum(power) / power.sum(), share))
        if reached >= _DEGREE:
            return None
        best = max(best or 0, reached)
    return best


@dataclass(frozen=True)
class Scalar:
    """mu or sigma as found: value, standard deviation, and fragility (`uncertainty.Uncertainty`)."""

    value: float
    std: float
    fragility: float

    def unknown(self, prior_std: float, bounds: tuple[float, float], ill_posed: bool = False) -> str:
        """Why the number means nothing, in words; empty if it means something.

        ill_posed : theory says that the problem is; then a model error mustn't be amplified at all.
        """
        if not bounds[0] * 1.001 < self.value < bounds[1] * 0.999:
            return f"the fit runs to the edge of its range, {bounds[0]} to {bounds[1]}"
        limit = min(_PRIOR_SHARE * prior_std, self.value)
        # `not <` instead of `>=`: NaN is no knowledge either.
        if not self.std < limit:
            return f"its standard deviation is {self.std:.2g}, as wide as what was known before"
        if not ACCURACY * self.fragility < (ACCURACY if ill_posed else _FRAGILE_SHARE) * limit:
            return (
                f"a model that is off by {ACCURACY:.1%} of the radiance, as any is, would move it by"
                f" {ACCURACY * self.fragility:.2g}"
            )
        return ""


def assess_mu(found: Scalar, fields: Sequence[LightField], ks_share: float) -> Quantity:
    """mu with its status; undetermined where grazing angles don't show it, weak where it can't be what it is called."""
    what = found.unknown(PRIOR_STD["mu"], MU_RANGE)
    if not what and found.value > _MOST_COMMON:
        return Quantity(np.array([found.value]), np.array([found.std]), "weak", *_METAL)
    if not what:
        return _determined(found, "add photographs with highlights at grazing angles")
    steepest = np.degrees(np.arccos(min(field.cos_exitant.min() for field in fields)))
    return Quantity(
        None,
        None,
        "undetermined",
        f"{what}: the Fresnel factor differs between indices only at grazing exitant angles; the samples reach"
        f" {steepest:.0f} degrees, and the specular share is {ks_share:.3f} (RH01, section 6.1)",
        "add photographs in which highlights are seen at grazing angles (source nearly behind the object)",
    )


def assess_sigma(found: Scalar, degree: int | None, ks_share: float) -> Quantity:
    """sigma with its status; undetermined where the light has no frequencies that the lobe would take away."""
    # A lobe passes degrees up to about 1/sigma; light that ends below them does not show where.
    ill_posed = degree is not None and degree * found.value < 1
    what = found.unknown(PRIOR_STD["sigma"], SIGMA_RANGE, ill_posed)
    if not what:
        return _determined(found, _SMALL_SOURCE)
    if degree is None and ks_share < _FAINT:
        why = f"the light has high frequencies, but the specular share is only {ks_share:.3f}"
        remedy = "add photographs that show the highlight, exposed so that it is not saturated"
    elif degree is None:
        why = f"the light has high frequencies and the specular share is {ks_share:.3f}, so the model doesn't fit"
        remedy = "look where the difference pictures are bright: light, poses or mesh may be off there"
    else:
        width = f"; lobes narrower than about {1 / degree:.2f} rad pass nearly all of it" if degree else ""
        why = f"99% of the light's varying power lies in degrees up to {degree}{width} (RH01, section 5.2)"
        remedy = _SMALL_SOURCE
    return Quantity(None, None, "undetermined", f"{what}: {why}", remedy)


def assess_linear(value: Floats, std: Floats, scale: Floats, name: str) -> Quantity:
    """Kd or Ks (3,) with its status; `scale` is Kd + Ks, against which a std is judged hopeless."""
    if np.all(std < 0.5 * np.maximum(scale, 1e-300)):
        status: Status = "weak" if np.any(std > WEAK * np.abs(value)) else "determined"
        if status == "determined":
            return Quantity(value, std, status)
        return Quantity(
            value,
            std,
            status,
            f"its standard deviation is above a tenth of its value; {name} is small, or under this light diffuse and"
            " specular reflection look much alike",
            "add photographs under a small source, with and without the highlight in view",
        )
    return Quantity(
        None,
        None,
        "undetermined",
        "under this light diffuse and specular reflection send nearly the same signal",
        "add photographs under a small, bright source, from several sides",
    )


def assess_number(value: Floats, std: Floats) -> Quantity:
    """A number of the form's own (1,) with its status; it always has a value, without which the form means nothing."""
    if (std <= WEAK * np.maximum(value, 1.0)).all():
        return Quantity(value, std, "determined")
    why = "its standard deviation is above a tenth: what it adds to the form is small or looks like another part"
    return Quantity(value, std, "weak", why, "add photographs with highlights in view, and at grazing angles")


def assess_width(value: Floats, std: Floats, sigma: Quantity) -> Quantity:
    """One of the two widths (1,) that a sigma is the geometric mean of, with its status."""
    if sigma.value is None:
        return sigma
    return _determined(Scalar(float(value[0]), float(std[0]), 0.0), _SMALL_SOURCE)


def _determined(found: Scalar, remedy: str) -> Quantity:
    value, std = np.array([found.value]), np.array([found.std])
    if found.std <= WEAK * found.value:
        return Quantity(value, std, "determined")
    return Quantity(value, std, "weak", "its standard deviation is above a tenth of its value", remedy)
