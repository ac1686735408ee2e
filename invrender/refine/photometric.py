"""A photograph's pose from its pixels: where it must have been taken from to look as it was predicted.

With the picture P that is predicted at a pose and the motion u(x) of the surface in it per change of the pose, the
picture changes by -grad P . u, as if everything that is seen, highlights too, were painted on. Gauss-Newton steps with
these slopes [Lucas and Kanade 1981, "An iterative image registration technique"] are judged by new predictions, on
pixels that they are not made from. What pixels don't tell is held by a prior: how far off the pose may be.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, generate_binary_structure

from capture.camera import Camera
from capture.radiance import RadianceImage
from invrender.model.visibility import facing
from invrender.refine.posechange import changed, image_motion
from invrender.solve.evidence import relative_rms
from invrender.solve.linear import symmetric_pinv
from invrender.solve.noise import NoiseModel, photo_weights
from recon.bodies import Body
from recon.lightfield import LightField
from recon.sampling import NO_SOURCES, samples_at

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_STEPS, _HALVINGS = 4, 2
# A step this small against what a pose may be off is the last.
_SMALL = 1e-3
# Blocks of pixels, this many a side, by turns make the steps and judge them.
_BLOCK = 6
_FEWEST = 100


@dataclass(frozen=True, eq=False)
class Sight:
    """A photograph, and what is needed to predict it from elsewhere.

    camera : at the pose that was given. centre : (3,) of the object. units : (6,), how far off the pose may be, radians
    and metres: standard deviations. rows, columns : (n,) of the pixels that are compared. radiance : of samples.
    """

    body: Body
    camera: Camera
    image: RadianceImage
    centre: Floats
    units: Floats
    rows: Ints
    columns: Ints
    radiance: Callable[[LightField], Floats]
    noise: NoiseModel

    def at(self, change: Floats) -> Camera:
        """The camera after a change (6,) in units."""
        return changed(self.camera, self.centre, change * self.units)

    @property
    def px_per_metre(self) -> float:
        """What a shift of the object across the view moves its middle in the picture."""
        camera = self.camera
        return camera.focal_px / (1.0 if camera.is_orthographic else float(camera.depth(self.centre)[0]))

    def predicted(self, change: Floats, rows: Ints, columns: Ints) -> tuple[Floats, Floats]:
        """A picture (h, w, 3) of what some pixels show after a change, and where what they show lies, (h, w, 3).

        NaN in other pixels, and where no whole pixel of the object is seen.
        """
        height, width = self.image.saturated.shape
        radiance, positions = np.full((2, height, width, 3), np.nan)
        field = facing(samples_at(self.body, self.at(change), self.image, rows, columns, NO_SOURCES))
        radiance[field.rows, field.columns] = self.radiance(field)
        positions[field.rows, field.columns] = field.mean_over_rays(field.positions)
        return radiance, positions

    def slopes(self, change: Floats) -> tuple[Floats, Floats]:
        """What the pixels show after a change, (n, 3), and its slopes in the change's components, (n, 3, 6).

        NaN where a pixel or one beside it isn't predicted.
        """
        height, width = self.image.saturated.shape
        around = np.zeros((height, width), bool)
        around[self.rows, self.columns] = True
        around = binary_dilation(around, structure=generate_binary_structure(2, 1))
        radiance, positions = self.predicted(change, *np.nonzero(around))
        padded = np.pad(radiance, ((1, 1), (1, 1), (0, 0)), constant_values=np.nan)
        right, left = padded[1:-1, 2:], padded[1:-1, :-2]
        below, above = padded[2:, 1:-1], padded[:-2, 1:-1]
        gradient = np.stack([right - left, below - above], axis=-1)[self.rows, self.columns] / 2
        at = positions[self.rows, self.columns]
        motion = image_motion(self.camera, self.centre, change * self.units, self.units, at)
        return radiance[self.rows, self.columns], -np.einsum("nck,nkj->ncj", gradient, motion)


@dataclass(frozen=True, eq=False)
class RefinedPose:
    """What pixels say of a pose.

    change : (6,) in units, zero where they say nothing. covariance : (6, 6), in units.
    error_before, error_after : relative RMS of pixels that made no step.
    """

    change: Floats
    covariance: Floats
    error_before: float
    error_after: float


def refine_pose(sight: Sight, start: Floats) -> RefinedPose:
    """The change (6,) of a photograph's pose, in units, that its pixels ask for, from a start on."""
    observed = sight.image.radiance[sight.rows, sight.columns].astype(float)
    makes = (sight.rows // _BLOCK + sight.columns // _BLOCK) % 2 == 0
    change = start
    predicted, slopes = sight.slopes(change)
    if _whole(predicted, slopes).sum() < _FEWEST:
        return RefinedPose(start, np.eye(6), np.nan, np.nan)

    def relative(predicted: Floats) -> float:
        seen = np.isfinite(predicted) & ~makes[:, None]
        return relative_rms((observed - predicted)[seen], observed[seen])

    before = relative(predicted)
    for _ in range(_STEPS):
        whole = _whole(predicted, slopes)
        residual, slopes = (
            np.where(whole[:, None], observed - predicted, 0),
            np.where(whole[:, None, None], slopes, 0),
        )
        weight = np.zeros_like(observed)
        weight[whole] = photo_weights(sight.noise, predicted[whole], residual[whole]).weight
        making, judging = weight * makes[:, None], weight * ~makes[:, None]
        information, together = _information(sight, making, slopes, residual)
        pull = np.einsum("nc,nci,nc->i", making, slopes, residual) / together
        covariance = np.asarray(np.linalg.inv(information + np.eye(6)), float)
        now = _deviation(judging, observed - predicted)
        step = covariance @ (pull - change)
        for halvings in range(_HALVINGS + 1):
            tried = change + step / 2**halvings
            there = sight.slopes(tried)
            if _deviation(judging, observed - there[0]) < now:
                break
        else:
            break
        change, (predicted, slopes) = tried, there
        if np.abs(step).max() < _SMALL:
            break
    return RefinedPose(change, covariance, before, relative(predicted))


def _whole(predicted: Floats, slopes: Floats) -> NDArray[np.bool_]:
    return np.asarray(np.isfinite(np.column_stack([predicted, slopes.reshape(len(slopes), -1)])).all(axis=1))


def _deviation(weight: Floats, residual: Floats) -> float:
    """Weighted RMS of residuals (n, 3), of those that there are; weights are 0 of what has no say."""
    used = np.isfinite(residual) & (weight > 0)
    return float(np.sqrt((weight[used] * residual[used] ** 2).sum() / max(used.sum(), 1)))


def _information(sight: Sight, weight: Floats, slopes: Floats, residual: Floats) -> tuple[Floats, float]:
    """What pixels tell of a change, (6, 6), and by what their independent information was divided for it, 1 or more.

    What the prediction lacks, a blurred texture's edges say, is the same over blocks of pixels: scores are then as much
    larger than noise would make them, and the pixels count for as much less.
    """
    blocks = np.unique((sight.rows // _BLOCK) * 100_000 + sight.columns // _BLOCK, return_inverse=True)[1]
    scores = np.zeros((blocks.max() + 1, 6))
    np.add.at(scores, blocks, np.einsum("nc,nci,nc->ni", weight, slopes, residual))
    independent = np.einsum("nc,nci,ncj->ij", weight, slopes, slopes)
    # Directions of which nothing is told have no say in it.
    excess = float(np.trace(symmetric_pinv(independent) @ scores.T @ scores)) / 6
    together = max(excess, 1.0)
    return independent / together, together
