"""`lighting.json`: everything that inverse lighting found, numbers finite or null."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture.files.documents import numbers, software
from invrender.brdf.microfacet import Microfacet
from invrender.inverse_lighting.coefficients import UNDETERMINED
from invrender.inverse_lighting.estimate import LightingChoices, LightResult
from recon.harmonics.basis import degrees, to_degree

Floats = NDArray[np.float64]

_NINE = 9


def light_document(
    name: str,
    brdf: Microfacet,
    choices: LightingChoices,
    results: Sequence[LightResult],
    files: Sequence[Mapping[str, str]],
    inputs: Mapping[str, str],
    given_by: str,
) -> dict[str, Any]:
    """The result as JSON-ready data.

    files : per lighting, what is drawn -> file in the result folder. given_by : the file that gives the true light.
    """
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
        "rung": choices.transfer,
        "lighting": [
            _lighting(result, named, given_by) for result, named in zip(results, files, strict=True)
        ],
        "inputs": dict(inputs),
        "software": software(),
    }


@dataclass(frozen=True)
class TruthError:
    """Errors of recovered light against the given one.

    nine, dual : largest of the first nine coefficients over the true L_00, of the direct and of the dual method; dual
    is None where there is none. over_std, dual_over_std : RMS of all errors, and of the dual nine, over their
    deviations.
    """

    nine: float
    over_std: float
    dual: float | None
    dual_over_std: float | None


def truth_error(result: LightResult) -> TruthError | None:
    """How far a result is off; None where its light isn't given."""
    if result.truth is None:
        return None
    true, direct = result.truth.coefficients, result.direct
    off = direct.values - to_degree(true, direct.degree)
    nine, dual, dual_over_std = np.abs(off[:_NINE] / true[0]).max(), None, None
    if result.dual is not None:
        off_dual = result.dual.nine - true[:_NINE]
        dual = float(np.abs(off_dual / true[0]).max())
        dual_over_std = float(np.sqrt(np.mean((off_dual / result.dual.nine_std) ** 2)))
    return TruthError(float(nine), float(np.sqrt(np.mean((off / direct.std) ** 2))), dual, dual_over_std)


def degree_errors(result: LightResult) -> Floats | None:
    """Per degree (degree + 1, 3): RMS true coefficient, RMS error, the same over deviations; None if not given."""
    if result.truth is None:
        return None
    direct = result.direct
    true = to_degree(result.truth.coefficients, direct.degree)
    off, l = direct.values - true, degrees(direct.degree)
    squares = np.stack([each**2 for each in (true, off, off / direct.std)], axis=-1).mean(axis=1)
    return np.sqrt(np.stack([squares[l == degree].mean(axis=0) for degree in range(direct.degree + 1)]))


def _lighting(result: LightResult, files: Mapping[str, str], given_by: str) -> dict[str, Any]:
    direct, dual = result.direct, result.dual
    against = truth_error(result)
    return {
        "name": result.name,
        "degree": direct.degree,
        "sh": {
            # A coefficient of which the samples say no more than was known before has no value.
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
        else {
            "given_by": given_by,
            "first_nine_error": against.nine,
            "rms_error_over_std": against.over_std,
            "dual_first_nine_error": against.dual,
            "dual_rms_error_over_std": against.dual_over_std,
        },
        "warnings": list(result.warnings),
        "files": dict(files),
    }
