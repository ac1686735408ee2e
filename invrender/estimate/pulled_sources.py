"""Which way highlights pull the sources that light them, the BRDF's numbers free to follow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture.lighting import Lighting
from invrender.estimate.calibration import turned_source
from invrender.estimate.jacobian import jacobians, pack
from invrender.estimate.linear import symmetric_pinv
from invrender.estimate.models import Estimate
from invrender.estimate.noise import Weights
from invrender.transport.columns import PhotoColumns
from invrender.transport.predict import predict_photos, reflected
from recon.mesh.tangents import tangents

Floats = NDArray[np.float64]

# Of a lobe's width, the step of differences.
_OF_WIDTH = 0.05
# Rays of a sample that slopes are taken of.
_RAYS_OF_SAMPLE = 3


@dataclass(frozen=True, eq=False)
class PulledSources:
    """Which way residuals pull sources: information (2 m, 2 m) on their turns, and that times the turns (2 m,)."""

    information: Floats
    pull: Floats


def pulled_sources(
    here: Mapping[str, Lighting],
    photos: Sequence[PhotoColumns],
    weights: Sequence[Weights],
    estimate: Estimate,
) -> PulledSources:
    """Which way highlights pull the sources of lightings `here`, the BRDF's numbers free to follow.

    Highlights alone tell: where matte surfaces aren't Lambert's, their shading would turn lights. So residuals are
    projected on slopes of the lobe, as on instruments [Hansen 1982]. The variance is that of what samples pull: it
    holds what the lobe's form misses.
    """
    parameters = pack(estimate, {photo.lighting: photo.elements for photo in photos})
    size = len(parameters.vector)
    count = {name: 2 * len(own.directions) for name, own in here.items()}
    ends = np.cumsum(list(count.values()))
    places = {name: slice(int(end) - count[name], int(end)) for name, end in zip(here, ends, strict=True)}
    turns = int(ends[-1])
    numbers, mixed = np.zeros((size, size)), np.zeros((size, turns))
    follow, alone = np.zeros((turns, size)), np.zeros((turns, turns))
    pulls, scores = [], []
    predictions = predict_photos(photos, estimate.brdf, estimate.strengths)
    for photo, own, predicted in zip(photos, weights, predictions, strict=True):
        left = photo.radiance - predicted
        # Rows of samples and channels.
        jacobian = np.stack(jacobians(photo, parameters, estimate), axis=1).reshape(-1, size)
        weighted = jacobian * own.weight.reshape(-1, 1)
        numbers += weighted.T @ jacobian
        scores.append(_by_sample(weighted, left))
        pull = np.zeros((len(left), turns))
        if photo.lighting in places:
            place = places[photo.lighting]
            base, lobe = _slopes(here[photo.lighting], photo, estimate)
            whole, shared = base + lobe, lobe * np.repeat(photo.field.shares, 3)[:, None]
            mixed[:, place] += weighted.T @ whole
            follow[place] += shared.T @ jacobian
            alone[place, place] += shared.T @ whole
            pull[:, place] = _by_sample(shared, left)
        pulls.append(pull)
    held = follow @ symmetric_pinv(numbers)
    slope = alone - held @ mixed
    each = np.concatenate(pulls) - np.concatenate(scores) @ held.T
    certainty = slope.T @ symmetric_pinv(each.T @ each)
    return PulledSources(certainty @ slope, certainty @ each.sum(axis=0))


def _slopes(lighting: Lighting, photo: PhotoColumns, estimate: Estimate) -> tuple[Floats, Floats]:
    """By how much base and lobe change with turns of sources, per radian, (3 n, 2 sources) each."""
    brdf, strengths = estimate.brdf, estimate.strengths[lighting.name]
    assert brdf.sigma is not None
    step = _OF_WIDTH * brdf.sigma
    thin = photo.field.thinned(_RAYS_OF_SAMPLE)

    def parts(k: int, turn: Floats) -> Floats:
        light = turned_source(lighting, k, turn, strengths)
        base, lobe = reflected(brdf, light.elements, light.strengths, thin, photo.shadows)
        return np.stack([thin.mean_over_rays(part) for part in (brdf.kd * base, brdf.ks * lobe)])

    slopes = [
        (parts(k, step / 2 * way) - parts(k, -step / 2 * way)) / step
        for k, across in enumerate(tangents(lighting.directions))
        for way in across
    ]
    base, lobe = np.stack(slopes, axis=-1).reshape(2, 3 * len(photo.field), -1)
    return base, lobe


def _by_sample(slopes: Floats, left: Floats) -> Floats:
    """Slopes (3 n, q) times residuals (n, 3), added up over the channels of each sample, (n, q)."""
    return np.asarray((slopes * left.reshape(-1, 1)).reshape(len(left), 3, -1).sum(axis=1))
