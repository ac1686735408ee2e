"""The sphere, exactly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture.arrays import frozen_array
from recon.sphere.sphere import Sphere
from synthetic.shapes.surface import Points
from synthetic.shapes.tangents import tangents

Floats = NDArray[np.float64]
AnyFloats = NDArray[np.floating]


@dataclass(frozen=True, eq=False)
class Ball:
    """A sphere as a `Surface`.

    centre : (3,) metres. radius : metres. Texture coordinates are the angles of the normal: u = phi / 2 pi from +X
    towards +Y, v = 1 - theta / pi from -Z to +Z. Tangents are horizontal, along phi.
    """

    centre: Floats
    radius: float

    convex = True

    def __post_init__(self) -> None:
        centre = np.asarray(self.centre, float)
        if centre.shape != (3,) or not np.isfinite(centre).all():
            raise ValueError(f"the ball's centre is {centre.tolist()}; it must be three finite numbers")
        if not 0 < self.radius < np.inf:
            raise ValueError(f"the ball's radius is {self.radius} m; it must be > 0 and finite")
        object.__setattr__(self, "centre", frozen_array(centre))

    @property
    def reach(self) -> float:
        return self.radius

    @property
    def sphere(self) -> Sphere:
        """The same as what silhouettes are compared with."""
        return Sphere(self.centre, self.radius, np.zeros((4, 4)))

    def first_hits(
        self, origins: Floats, directions: AnyFloats, facets: Floats | None = None
    ) -> tuple[NDArray[np.bool_], Points]:
        """As every surface's; rays that begin on the ball leave it and never meet it again."""
        hit, normals = self._first_normals(origins, directions)
        if facets is not None:
            hit[:] = False
        return hit, self._points(normals[hit])

    def met(self, origins: Floats, directions: AnyFloats) -> NDArray[np.bool_]:
        return self._first_normals(origins, directions)[0]

    def occluded(
        self,
        positions: Floats,
        facets: AnyFloats,
        directions: AnyFloats,
        distances: Floats | None = None,
    ) -> NDArray[np.bool_]:
        """As every surface's; only directions below the horizon are."""
        return np.asarray((facets * directions).sum(axis=1) <= 0)

    def contains(self, points: Floats) -> NDArray[np.bool_]:
        return np.asarray(np.linalg.norm(points - self.centre, axis=1) < self.radius)

    def _first_normals(self, origins: Floats, directions: AnyFloats) -> tuple[NDArray[np.bool_], Floats]:
        """Whether rays meet the ball (n,), and the outward normals (n, 3) where they first do."""
        hit, normals = self.sphere.hits(origins, directions.astype(float, copy=False))
        along = np.einsum("nc,nc->n", normals, directions)
        towards = np.einsum("nc,nc->n", self.centre - origins, directions)
        # From the line's middle it is half the chord, -along r >= 0, to either side.
        inside = hit & (towards + along * self.radius <= 0)
        normals[inside] -= 2 * along[inside, None] * directions[inside]
        hit &= towards - along * self.radius > 0
        return hit, normals

    def _points(self, normals: Floats) -> Points:
        phi = np.arctan2(normals[:, 1], normals[:, 0])
        theta = np.arctan2(np.hypot(normals[:, 0], normals[:, 1]), normals[:, 2])
        uv = np.column_stack([phi / (2 * np.pi) % 1, 1 - theta / np.pi])
        return Points(self.centre + self.radius * normals, normals, normals, tangents(normals), uv)
