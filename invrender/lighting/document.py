"""`lighting.json`: everything that inverse lighting found, numbers finite or null."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture.files.documents import numbers, software
from invrender.lighting.coefficients import UNDETERMINED
from invrender.lighting.estimate import Choices, LightResult
from invrender.lighting.maps import TrueLight
from invrender.model.microfacet import Microfacet
from recon.harmonics import to_degree

Floats = NDArray[np.float64]

_NINE = 9


def light_document(
    name: str,
    brdf: Microfacet,
    choices: Choices,
    results: Sequence[LightResult],
    files: Sequence[Mapping[str, str]],
    inputs: Mapping[str, str],
) -> dict[str, Any]:
    """The result as JSON-ready data. files : per lighting, what is drawn -> file in the result folder."""
    return {
        "format": 1,
        "name": name,
        "brdf": {
            "model": brdf.form.name,
            "kd": brdf.kd.tolist(),
            "ks": brdf.ks.tolist(),
            "mu": brdf.mu,
            "sigma": brdf.sigma,
        },
        "rung": choices.rung,
        "lighting": [_lighting(result, named) for result, named in zip(results, files, strict=True)],
        "inputs": dict(inputs),
        "software": software(),
    }


def truth_error(result: LightResult) -> tuple[float, float] | None:
    """Largest error of the first nine coefficients over the true L_00, and RMS of all errors over their deviations."""
    if result.truth is None:
        return None
    off = result.direct.values - _true_coefficients(result.truth, result.direct.degree)
    nine = np.abs(off[:_NINE] / result.truth.coefficients[0]).max()
    return float(nine), float(np.sqrt(np.mean((off / result.direct.std) ** 2)))


def _true_coefficients(truth: TrueLight, degree: int) -> Floats:
    return to_degree(truth.coefficients, degree)


def _lighting(result: LightResult, files: Mapping[str, str]) -> dict[str, Any]:
    direct, dual = result.direct, result.dual
    against = truth_error(result)
    return {
        "name": result.name,
        "degree": direct.degree,
        "sh": {
            # A coefficient that the samples tell no more of than was known before has no value.
            "value": numbers(np.where(direct.shares >= UNDETERMINED, direct.values, np.nan)),
            "std": direct.std.tolist(),
            "prior_std": direct.prior_std.tolist(),
        },
        "degrees": [
            {"degree": l, "share_determined": float(share), "status": status}
            for l, (share, status) in enumerate(zip(direct.share_per_degree, result.statuses, strict=True))
        ],
        "rank": direct.rank.tolist(),
        "dual": None
        if dual is None
        else {
            "sh": {"value": dual.nine.tolist(), "std": dual.nine_std.tolist()},
            "coverage": dual.coverage,
        },
        "fit": {
            "samples": result.samples,
            "rms_relative": result.rms,
            "structured_rms_relative": direct.structured,
            "noise": {"floor": direct.noise.floor, "relative": direct.noise.relative},
        },
        "photos": [
            {"file": label, "held_out": held_out, "rms_relative": rms}
            for held_out, scores in ((False, result.photos), (True, result.held_out))
            for label, rms in scores
        ],
        "truth": None
        if against is None
        else {"first_nine_error": against[0], "rms_error_over_std": against[1]},
        "warnings": list(result.warnings),
        "files": dict(files),
    }
