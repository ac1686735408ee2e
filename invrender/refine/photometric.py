"""A photograph's pose from its pixels: where it must have been taken from to look as it was predicted.

With the picture P that is predicted at a pose and the motion u(x) of the surface in it per change of the pose, the
picture changes by -grad P . u, as if everything that is seen, highlights too, were a texture. Gauss-Newton steps with
these slopes [Lucas and Kanade 1981, "An iterative image registration technique"] are judged by new predictions, on
pixels that they are not made from. The mask's outline has its say in both (`rim`). What neither determines is held by a
prior: how far off the pose may be.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from capture.radiance import RadianceImage
from invrender.estimate.evidence import relative_rms
from invrender.estimate.noise import NoiseModel, photo_weights
from invrender.refine.blocks import PoseEquations, block_equations
from invrender.refine.posechange import LoosePose
from invrender.refine.rim import SilhouetteRim, rim_of
from invrender.transport.visibility import facing
from recon.mesh.bodies import MeshBody
from recon.poses.align.outlines import Outline
from recon.sampling.draw import samples_around
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_STEPS, _HALVINGS = 4, 2
# A step this small against what a pose may be off is the last.
_SMALL = 1e-3
# Blocks of pixels, this many a side, by turns make the steps and judge them.
BLOCK = 6
_FEWEST = 100


@dataclass(frozen=True, eq=False)
class PoseTarget(LoosePose):
    """What a photograph shows, and what is needed to predict it from elsewhere.

    rows, columns : (n,) of the pixels that are compared; observed : (n, 3), what they show. radiance : of samples.
    outline : of the mask, None without one.
    """

    body: MeshBody
    rows: Ints
    columns: Ints
    observed: Floats
    radiance: Callable[[LightField], Floats]
    noise: NoiseModel
    outline: Outline | None = None

    def rim(self, change: Floats) -> SilhouetteRim | None:
        """How the silhouette lies to the mask's outline after a change; None without one."""
        return None if self.outline is None else rim_of(self.outline, self.body, self.at(change))

    def predicted(self, change: Floats, rows: Ints, columns: Ints) -> tuple[Floats, Floats]:
        """What pixels (k,) show after a change, (k, 3), and where what they show lies, (k, 3).

        NaN where no whole pixel of the object is seen, and outside the photograph.
        """
        camera = self.at(change)
        radiance, positions = np.full((2, len(rows), 3), np.nan)
        inside = np.flatnonzero(
            (rows >= 0) & (rows < camera.height) & (columns >= 0) & (columns < camera.width)
        )
        black = RadianceImage.black(camera.height, camera.width)
        places = np.column_stack([columns[inside], rows[inside]]).astype(float) + 0.5
        field, whole = samples_around(self.body, camera, black, places)
        field = facing(field)
        radiance[inside[whole]] = self.radiance(field)
        positions[inside[whole]] = field.mean_over_rays(field.positions)
        return radiance, positions

    def slopes(self, change: Floats) -> tuple[Floats, Floats]:
        """What the pixels show after a change, (n, 3), and its slopes in the change's components, (n, 3, 6).

        NaN where a pixel or one beside it isn't predicted.
        """
        pixels, places = self._around
        radiance, positions = self.predicted(change, *pixels)
        here, right, left, below, above = radiance[places]
        gradient = np.stack([right - left, below - above], axis=-1) / 2
        motion = self.motion(change, positions[places[0]])
        return here, -np.einsum("nck,nkj->ncj", gradient, motion)

    @cached_property
    def _around(self) -> tuple[Ints, Ints]:
        """Rows and columns (2, k) of the pixels and those beside them, and where each and its four are among these."""
        steps = np.array([(0, 0), (0, 1), (0, -1), (1, 0), (-1, 0)])
        pixels = np.stack([self.rows, self.columns]) + steps[:, :, None]  # (5, 2, n)
        each, places = np.unique(pixels.swapaxes(0, 1).reshape(2, -1), axis=1, return_inverse=True)
        return each, places.reshape(len(steps), -1)


@dataclass(frozen=True, eq=False)
class RefinedPose:
    """What a photograph says of its pose.

    change : (6,) in units, zero where nothing is said. covariance : (6, 6), in units. observations : pixels, or points
    of the surface, that it was read off.
    error_before, error_after : relative RMS of pixels that made no step.
    """

    change: Floats
    covariance: Floats
    observations: int
    error_before: float
    error_after: float


