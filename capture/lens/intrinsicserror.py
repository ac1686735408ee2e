"""How uncertain a calibrated lens is: scatter of the corners, and what a choice of method moves.

Errors of the corners of one view are alike (blur, light and a bent board act on all of them), so that their number
overstates what they tell. How much is read off the jackknife over views.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from capture.boards.board import Detection
from capture.lens.distortion import PARAM_NAMES, LensModel
from capture.lens.lensfit import LensFit, View, fit_lens, full_covariance, lens_information, view_of

Floats = NDArray[np.float64]


def statistical_covariance(views: Sequence[View], fit: LensFit) -> Floats:
    """Covariance (p, p) of a lens's parameters by the scatter of its residuals.

    That of independent corners, times the mean over the parameters by which the jackknife over views (Efron 1982)
    exceeds it, at least 1. One factor for all of them, since a dozen views tell each parameter's own only roughly.
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


def model_shift(fit: LensFit, other: LensFit) -> Floats:
    """How focal length and principal point differ, (1, p), in a lens model that fits as well.

    Coefficients of distortion mean different things in different models; their entries are zero.
    """
    here, there = _common(fit.lens, fit.params), _common(other.lens, other.params)
    names = PARAM_NAMES[fit.lens.model]
    return np.array([[there[name] - here[name] if name in here else 0.0 for name in names]])


def _common(lens: LensModel, params: Floats) -> dict[str, float]:
    values = dict(zip(PARAM_NAMES[lens.model], map(float, params), strict=True))
    if "f" in values:
        values |= {"fx": values["f"], "fy": values["f"]}
    values["f"] = (values["fx"] + values["fy"]) / 2
    return {name: values[name] for name in ("f", "fx", "fy", "cx", "cy")}
