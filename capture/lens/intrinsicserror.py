"""How uncertain a calibrated lens is: scatter of the corners, and what a choice of method moves.

Errors of the corners of one view are alike (blur, light and a bent board act on all of them), so that their number
overstates what they determine. How much is read off the jackknife over views.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from capture.boards.board import Detection
from capture.lens.distortion import PARAM_NAMES, LensModel
from capture.lens.lensfit import CornerView, LensFit, fit_lens, full_covariance, lens_information, view_of
from capture.lens.lensladder import LensCandidate

Floats = NDArray[np.float64]

# Share of the squared held-out error by which a rival may differ.
_COMPARABLE = 0.1


def statistical_covariance(views: Sequence[CornerView], fit: LensFit) -> Floats:
    """Covariance (p, p) of a lens's parameters by the scatter of its residuals.

    That of independent corners, times the mean over the parameters by which the jackknife over views (Efron 1982)
    exceeds it, at least 1. One factor for all of them, since a dozen views determine each parameter's own only roughly.
    """
    information = lens_information(views, fit)
    independent = information.independent_covariance
    shifts = information.jackknife_shifts
    about = shifts - shifts.mean(axis=0)
    jackknife = (len(views) - 1) / len(views) * about.T @ about
    excess = np.trace(information.matrices.sum(axis=0) @ jackknife) / len(independent) / information.noise
    return full_covariance(fit.lens, max(1.0, float(excess)) * independent)


def window_shifts(detections: Sequence[Detection], fit: LensFit) -> Floats:
    """How the parameters move, (k, p), with corners measured in the other windows."""
    shifts = []
    for k in range(min(len(detection.other_points) for detection in detections)):
        views = [view_of(detection, detection.other_points[k]) for detection in detections]
        shifts.append(fit_lens(views, fit.size, fit.lens, fit).params - fit.params)
    return np.array(shifts).reshape(-1, len(fit.params))


def shift_covariance(shifts: Floats) -> Floats:
    """Covariance (p, p) of a bias of which (k, p) shifts are draws about zero."""
    return np.asarray(shifts.T @ shifts / max(len(shifts), 1))


def model_covariance(candidates: Sequence[LensCandidate], chosen: LensCandidate) -> Floats:
    """Covariance (p, p) of what the choice of the lens model does to the chosen one's parameters.

    Every parameter's deviation is the largest shift to a rival: a usable model whose held-out error lies within two
    standard errors and a tenth (or within 1 %) of the chosen one's, and OPENCV whenever it is the richer one, since a
    principal point hardly differs from a decentred lens and leaving its coefficients out is no evidence that they
    are zero.
    """
    assert chosen.fit is not None
    usable = [candidate for candidate in candidates if candidate.fault is None and candidate is not chosen]
    shifts = [
        _model_shift(chosen.fit, candidate.fit)
        for candidate in usable
        if candidate.fit is not None
        and (_within_two_errors(candidate, chosen) or _adds_decentring(candidate, chosen))
    ]
    if not shifts:
        return np.zeros((len(chosen.fit.params),) * 2)
    outer = np.array(shifts).T @ np.array(shifts)
    # Rivals agree on how parameters go together; the sum over them is brought down to the largest.
    down = np.abs(shifts).max(axis=0) / np.maximum(np.sqrt(np.diag(outer)), 1e-300)
    return np.asarray(outer * np.outer(down, down))


def _within_two_errors(candidate: LensCandidate, chosen: LensCandidate) -> bool:
    mean, error = candidate.excess(chosen)
    # A few views on which a model fails make the standard error large: that is failure, not doubt.
    comparable = _COMPARABLE * (chosen.held_out_rms or 0.0) ** 2
    return abs(mean) <= max(min(2 * error, comparable), chosen.negligible)


def _adds_decentring(candidate: LensCandidate, chosen: LensCandidate) -> bool:
    return candidate.lens.model == "OPENCV" and "p1" not in chosen.lens.free


def _model_shift(fit: LensFit, other: LensFit) -> Floats:
    """How the parameters differ, (p,), in another lens model.

    Coefficients of distortion mean different things where the other one has more of them; their entries are then zero.
    """
    here, there = _common(fit.lens, fit.params), _common(other.lens, other.params)
    names = PARAM_NAMES[fit.lens.model]
    pinhole = ("f", "fx", "fy", "cx", "cy")
    nested = set(other.lens.free) <= set(fit.lens.free)
    return np.array([there[name] - here[name] if name in pinhole or nested else 0.0 for name in names])


def _common(lens: LensModel, params: Floats) -> dict[str, float]:
    values = dict(zip(PARAM_NAMES[lens.model], map(float, params), strict=True))
    if "f" in values:
        values |= {"fx": values["f"], "fy": values["f"]}
    values["f"] = (values["fx"] + values["fy"]) / 2
    return dict.fromkeys(PARAM_NAMES["FULL_OPENCV"], 0.0) | values
