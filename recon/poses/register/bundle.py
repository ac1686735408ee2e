"""Bundle adjustment with a weight for each observation.

Triggs, McLauchlan, Hartley, Fitzgibbon, "Bundle adjustment: a modern synthesis", 1999: points are eliminated
(section 6.1), and what is left is solved for the poses.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial.transform import Rotation

from capture.camera import Camera
from capture.gaussnewton import LocalProblem, gauss_newton
from recon.poses.similarity import cross_matrix

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Cauchy's loss with this many standard deviations loses 5% of efficiency if errors are Gaussian.
CAUCHY = 2.385
# Rounds in which the loss gets its width from the residuals anew, and steps in each.
_ROUNDS, _STEPS = 3, 60
# A gain of so few variances of the noise ends a round: 3% of a standard deviation.
_CONVERGED = 1e-3
# Pixels: residuals are never held to be better than this, be a simulation ever so exact.
_LEAST = 1e-6


@dataclass(frozen=True, eq=False)
class Bundle:
    """Points seen by photographs.

    lenses : perspective cameras, their poses without meaning. lens : (c,), which of them each photograph was taken by.
    poses : (c, 4, 4), world to camera. points : (p, 3), in the same world.
    photo, point : (n,), which photograph saw which point. pixels : (n, 2), where.
    widths : (n,), standard deviations of the observations up to a common factor.
    """

    lenses: tuple[Camera, ...]
    lens: Ints
    poses: Floats
    points: Floats
    photo: Ints
    point: Ints
    pixels: Floats
    widths: Floats

    def kept(self, keep: NDArray[np.bool_]) -> Bundle:
        """The same with fewer observations; points that fewer than two photographs are left to see go as well."""
        seen = np.bincount(self.point[keep], minlength=len(self.points)) >= 2
        keep = keep & seen[self.point]
        return replace(
            self,
            points=self.points[seen],
            photo=self.photo[keep],
            point=(np.cumsum(seen) - 1)[self.point[keep]],
            pixels=self.pixels[keep],
            widths=self.widths[keep],
        )

    @property
    def local(self) -> Floats:
        """The point of each observation in its photograph's camera frame, (n, 3)."""
        poses = self.poses[self.photo]
        return np.einsum("nij,nj->ni", poses[:, :3, :3], self.points[self.point]) + poses[:, :3, 3]

    @property
    def residuals(self) -> Floats:
        """Seen minus predicted, (n, 2) pixels; infinite where a point lies behind its camera."""
        return self.pixels - self._projected(self.local)

    @property
    def distance(self) -> float:
        """Median distance of the cameras from the middle of the points."""
        offsets = self.poses[:, :3, 3] + self.poses[:, :3, :3] @ np.median(self.points, axis=0)
        return float(np.median(np.linalg.norm(offsets, axis=1)))

    def camera_jacobian(self) -> Floats:
        """Derivatives (n, 2, 6) of image points by a small turn about the camera's centre, and a shift of it."""
        local = self.local
        step = 1e-6 * np.linalg.norm(local, axis=1)[:, None]
        of_local = np.stack(
            [
                (self._projected(local + step * axis) - self._projected(local - step * axis)) / (2 * step)
                for axis in np.eye(3)
            ],
            axis=2,
        )
        return np.concatenate([-of_local @ cross_matrix(local), of_local], axis=2)

    def moved(self, step: Floats) -> Bundle:
        """After a step (6c + 3p,) of `NormalEquations`."""
        motions, shifts = np.split(step, [6 * len(self.poses)])
        after = np.tile(np.eye(4), (len(self.poses), 1, 1))
        after[:, :3, :3] = Rotation.from_rotvec(motions.reshape(-1, 6)[:, :3]).as_matrix()
        after[:, :3, 3] = motions.reshape(-1, 6)[:, 3:]
        return replace(self, poses=after @ self.poses, points=self.points + shifts.reshape(-1, 3))

    def _projected(self, local: Floats) -> Floats:
        pixels = np.empty((len(local), 2))
        lens_of = self.lens[self.photo]
        for number, lens in enumerate(self.lenses):
            own = lens_of == number
            pixels[own] = lens.posed(np.eye(4)).project(local[own])
        return np.where(np.isfinite(pixels), pixels, np.inf)


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """The normal equations of a bundle.

    matrix : (6c, 6c) of the photographs, each a small turn about the camera's centre and axes, then a shift along them.
    vector : (6c,). cross : (6c, 3p). blocks : (p, 3, 3), the points' own. pull : (p, 3).
    """

    matrix: Floats
    vector: Floats
    cross: csr_array
    blocks: Floats
    pull: Floats

    def reduced(self, damping: float = 0.0) -> tuple[Floats, Floats, Floats]:
        """Matrix (6c, 6c) and vector (6c,) with the points eliminated, and the inverses (p, 3, 3) of their blocks.

        damping : share of their diagonal by which matrix and blocks are raised, as Levenberg and Marquardt do.
        """
        inverses = np.asarray(np.linalg.inv(_raised(self.blocks, damping)), float)
        through = self.cross @ _sparse_blocks(inverses)
        matrix: Floats = _raised(self.matrix, damping) - (through @ self.cross.T).toarray()
        return matrix, self.vector - through @ self.pull.ravel(), inverses

    def step(self, damping: float) -> Floats:
        """The photographs' turns and shifts, then the points' shifts, (6c + 3p,)."""
        matrix, vector, inverses = self.reduced(damping)
        step = np.linalg.solve(matrix, vector)
        pull = self.pull - (self.cross.T @ step).reshape(-1, 3)
        return np.concatenate([step, np.einsum("pij,pj->pi", inverses, pull).ravel()])