@dataclass(frozen=True, eq=False)
class _View:
    """A photograph as predicted after a change (6,), in units: pixels (n, 3), their slopes (n, 3, 6), its rim."""

    change: Floats
    predicted: Floats
    slopes: Floats
    rim: SilhouetteRim | None

    @property
    def whole(self) -> NDArray[np.bool_]:
        """Pixels (n,) that are predicted, slopes too."""
        joint = np.column_stack([self.predicted, self.slopes.reshape(len(self.slopes), -1)])
        return np.asarray(np.isfinite(joint).all(axis=1))


@dataclass(frozen=True, eq=False)
class _Judge:
    """A step, and what judges it, as things looked before it.

    information : (6, 6) and step : (6,), of pixels, outline and prior. observed : (n, 3). weight : (n, 3) of pixels
    that judge, 0 of others. together, rim_together : how many pixels, and how many points of the outline, count as
    one. rim_std : pixels.
    """

    information: Floats
    step: Floats
    observed: Floats
    weight: Floats
    together: float
    rim_together: float
    rim_std: float

    def deviance(self, view: _View) -> float:
        """Of the pixels that judge, the outline and the prior; pixels that are lacking have the others' mean."""
        residual = self.observed - view.predicted
        judging = self.weight > 0
        used = judging & np.isfinite(residual)
        pixels = (self.weight[used] * residual[used] ** 2).sum() / max(used.sum(), 1) * judging.sum()
        rim = 0.0 if view.rim is None else view.rim.deviance(self.rim_std) / self.rim_together
        return float(pixels / self.together + rim + view.change @ view.change)


def refine_pose(target: PoseTarget, start: Floats) -> RefinedPose:
    """The change (6,) of a photograph's pose, in units, that its pixels and outline ask for, from a start on."""
    makes = (target.rows // BLOCK + target.columns // BLOCK) % 2 == 0
    view = _viewed(target, start)
    if view.whole.sum() < _FEWEST:
        return RefinedPose(start, np.eye(6), 0, np.nan, np.nan)
    before = _error(target, view, ~makes)
    # Not `capture.gaussnewton`: a trial renders the photograph, and two halvings cost less than rising damping.
    for _ in range(_STEPS):
        judge = _judge(target, view, makes)
        now = judge.deviance(view)
        for halvings in range(_HALVINGS + 1):
            there = _viewed(target, view.change + judge.step / 2**halvings)
            if judge.deviance(there) < now:
                break
        else:
            break
        view = there
        if np.abs(judge.step).max() < _SMALL:
            break
    covariance = np.asarray(np.linalg.inv(judge.information), float)
    return RefinedPose(view.change, covariance, len(target.rows), before, _error(target, view, ~makes))


def _viewed(target: PoseTarget, change: Floats) -> _View:
    return _View(change, *target.slopes(change), target.rim(change))


def _judge(target: PoseTarget, view: _View, makes: NDArray[np.bool_]) -> _Judge:
    """The Gauss-Newton step from a view, made of some pixels, (n,) bool, and what judges it."""
    whole, observed = view.whole, target.observed
    residual = np.where(whole[:, None], observed - view.predicted, 0)
    weight = np.zeros_like(observed)
    weight[whole] = photo_weights(target.noise, view.predicted[whole], residual[whole]).weight
    blocks = np.repeat((target.rows // BLOCK) * 100_000 + target.columns // BLOCK, 3)
    slopes = np.where(whole[:, None, None], view.slopes, 0).reshape(-1, 6)
    pixels = block_equations(blocks, (weight * makes[:, None]).ravel(), slopes, residual.ravel())
    rim, std = PoseEquations(np.zeros((6, 6)), np.zeros(6), 1.0), np.inf
    if view.rim is not None:
        std = view.rim.std
        rim = view.rim.equations(target.motion(view.change, view.rim.points), std)
    information = pixels.information + rim.information + np.eye(6)
    step = np.asarray(np.linalg.solve(information, pixels.pull + rim.pull - view.change), float)
    judging = weight * ~makes[:, None]
    return _Judge(information, step, observed, judging, pixels.together, rim.together, std)


def _error(target: PoseTarget, view: _View, chosen: NDArray[np.bool_]) -> float:
    seen = np.isfinite(view.predicted) & chosen[:, None]
    return relative_rms((target.observed - view.predicted)[seen], target.observed[seen])
