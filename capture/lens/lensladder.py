"""Which lens model a set of views supports: the simplest that predicts views it hasn't seen as well as any."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture.lens.distortion import LADDER, LensModel, folds_at, picture_grid
from capture.lens.lensfit import CornerView, LensFit, fit_lens, held_out_residuals, lens_information
from capture.selection import excess, simplest

Floats = NDArray[np.float64]

# Every view is left out once; beyond this many views, several at a time.
_MAX_FOLDS = 10
# Coordinates of corners, less those that the poses use up, per fitted parameter.
_MIN_EVIDENCE = 5
# Beyond this, parameters trade against each other within rounding: numerator against denominator of the full model.
_MAX_CONDITION = 1e8
# Share of the squared error, and distance in pixels, below which one model predicts as well as another in practice.
_NEGLIGIBLE = 0.01
_NEGLIGIBLE_PX = 1e-3
# A sound model whose held-out error is so many times that of one that folds has not found the lens.
_FOLDING_RATIO = 1.5


@dataclass(frozen=True, eq=False)
class LensCandidate:
    """One lens model of the ladder.

    fit : to all views; None if it wasn't made. squares : (v,) each view's mean squared held-out distance, px^2.
    fault : why the model can't be used, in words; None if it can.
    """

    lens: LensModel
    fit: LensFit | None
    squares: Floats | None
    fault: str | None = None
    chosen: bool = False

    @property
    def held_out_rms(self) -> float | None:
        """Root mean square over views, pixels."""
        return None if self.squares is None else float(np.sqrt(self.squares.mean()))

    @property
    def negligible(self) -> float:
        """By how much a squared held-out error may be above this one's and still be as good in practice, px^2."""
        return max(_NEGLIGIBLE * (self.held_out_rms or 0.0) ** 2, _NEGLIGIBLE_PX**2)

    def excess(self, best: LensCandidate) -> tuple[float, float]:
        """Mean over views by how much the squared error is above the best candidate's, and its standard error."""
        assert self.squares is not None
        assert best.squares is not None
        return excess(self.squares, best.squares)


def climb(views: Sequence[CornerView], size: tuple[int, int]) -> tuple[LensCandidate, ...]:
    """All candidates fitted, scored on left-out views, and one of them chosen (none where none can be used).

    Chosen is the simplest model whose squared held-out error lies within one standard error (or 1 %) of the best one's,
    taken over the views' paired differences: that some photographs are sharper than others then plays no part.
    """
    candidates: list[LensCandidate] = []
    for lens in LADDER:
        below = next((candidate.fit for candidate in reversed(candidates) if candidate.fit is not None), None)
        candidates.append(_candidate(views, size, lens, below))
    usable = [candidate for candidate in candidates if candidate.fault is None]
    if not usable or _only_folding_fits(candidates, usable):
        return tuple(candidates)
    best = best_candidate(candidates)
    squares = [candidate.squares for candidate in usable if candidate.squares is not None]
    parameters = [len(candidate.lens.fitted) for candidate in usable]
    candidate = usable[simplest(squares, parameters, best.negligible)]
    return tuple(
        LensCandidate(each.lens, each.fit, each.squares, each.fault, chosen=each is candidate)
        for each in candidates
    )


def best_candidate(candidates: Sequence[LensCandidate]) -> LensCandidate:
    """The usable candidate with the least held-out error, chosen or not."""
    return min(
        (candidate for candidate in candidates if candidate.fault is None),
        key=lambda candidate: candidate.held_out_rms or 0.0,
    )


def best_fit(
    views: Sequence[CornerView], size: tuple[int, int], lens: LensModel, below: LensFit | None = None
) -> LensFit:
    """The better of the fits from Zhang's closed form and from a simpler lens, which may end in different valleys."""
    fits, faults = [], []
    for start in (None, below) if below is not None else (None,):
        try:
            fits.append(fit_lens(views, size, lens, start))
        except ValueError as error:
            faults.append(error)
    if not fits:
        raise faults[0]
    return min(fits, key=lambda fit: fit.rms)


def _only_folding_fits(candidates: Sequence[LensCandidate], usable: Sequence[LensCandidate]) -> bool:
    """Whether a model that folds in the picture predicts far better than any that doesn't."""
    least = min(candidate.held_out_rms for candidate in candidates if candidate.held_out_rms is not None)
    return min(candidate.held_out_rms or 0.0 for candidate in usable) > _FOLDING_RATIO * least


def _candidate(
    views: Sequence[CornerView], size: tuple[int, int], lens: LensModel, below: LensFit | None
) -> LensCandidate:
    evidence = sum(2 * len(view.points) - 6 for view in views)
    if evidence < _MIN_EVIDENCE * len(lens.fitted):
        return LensCandidate(lens, None, None, "too few corners for it")
    try:
        fit = best_fit(views, size, lens, below)
        if lens_information(views, fit).condition > _MAX_CONDITION:
            return LensCandidate(lens, fit, None, "parameters can't be determined")
        squares = _held_out_squares(views, fit)
    except ValueError as error:
        return LensCandidate(lens, None, None, str(error))
    folded = folds_at(fit.camera, picture_grid(size))
    if folded.any():
        return LensCandidate(lens, fit, squares, f"folds over {folded.mean():.0%} of the picture")
    return LensCandidate(lens, fit, squares)


def _held_out_squares(views: Sequence[CornerView], fit: LensFit) -> Floats:
    import cv2

    count = min(len(views), _MAX_FOLDS)
    squares = np.empty(len(views))
    for fold in range(count):
        out = set(range(fold, len(views), count))
        others = fit_lens([view for k, view in enumerate(views) if k not in out], fit.size, fit.lens, fit)
        for k in out:
            try:
                residuals = held_out_residuals(views[k], fit.lens, others.params, fit.poses[k])
            except cv2.error as error:
                raise ValueError(
                    f"no pose can be solved for a view that was left out ({error.err})"
                ) from error
            squares[k] = (residuals**2).sum(axis=1).mean()
    if not np.isfinite(squares).all():
        raise ValueError("its predictions of views that were left out are not finite")
    return squares
