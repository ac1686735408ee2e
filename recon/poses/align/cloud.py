"""A mesh's place from a cloud of points, as structure from motion leaves it: iterated closest points, with scale.

The points' own neighbourhood is not asked: each is drawn to the plane of the mesh's nearest sample [Chen & Medioni
1991, "Object modelling by registration of multiple range images"], and the farthest third, background and mistakes,
does not pull [Chetverikov et al. 2002, "The trimmed iterative closest point algorithm"].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from recon.poses.similarity import Similarity, motion_jacobian, rotations_all_over

Floats = NDArray[np.float64]

LEAST_POINTS = 50
_SAMPLES, _POINTS = 20_000, 3000
_KEPT = 0.7
# Of Gaussian distances, the 70% that are least have 0.310 of the variance; and least trimmed squares have
# 1 / (0.7 x 0.310) of the variance that all points together would allow [Rousseeuw & Leroy 1987, ch. 4].
_TRIMMED_VARIANCE = 0.7 / 0.310 / (0.7 * 0.310)
# Rotations to start from, points and steps while trying them, and how many go on to the end.
_ROTATIONS, _TRIED_POINTS, _TRIED_STEPS, _FINISHED = 120, 300, 8, 5
_STEPS = 60


@dataclass(frozen=True, eq=False)
class CloudFit:
    """rms : of the kept points' distances from the mesh, in sizes of the mesh. covariance : (7, 7) of
    `Similarity.moved` about `pivot` (3,), as if points erred on their own."""

    place: Similarity
    rms: float
    pivot: Floats
    covariance: Floats


def read_cloud(path: Path) -> Floats:
    """The points (n, 3) of a PLY file; ValueError names it where it can't be read or is too small."""
    try:
        cloud: Any = trimesh.load(path, process=False)
        points = np.asarray(cloud.vertices, dtype=np.float64)
    except Exception as error:  # trimesh's readers raise whatever a malformed file leads them into
        raise ValueError(f"{path}: cannot be read as a cloud of points ({error}); PLY can") from error
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) < LEAST_POINTS:
        raise ValueError(f"{path}: holds {len(points)} points; at least {LEAST_POINTS} are needed")
    return points


class CloudMatcher:
    """A mesh and the points of a cloud that may lie on it."""

    def __init__(self, vertices: Floats, faces: NDArray[np.integer], points: Floats) -> None:
        body = trimesh.Trimesh(vertices, faces, process=False)
        samples, face = trimesh.sample.sample_surface(body, _SAMPLES, seed=0)
        self._samples, self._normals = np.asarray(samples), np.asarray(body.face_normals[face])
        self._tree = cKDTree(self._samples)
        self._size = float(np.ptp(vertices, axis=0).max())
        self._middle = self._samples.mean(axis=0)
        self._points = points[np.random.default_rng(0).permutation(len(points))[:_POINTS]]

    def search(self, free_scale: bool) -> list[CloudFit]:
        """Places from rotations all over, the best first."""
        centre = np.median(self._points, axis=0)
        spread = float(np.median(np.linalg.norm(self._points - centre, axis=1)))
        own = float(np.median(np.linalg.norm(self._samples - self._middle, axis=1)))
        scale = spread / own if free_scale else 1.0
        tried = []
        for rotation in rotations_all_over(_ROTATIONS):
            start = Similarity(scale, rotation, centre - scale * rotation @ self._middle)
            fit = self._iterated(start, free_scale, self._points[:_TRIED_POINTS], _TRIED_STEPS)
            tried.append((fit.rms, fit.place))
        tried.sort(key=lambda pair: pair[0])
        return self.finish([place for _, place in tried[:_FINISHED]], free_scale)

    def finish(self, starts: Sequence[Similarity], free_scale: bool) -> list[CloudFit]:
        """Places next to given ones, the best first."""
        fits = [self._iterated(start, free_scale, self._points, _STEPS) for start in starts]
        return sorted(fits, key=lambda fit: fit.rms)

    def rms(self, place: Similarity) -> float:
        """How far points lie from a mesh at a place, as `CloudFit.rms`."""
        return self._iterated(place, False, self._points, 0).rms

    def _iterated(self, place: Similarity, free_scale: bool, points: Floats, steps: int) -> CloudFit:
        count = 7 if free_scale else 6
        rows, gap, pivot = self._drawn(place, points)
        # Not `capture.gaussnewton`: the kept points change with each step, so that costs can't be compared.
        for _ in range(steps):
            unit = np.array([1.0] * 3 + [place.scale * self._size / 2] * 3 + [1.0])[:count]
            step = np.zeros(7)
            step[:count] = unit * np.linalg.lstsq(rows[:, :count] * unit, -gap, rcond=1e-6)[0]
            step *= min(1.0, 0.3 / max(float(np.abs(step[:count] / unit).max()), 1e-12))
            place = place.moved(step, pivot)
            rows, gap, pivot = self._drawn(place, points)
            if np.abs(step[:count] / unit).max() < 1e-6:
                break
        rms = float(np.sqrt((gap**2).mean()))
        covariance = np.zeros((7, 7))
        normal = rows[:, :count].T @ rows[:, :count]
        inverse = np.linalg.pinv(normal, rcond=1e-12, hermitian=True)
        covariance[:count, :count] = inverse * rms**2 * _TRIMMED_VARIANCE
        return CloudFit(place, rms / (place.scale * self._size), pivot, covariance)

    def _drawn(self, place: Similarity, points: Floats) -> tuple[Floats, Floats, Floats]:
        """Jacobian (k, 7) and distances (k,) of the kept points from the mesh's planes, world, and the pivot (3,)."""
        distance, nearest = self._tree.query(place.undo(points))
        kept = np.argsort(distance, kind="stable")[: max(int(_KEPT * len(points)), LEAST_POINTS // 2)]
        on_mesh = place.apply(self._samples[nearest[kept]])
        normals = self._normals[nearest[kept]] @ place.rotation.T
        pivot = place.apply(self._middle[None])[0]
        gap = np.einsum("nc,nc->n", normals, on_mesh - points[kept])
        return np.einsum("nc,ncp->np", normals, motion_jacobian(on_mesh, pivot)), gap, pivot
