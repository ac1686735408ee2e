"""What every material has: a Lambertian base under a lobe, each with a weight per channel.

    rho(wi, wo) = kd + ks lobe(wi, wo)

Lobes work in the local frame of the surface: x along the tangent, z along the normal.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capture.arrays import frozen_array
from synthetic.vectors import local_frame, to_local

Floats = NDArray[np.float64]
AnyFloats = NDArray[np.floating]


@dataclass(frozen=True, eq=False)
class Material:
    """A Lambertian base under a lobe.

    kd : (3,) RGB, 1/sr, >= 0; the diffuse albedo is pi kd. ks : (3,) RGB, >= 0, times the lobe.
    """

    kd: Floats
    ks: Floats

    def __post_init__(self) -> None:
        for name in ("kd", "ks"):
            value = np.asarray(getattr(self, name), float)
            if value.shape != (3,) or not np.isfinite(value).all() or (value < 0).any():
                raise ValueError(f"{name} is {value.tolist()}; it must be three finite numbers >= 0")
            object.__setattr__(self, name, frozen_array(value))

    @property
    def is_mirror(self) -> bool:
        """Whether the lobe is a perfect mirror's: `lobe` is then 0 and `sample` gives the mirrored direction."""
        return False

    def mirrored(self, wo: AnyFloats) -> AnyFloats:
        """Share (..., 1) that a perfect mirror shows viewers in local directions (..., 3) of the mirrored direction."""
        return np.zeros_like(wo[..., :1])

    @property
    def is_isotropic(self) -> bool:
        """Whether turning the surface about its normal changes nothing, so that tangents do not matter."""
        return True

    def weights(self, uv: AnyFloats) -> tuple[Floats, Floats]:
        """kd and ks, (n, 3) each, at texture coordinates (n, 2)."""
        shape = (len(uv), 3)
        return np.broadcast_to(self.kd, shape), np.broadcast_to(self.ks, shape)

    @abstractmethod
    def lobe(self, wi: AnyFloats, wo: AnyFloats) -> AnyFloats:
        """The lobe (..., 1) or (..., 3), 1/sr, for local unit directions (..., 3), broadcast; 0 unless both have z > 0.

        wi : towards the light. wo : towards the viewer. Keeps the dtype.
        """

    @abstractmethod
    def sample(self, wo: AnyFloats, u: AnyFloats) -> AnyFloats:
        """Directions (..., 3) towards the light, about as dense as lobe times cosine, for u (..., 2) in 0 to 1.

        May lie below the surface, where the lobe is 0.
        """

    @abstractmethod
    def density(self, wi: AnyFloats, wo: AnyFloats) -> AnyFloats:
        """Density (...,) of `sample`, 1/sr, at local directions (..., 3); integrates to 1 over the sphere."""

    def evaluate(
        self, n: ArrayLike, wi: ArrayLike, wo: ArrayLike, tangent: ArrayLike | None = None
    ) -> Floats:
        """The BRDF (..., 3), 1/sr, for unit vectors (..., 3) in the world; 0 unless light and viewer are above."""
        n, wi, wo = (np.asarray(v, float) for v in (n, wi, wo))
        frame = local_frame(n, None if tangent is None else np.asarray(tangent, float))
        wi, wo = to_local(frame, wi), to_local(frame, wo)
        above = (wi[..., 2] > 0) & (wo[..., 2] > 0)
        return np.where(above[..., None], self.kd + self.ks * self.lobe(wi, wo), 0.0)


def sample_cosine(u: AnyFloats) -> AnyFloats:
    """Local directions (..., 3), as dense as cosine / pi, for u (..., 2) in 0 to 1."""
    radius, phi = np.sqrt(u[..., 0]), 2 * np.pi * u[..., 1]
    up = np.sqrt(1 - u[..., 0])
    return np.stack([radius * np.cos(phi), radius * np.sin(phi), up], axis=-1)


def cosine_density(directions: AnyFloats) -> AnyFloats:
    """Density (...,) of `sample_cosine`, 1/sr, at local directions (..., 3)."""
    return np.maximum(directions[..., 2], 0) / np.pi
