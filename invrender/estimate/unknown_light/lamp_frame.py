"""What near lamps' directions and closeness count from: the object's centre, in units of its radius."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LampFrame:
    """The sphere around the object.

    centre : (3,) metres, in the world. radius : metres; 0 where samples have no places, and no lamp can be near.
    """

    centre: Floats
    radius: float

    @staticmethod
    def of(photos: Sequence[LightField]) -> LampFrame:
        """The sphere that samples lie on, or about: p = c + r n in the least squares, and out to the farthest."""
        places, normals = (
            np.concatenate([getattr(photo, name) for photo in photos]) for name in ("positions", "normals")
        )
        middle, turned = places.mean(axis=0), normals - normals.mean(axis=0)
        bend = float((turned * (places - middle)).sum() / max((turned**2).sum(), 1e-300))
        centre = middle - bend * normals.mean(axis=0)
        return LampFrame(centre, float(np.linalg.norm(places - centre, axis=1).max()))

    def world(self, sources: Floats) -> Floats:
        """Sources as rows of the world (`capture.lighting`), from directions (k, 3), or with their closeness (k, 4).

        closeness : radii over the distance from the centre.
        """
        if sources.shape[1] == 3:
            return sources
        closeness = sources[:, 3:] / max(self.radius, 1e-300)
        return np.column_stack([sources[:, :3] + closeness * self.centre, closeness])


# Of what has no near lamps.
ANYWHERE = LampFrame(np.zeros(3), 0.0)
