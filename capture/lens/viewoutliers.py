"""Views and corners that a calibration can't explain while it explains the others."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from capture.lens.distortion import LADDER
from capture.lens.lensfit import CornerView, LensFit, fit_lens, rms

Floats = NDArray[np.float64]

MIN_VIEWS = 3
# A view is an outlier when its RMS is so many times the median view's, so many robust deviations above it, and not
# small in itself: among the sharpest of views, one that is as good as others' usual ones is still worth having.
VIEW_RATIO = 3.0
VIEW_DEVIATIONS = 6.0
VIEW_PX = 0.2
# A corner is one when its distance from its prediction is so many times the median corner's, and not small in itself.
CORNER_RATIO = 8.0
CORNER_PX = 0.5

# Rich enough for any usual lens, so that what is left over is the view's fault and not the model's.
_LENS = LADDER[-2]
_PLAIN_LENS = LADDER[2]


def outliers(
    views: Sequence[CornerView], size: tuple[int, int]
) -> tuple[dict[int, tuple[float, float]], list[NDArray[np.bool_]]]:
    """Which views don't fit, worst first, and which corners of every view do.

    Returns for each such view, by its place, its RMS and the limit in pixels, and (n,) bool per view. One view is taken
    out at a time and the others are fitted again, down to three views.
    """
    kept = list(range(len(views)))
    good = [np.ones(len(view.points), bool) for view in views]
    found: dict[int, tuple[float, float]] = {}
    while True:
        fit = _fit([_part(views[k], good[k]) for k in kept], size)
        errors = np.array([rms(residual) for residual in fit.residuals])
        worst = int(np.argmax(errors))
        others = np.delete(errors, worst)
        middle = float(np.median(others))
        deviation = 1.4826 * float(np.median(np.abs(others - middle)))
        limit = max(VIEW_RATIO * middle, middle + VIEW_DEVIATIONS * deviation, VIEW_PX)
        bad_corners = _bad_corners(fit)
        if errors[worst] > limit and not _few(bad_corners[worst]):
            if len(kept) <= MIN_VIEWS:
                return found, good
            found[kept.pop(worst)] = (float(errors[worst]), limit)
        elif any(bad.any() for bad in bad_corners):
            for k, bad in zip(kept, bad_corners, strict=True):
                if _few(bad):
                    good[k][np.flatnonzero(good[k])[bad]] = False
            if not any(_few(bad) for bad in bad_corners):
                return found, good
        else:
            return found, good


def _few(bad: NDArray[np.bool_]) -> bool:
    """Whether some corners, but no more than a tenth of the view's, are bad."""
    return bool(0 < bad.sum() <= 0.1 * len(bad))


def _bad_corners(fit: LensFit) -> list[NDArray[np.bool_]]:
    lengths = [np.linalg.norm(residual, axis=1) for residual in fit.residuals]
    limit = max(CORNER_RATIO * float(np.median(np.concatenate(lengths))), CORNER_PX)
    return [length > limit for length in lengths]


def _part(view: CornerView, good: NDArray[np.bool_]) -> CornerView:
    return CornerView(view.board_points[good], view.points[good], view.half[good])


def _fit(views: Sequence[CornerView], size: tuple[int, int]) -> LensFit:
    fit = fit_lens(views, size, _PLAIN_LENS)
    if sum(2 * len(view.points) - 6 for view in views) < 10 * len(_LENS.fitted):
        return fit
    richer = fit_lens(views, size, _LENS, fit)
    return min(fit, richer, key=lambda each: each.rms)
