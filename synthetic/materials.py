"""The microfacet BRDF of RH01, and the spheres that were measured with it.

    rho = Kd + Ks F(mu, theta_o) / F(mu, 0) S(theta_h) / (4 cos theta_i cos theta_o)     [RH01, section 5.2]
    S   = exp(-(theta_h / sigma)^2) / (pi sigma^2)

Taken as printed, so that truth and fit mean the same parameters: Fresnel at the exitant angle instead of
the half vector's, and no shadowing-masking. Both make it wrong physics at grazing angles, where its
reflectance grows without bound.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capture.arrays import frozen_array

Floats = NDArray[np.float64]

# Fig. 11 holds ratios. The brightest of them, Kd = 0.92, becomes an albedo of 0.79 under this scale, a
# usual value for a white plastic.
RADIOMETRIC_SCALE = 0.86 / np.pi


@dataclass(frozen=True, eq=False)
class Microfacet:
    """A Lambertian base under a lobe of microfacets.

    kd, ks : (3,) RGB, 1/sr, >= 0; the diffuse albedo is pi kd, at most 1.
    mu : refractive index, > 1; None for no Fresnel factor (metals in RH01).
    sigma : surface roughness, radians, > 0.
    """

    kd: Floats
    ks: Floats
    mu: float | None
    sigma: float

    def __post_init__(self) -> None:
        for name in ("kd", "ks"):
            value = np.asarray(getattr(self, name), float)
            if value.shape != (3,) or not np.isfinite(value).all() or (value < 0).any():
                raise ValueError(f"{name} is {value.tolist()}; it must be three finite numbers >= 0")
            object.__setattr__(self, name, frozen_array(value))
        if np.pi * self.kd.max() > 1:
            raise ValueError(
                f"kd is {self.kd.tolist()}: an albedo pi kd of {np.pi * self.kd.max():.2f} reflects more"
                " light than falls on it; Fig. 11 of RH01 gives ratios, which `radiometric` scales"
            )
        if self.mu is not None and not 1 < self.mu < np.inf:
            raise ValueError(f"mu is {self.mu}; a refractive index must be > 1, or None: no Fresnel factor")
        if not 0 < self.sigma < np.inf:
            raise ValueError(f"sigma is {self.sigma} rad; it must be > 0")

    def fresnel(self, cos_exitant: ArrayLike) -> Floats:
        """F(mu, theta_o) / F(mu, 0), shape of `cos_exitant` (0 to 1); 1 without a refractive index."""
        cos_exitant = np.asarray(cos_exitant, float)
        if self.mu is None:
            return np.ones_like(cos_exitant)
        return fresnel_dielectric(self.mu, cos_exitant) / fresnel_dielectric(self.mu, np.ones(()))

    def facets(self, cos_half: NDArray[np.floating]) -> NDArray[np.floating]:
        """Density S of facets, 1/sr, at the cosine of theta_h (-1 to 1); keeps the dtype."""
        angle = np.arccos(np.minimum(cos_half, 1))
        return np.exp(-((angle / self.sigma) ** 2)) / (np.pi * self.sigma**2)

    def evaluate(self, n: ArrayLike, wi: ArrayLike, wo: ArrayLike) -> Floats:
        """The BRDF (..., 3), 1/sr; zero unless light and viewer are both above the surface.

        n, wi, wo : (..., 3) unit, broadcast: normal, direction to the light, direction to the viewer.
        """
        n, wi, wo = (np.asarray(v, float) for v in (n, wi, wo))
        cos_i, cos_o = (n * wi).sum(axis=-1), (n * wo).sum(axis=-1)
        valid = (cos_i > 0) & (cos_o > 0)
        # Placeholders of 1 keep what is not valid out of the divisions.
        safe_i, safe_o = np.where(valid, cos_i, 1.0), np.where(valid, cos_o, 1.0)
        length = np.where(valid, np.linalg.norm(wi + wo, axis=-1), 1.0)
        cos_half = np.where(valid, (cos_i + cos_o) / length, 1.0)
        lobe = self.fresnel(np.minimum(safe_o, 1)) * self.facets(cos_half) / (4 * safe_i * safe_o)
        return np.where(valid[..., None], self.kd + self.ks * lobe[..., None], 0.0)


def fresnel_dielectric(mu: float, cos_theta: ArrayLike) -> Floats:
    """Unpolarised Fresnel reflectance (0 to 1) of a dielectric from outside, index mu > 1, shape kept."""
    cos = np.asarray(cos_theta, float)
    cos_inside = np.sqrt(1 - (1 - cos**2) / mu**2)
    perpendicular = (cos - mu * cos_inside) / (cos + mu * cos_inside)
    parallel = (mu * cos - cos_inside) / (mu * cos + cos_inside)
    return np.asarray((perpendicular**2 + parallel**2) / 2)


class Fig11Row(NamedTuple):
    """A row of [RH01, Fig. 11]: kd and ks are RGB ratios, the largest kd + ks of a material being 1."""

    kd: tuple[float, float, float]
    ks: tuple[float, float, float]
    mu: float | None
    sigma: float


def _grey(value: float) -> tuple[float, float, float]:
    return value, value, value


# The columns "known", measured under known lighting.
RH01_MATERIALS = {
    "teflon": Fig11Row(_grey(0.89), _grey(0.11), 1.78, 0.12),
    "delrin": Fig11Row(_grey(0.87), _grey(0.13), 1.44, 0.10),
    "neoprene": Fig11Row(_grey(0.92), _grey(0.08), 1.49, 0.10),
    "steel": Fig11Row(_grey(0.20), _grey(0.80), None, 0.20),
    "bronze": Fig11Row((0.15, 0.08, 0.05), (0.85, 0.68, 0.59), None, 0.12),
    "painted": Fig11Row((0.62, 0.71, 0.62), _grey(0.29), 1.38, 0.15),
}


def radiometric(row: Fig11Row, scale: float = RADIOMETRIC_SCALE) -> Microfacet:
    """A material with the ratios of Fig. 11 that reflects less than it receives. scale : 1/sr."""
    return Microfacet(scale * np.array(row.kd), scale * np.array(row.ks), row.mu, row.sigma)
