"""The microfacet BRDF of RH01 as printed.

    rho = Kd + Ks F(mu, theta_o) / F(mu, 0) S(theta_h) / (4 cos theta_i cos theta_o)     [RH01, section 5.2]
    S   = exp(-(theta_h / sigma)^2) / (pi sigma^2)

Taken as printed, so that truth and fit mean the same parameters: Fresnel at the exitant angle instead of
the half vector's, and no shadowing-masking. Both make it wrong physics at grazing angles, where its
reflectance grows without bound.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capture.arrays import frozen_array
from synthetic.materials.fresnel import fresnel_dielectric

Floats = NDArray[np.float64]


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
