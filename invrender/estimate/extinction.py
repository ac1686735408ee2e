"""What crossed filters pass of the lobe, as photographs tell: one Gauss-Newton step, all else giving way to it.

    B = Kd D + 2 e Ks S     through crossed filters, of extinction e;  B = Kd D + 2 Ks S  through parallel ones

In e the radiance is linear. The other numbers, at their best for the e so far, are eliminated from the joint normal
equations, as `unknown_light.projection` does; what is left of e's own information is the inverse of its variance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from capture.polarisation import Extinction
from invrender.estimate.clusters import sums_by, tile_of
from invrender.estimate.explanation import Explanation
from invrender.estimate.jacobian import jacobians, pack
from invrender.estimate.linear import symmetric_pinv
from invrender.transport.predict import predict_columns
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]

# Steps end between these: what is passed is divided by the least, and at 1 filters aren't crossed at all.
_LEAST, _MOST = 1e-4, 0.9


@dataclass(frozen=True, eq=False)
class PassedLobe:
    """What crossed samples of a photograph show of the lobe.

    tiles : (n,), numbers of the parts of the photograph that they lie in. by_extinction : (n, 3), derivative of their
    radiance by the extinction, zero through parallel filters. residual, weight : (n, 3), what a fit leaves, and inverse
    variances.
    """

    tiles: NDArray[np.int64]
    by_extinction: Floats
    residual: Floats
    weight: Floats

    @classmethod
    def of(cls, field: LightField, lobe: Floats, residual: Floats, weight: Floats) -> PassedLobe:
        """lobe : (n, 3), what the samples show of it."""
        assert field.lobe_share is not None
        crossed = is_crossed(field)[:, None]
        # A share is twice the extinction.
        passed = np.where(crossed, 2 * lobe / field.lobe_share[:, None], 0.0)
        return cls(tile_of(field), passed, residual, weight)


def is_crossed(field: LightField) -> NDArray[np.bool_]:
    """Which samples (n,) were taken through crossed filters."""
    share = field.lobe_share
    return np.zeros(len(field), bool) if share is None else share < 2


def stepped(
    extinction: Extinction, corner: Floats, right: Floats, photos: Sequence[PassedLobe]
) -> Extinction:
    """The extinction after a step, with its deviation.

    corner : (t, t), right : (t,), normal equations of numbers at their best, the last the extinction.
    """
    covariance = symmetric_pinv(corner)
    variance = covariance[-1, -1]
    if not variance > 0:
        return extinction
    value = extinction.value + float(covariance[-1] @ right)
    std = float(np.sqrt(variance * _beyond_noise(photos)))
    return Extinction(float(np.clip(value, _LEAST, _MOST)), std, "found")


def _beyond_noise(photos: Sequence[PassedLobe]) -> float:
    """How many times the variance that noise leaves is what neighbouring samples have in common; at least 1."""
    squares, information = 0.0, 0.0
    for photo in photos:
        if not photo.by_extinction.any():
            continue
        scores = (photo.by_extinction * photo.weight * photo.residual).sum(axis=1, keepdims=True)
        squares += sum(float(total[0]) ** 2 for total in sums_by(photo.tiles, scores).values())
        information += float((photo.by_extinction**2 * photo.weight).sum())
    return max(squares / information, 1.0) if information else 1.0


def improve_extinction(known: Explanation, extinction: Extinction) -> Extinction:
    """The extinction a step further under known light; as it was where no lobe is seen."""
    estimate = known.best.estimate
    if estimate.brdf.sigma is None:
        return extinction
    parameters = pack(estimate, {photo.lighting: photo.elements for photo in known.photos})
    size = len(parameters.vector) + 1
    corner, right, seen = np.zeros((size, size)), np.zeros(size), []
    for photo, own in zip(known.photos, known.weights, strict=True):
        strengths = estimate.strengths[photo.lighting]
        lobe = predict_columns(photo, replace(estimate.brdf, kd=np.zeros(3)), strengths)
        residual = photo.radiance - predict_columns(photo, estimate.brdf, strengths)
        passed = PassedLobe.of(photo.field, lobe, residual, own.weight)
        seen.append(passed)
        for c, jacobian in enumerate(jacobians(photo, parameters, estimate)):
            columns = np.column_stack([jacobian, passed.by_extinction[:, c]])
            weighted = columns * own.weight[:, c, None]
            corner += weighted.T @ columns
            right += weighted.T @ residual[:, c]
    return stepped(extinction, corner, right, seen)
