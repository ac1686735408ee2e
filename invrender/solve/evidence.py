"""Evidence: the simplest model whose error on photographs it has not seen is no worse than the best's."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture.parallel import parallel_map
from invrender.model.columns import PhotoColumns
from invrender.model.predict import predict_columns
from invrender.solve.search import LADDER, Estimate, Model, fit
from invrender.solve.statistics import Statistics, by_lighting, photo_statistics

Floats = NDArray[np.float64]

# Up to this many photographs each is left out on its own; more are left out in this many groups.
MAX_FOLDS = 20


@dataclass(frozen=True, eq=False)
class Rung:
    """One model of the ladder with its evidence.

    estimate : fitted to all photographs. photo_errors : (photos,), relative RMS of each photograph as
        predicted by a fit that has not seen it (strengths of a lighting that no other photograph has
        are fitted to it, since nothing else could tell them).
    parameters : count of fitted numbers.
    """

    estimate: Estimate
    photo_errors: Floats
    parameters: int

    @property
    def error(self) -> float:
        """Mean over photographs of the cross-validated relative RMS."""
        return float(self.photo_errors.mean())

    @property
    def standard_error(self) -> float:
        """Standard error of that mean."""
        return float(self.photo_errors.std(ddof=1) / np.sqrt(len(self.photo_errors)))


def relative_rms(residual: Floats, radiance: Floats) -> float:
    """Root mean square of the residual over that of the radiance, all channels together."""
    return float(np.sqrt((residual**2).sum() / max((radiance**2).sum(), 1e-300)))


def climb_ladder(
    photos: Sequence[PhotoColumns],
    weights: Sequence[Floats],
    on_step: Callable[[], None] = lambda: None,
) -> tuple[tuple[Rung, ...], int]:
    """Fit and cross-validate every model; returns the rungs and the index of the chosen one.

    `on_step` is called after each fold of each model, `ladder_steps(len(photos))` times in all.
    """
    folds = min(len(photos), MAX_FOLDS)
    fold_of = np.arange(len(photos)) % folds
    # Kept per fold and lighting, not per photograph: memory then doesn't grow with the set.
    parts: list[list[Statistics]] = [[] for _ in range(folds)]
    pairs = zip(photos, weights, strict=True)
    for fold, entry in zip(fold_of, parallel_map(lambda pair: photo_statistics(*pair), pairs), strict=True):
        parts[fold] = list(by_lighting([*parts[fold], entry]))
    rungs = tuple(_evaluate(model, photos, weights, parts, fold_of, on_step) for model in LADDER)
    best = min(rungs, key=lambda rung: rung.error)
    limit = best.error + best.standard_error
    return rungs, next(k for k, rung in enumerate(rungs) if rung.error <= limit)


def ladder_steps(photos: int) -> int:
    """How often `climb_ladder` reports progress."""
    return len(LADDER) * min(photos, MAX_FOLDS)


def _evaluate(
    model: Model,
    photos: Sequence[PhotoColumns],
    weights: Sequence[Floats],
    parts: Sequence[Sequence[Statistics]],
    fold_of: NDArray[np.int64],
    on_step: Callable[[], None],
) -> Rung:
    full = fit(model, by_lighting(entry for part in parts for entry in part))
    errors = np.empty(len(photos))
    for fold in range(len(parts)):
        rest = by_lighting(entry for k, part in enumerate(parts) if k != fold for entry in part)
        trained = fit(model, rest, start=full)
        for j in np.flatnonzero(fold_of == fold).tolist():
            photo = photos[j]
            strengths = trained.strengths.get(photo.lighting)
            if strengths is None:
                strengths = fit_strengths(photo, weights[j], trained)
            residual = photo.radiance - predict_columns(photo, trained.brdf, strengths)
            errors[j] = relative_rms(residual, photo.radiance)
        on_step()
    free = sum(3 for light in full.strengths.values() for _ in light) if _has_free(photos) else 0
    count = 3 + 3 * model.specular + model.specular + model.fresnel + free
    return Rung(full, errors, count)


def _has_free(photos: Sequence[PhotoColumns]) -> bool:
    return any(name != "known" for photo in photos for name in photo.elements)


def fit_strengths(photo: PhotoColumns, weight: Floats, estimate: Estimate) -> Floats:
    """Strengths (elements, 3) of a photograph's lighting that fit it best with the BRDF held fixed."""
    unit = np.eye(len(photo.elements))
    strengths = np.ones((len(photo.elements), 3))
    free = np.array([name != "known" for name in photo.elements])
    if not free.any():
        return strengths
    shading = np.stack([predict_columns(photo, estimate.brdf, np.repeat(row[:, None], 3, 1)) for row in unit])
    for c in range(3):
        root = np.sqrt(weight[:, c])
        target = (photo.radiance[:, c] - shading[~free, :, c].sum(axis=0)) * root
        strengths[free, c] = np.linalg.lstsq((shading[free, :, c] * root).T, target, rcond=None)[0]
    return strengths
