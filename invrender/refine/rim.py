"""A photograph's pose from its mask: the mesh's silhouette must lie on the mask's outline.

A texture hardly separates a smooth object's shifts from its turns, and the texture that predicts it has the same
errors; the outline doesn't depend on albedo. How much too large or small a mask is drawn as a whole says nothing of the
pose.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from capture.camera import Camera
from invrender.refine.blocks import PoseEquations, block_equations
from recon.mesh.bodies import MeshBody
from recon.poses.align.outlines import SECTORS, Outline, outline_of
from recon.poses.align.silhouettes import crossings, lines_across
from recon.poses.similarity import Similarity

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Points of an outline, and how far from it the silhouette is looked for: pixels, or a share of its radius.
_POINTS, _REACH_PX, _REACH = 400, 4.0, 0.1
# No mask is believed to be better, pixels, nor to give more than so many numbers in each sector of its outline.
_LEAST_STD, _PER_SECTOR = 0.05, 4
_IN_PLACE = Similarity(1.0, np.eye(3), np.zeros(3))


@dataclass(frozen=True, eq=False)
class SilhouetteRim:
    """Where the silhouette lies to a mask's outline.

    offsets : (n,) pixels outwards, to the reach where there is none. points : (n, 3) world, where the mesh is touched.
    found : (n,) bool. normals : (n, 2), sectors : (n,) of the outline.
    """

    offsets: Floats
    points: Floats
    found: NDArray[np.bool_]
    normals: Floats
    sectors: Ints

    @property
    def std(self) -> float:
        """Of the offsets, pixels, robustly, without what they share."""
        offsets = self.offsets[self.found]
        if not len(offsets):
            return np.inf
        return float(max(1.4826 * np.median(np.abs(offsets - np.median(offsets))), _LEAST_STD))

    def own(self, std: float) -> tuple[Floats, Floats]:
        """Offsets (n,) without what they share, and Cauchy weights (n,), 1 / pixels^2; 0 without silhouette."""
        shared = np.median(self.offsets[self.found]) if self.found.any() else 0.0
        offsets = self.offsets - shared
        weight = np.where(self.found, 1 / (std**2 + offsets**2), 0)
        return offsets - np.average(offsets, weights=np.maximum(weight, 1e-300)), weight

    def deviance(self, std: float) -> float:
        """Cauchy's loss of the offsets, in units of `std`."""
        return float(np.log1p((self.own(std)[0] / std) ** 2).sum())

    def equations(self, motion: Floats, std: float) -> PoseEquations:
        """What the offsets say of a change; motion : (n, 2, 6) of the points in the picture, pixels per unit."""
        offsets, weight = self.own(std)
        slopes = np.where(self.found[:, None], np.einsum("nk,nkj->nj", self.normals, motion), 0)
        slopes = slopes - np.average(slopes, axis=0, weights=np.maximum(weight, 1e-300))
        least = max(len(offsets) / (_PER_SECTOR * SECTORS), 1.0)
        return block_equations(self.sectors, weight, slopes, -offsets, least)


def outline_in(camera: Camera, coverage: NDArray[np.float32] | None) -> Outline | None:
    """The outline of a mask (h, w) in 0 to 1; None where it shows none, or there is no mask."""
    if coverage is None:
        return None
    try:
        return outline_of(camera, coverage).thinned(_POINTS)
    except ValueError:
        return None


def rim_of(outline: Outline, body: MeshBody, camera: Camera) -> SilhouetteRim:
    """How a body's silhouette lies to a photograph's outline when it is seen by a camera."""
    reach = max(_REACH * outline.radius, _REACH_PX)
    lines = lines_across([replace(outline, camera=camera)], [reach])
    met = crossings(body.tracer, _IN_PLACE, lines)
    return SilhouetteRim(
        np.where(met.found, met.offsets, reach), met.points, met.found, outline.normals, outline.sectors
    )