def adjust(bundle: Bundle) -> Bundle:
    """The poses and points that fit the observations best under Cauchy's loss, by Levenberg's and Marquardt's steps."""
    for _ in range(_ROUNDS):
        scale = CAUCHY * spread(bundle)
        bundle = gauss_newton(bundle, partial(_about, scale), _CONVERGED, _STEPS, damping=1e-4)
    return bundle


def _about(scale: float, bundle: Bundle) -> LocalProblem[Bundle]:
    """The adjustment about a bundle under Cauchy's loss that bends at a scale, in variances of its residuals."""
    system, cost = normal_equations(bundle, cauchy_weights(bundle, scale)), _cost(bundle, scale)
    pull = np.concatenate([system.vector, system.pull.ravel()]) * (CAUCHY / scale) ** 2
    return LocalProblem(
        system.step, pull, bundle.moved, lambda tried: CAUCHY**2 * (cost - _cost(tried, scale))
    )


def spread(bundle: Bundle) -> float:
    """Standard deviation of one coordinate of an observation of width 1, pixels, from the residuals' median."""
    shares = np.abs(bundle.residuals) / bundle.widths[:, None]
    # Each point takes three of its own residuals' degrees of freedom away, each photograph six.
    taken = 3 * len(bundle.points) + 6 * len(bundle.poses) - 7
    growth = np.sqrt(shares.size / max(shares.size - taken, 1))
    return max(float(1.4826 * np.median(shares) * growth), _LEAST)


def cauchy_weights(bundle: Bundle, scale: float) -> Floats:
    """Weights (n,) of Cauchy's loss that bends at scale, in widths; the widths themselves included."""
    shares = (bundle.residuals**2).sum(axis=1) / (scale * bundle.widths) ** 2
    return np.asarray(1 / ((1 + shares) * bundle.widths**2))


def _cost(bundle: Bundle, scale: float) -> float:
    shares = (bundle.residuals**2).sum(axis=1) / (scale * bundle.widths) ** 2
    return float(np.log1p(shares).sum())


def normal_equations(bundle: Bundle, weights: Floats) -> NormalEquations:
    """The normal equations of a bundle under weights (n,)."""
    of_camera = bundle.camera_jacobian()
    of_point = of_camera[:, :, 3:] @ bundle.poses[bundle.photo, :3, :3]
    weighted = of_camera * weights[:, None, None]
    residuals = bundle.residuals
    photos, points = len(bundle.poses), len(bundle.points)

    matrix = np.zeros((photos, 6, 6))
    np.add.at(matrix, bundle.photo, weighted.mT @ of_camera)
    vector = np.zeros((photos, 6))
    np.add.at(vector, bundle.photo, np.einsum("nij,ni->nj", weighted, residuals))
    blocks = np.zeros((points, 3, 3))
    np.add.at(blocks, bundle.point, (of_point * weights[:, None, None]).mT @ of_point)
    pull = np.zeros((points, 3))
    np.add.at(pull, bundle.point, np.einsum("nij,ni,n->nj", of_point, residuals, weights))

    products = weighted.mT @ of_point
    rows = np.broadcast_to(6 * bundle.photo[:, None, None] + np.arange(6)[:, None], products.shape)
    columns = np.broadcast_to(3 * bundle.point[:, None, None] + np.arange(3), products.shape)
    shape = (6 * photos, 3 * points)
    cross = csr_array((products.ravel(), (rows.ravel(), columns.ravel())), shape=shape)
    return NormalEquations(_sparse_blocks(matrix).toarray(), vector.ravel(), cross, blocks, pull)


def _raised(blocks: Floats, damping: float) -> Floats:
    """Matrices (..., k, k) whose diagonals are larger by a share of them."""
    return np.asarray(blocks + damping * blocks * np.eye(blocks.shape[-1]))


def _sparse_blocks(blocks: Floats) -> csr_array:
    """Square blocks (n, k, k) along the diagonal of a matrix (n k, n k)."""
    count, side, _ = blocks.shape
    places = np.arange(count * side).reshape(count, side)
    rows, columns = np.repeat(places, side, axis=1), np.tile(places, side)
    return csr_array((blocks.ravel(), (rows.ravel(), columns.ravel())), shape=(count * side,) * 2)
