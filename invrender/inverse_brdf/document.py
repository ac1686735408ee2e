"""brdf.json: a measured BRDF with its errors, and what the measurement could determine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture.files.documents import software
from invrender.inverse_brdf.brushed_harmonics import BrushedBasis
from invrender.inverse_brdf.harmonic import HarmonicBRDF
from invrender.inverse_brdf.measured import MeasuredFit
from invrender.inverse_brdf.near import Measured
from invrender.inverse_brdf.reciprocal import unknowns
from invrender.inverse_brdf.slices import Ringing
from invrender.result.document import model_entries, quantity_entry
from recon.harmonics.basis import degrees, orders

Floats = NDArray[np.float64]

_PER_CHANNEL = ("kd", "ks", "albedo", "kd_normalised", "ks_normalised")


def harmonic_document(brdf: HarmonicBRDF, rings: Ringing) -> dict[str, Any]:
    """Coefficients rho_lpq of rho cos theta_i cos theta_o, l <= p, per channel.

    Each has value and std, three numbers, null in channels where it isn't determined, with the reason. conditioning :
    lighting_gain, per degree and channel, by which lighting passes the BRDF's degree on; singular_values per channel,
    in units of noise and of the bounds of energy; effective_rank, how many coefficients the samples determine.
    """
    names = [{"l": int(l), "p": int(p), "q": int(q)} for l, p, q in zip(*unknowns(brdf.order), strict=True)]
    rung = {"negative_share": rings.negative_share, "negative_depth": rings.depth}
    return _coefficients(brdf, names) | rung


def brushed_document(brdf: HarmonicBRDF, basis: BrushedBasis) -> dict[str, Any]:
    """As `harmonic_document` of an isotropic BRDF, of rho_lnpq, (l, n) before (p, q), without ringing.

    brushed_about : the axis of the tangents.
    """
    l, n = degrees(basis.order).tolist(), orders(basis.order).tolist()
    names = [{"l": l[i], "n": n[i], "p": l[j], "q": n[j]} for i, j in zip(*basis.pairs, strict=True)]
    return _coefficients(brdf, names) | {"brushed_about": list(basis.axis)}


def _coefficients(brdf: HarmonicBRDF, names: Sequence[dict[str, int]]) -> dict[str, Any]:
    coefficients: list[dict[str, Any]] = []
    for index, name in enumerate(names):
        known = brdf.determined[index]
        entry = name | {
            "value": _numbers(brdf.coefficients[index], known),
            "std": _numbers(brdf.std[index], known),
        }
        coefficients.append(entry if known.all() else entry | {"reason": brdf.reasons[index]})
    return {
        "method": "harmonic",
        "order": brdf.order,
        "coefficients": coefficients,
        "conditioning": {
            "lighting_gain": brdf.gains.tolist(),
            "singular_values": brdf.singular_values.tolist(),
            "effective_rank": brdf.rank.tolist(),
        },
        "relative_rms": brdf.residual,
    }


def table_document(found: Measured) -> dict[str, Any]:
    """The BRDF per bin of half and difference angles, 1/sr, and RH01's parameters fitted to it.

    values, std : (n_h, n_d, n_p, 3), null where a bin holds nothing. counts : samples; 0 with a value where it was
    taken from the bin in which light and viewer are exchanged. Bins start at theta_h = pi/2 (i / n_h)^2, theta_d =
    pi/2 j / n_d, phi_d = pi k / n_p. coverage : shares of the bins in whose centre light and viewer are above the
    surface. source_distance_m : of the source from the object's centre, null where it counts as far.
    """
    table, fit = found.table, found.fit
    filled = np.broadcast_to(table.filled[..., None], table.values.shape)
    return {
        "method": "table",
        "bins": list(table.counts.shape),
        "values": _nested(table.values, filled),
        "std": _nested(table.std, filled),
        "counts": table.counts.tolist(),
        "coverage": {
            "measured": table.coverage(table.measured),
            "with_reciprocity": table.coverage(table.filled),
        },
        "fit": {
            name: {"value": fit.parameters[part].tolist(), "std": fit.std[part].tolist()}
            for name, part in FIT_PARTS.items()
        }
        | {"relative_rms": fit.misfit, "chi2": fit.chi2},
        "source_distance_m": None
        if found.distance is None
        else dict(zip(("value", "std"), found.distance, strict=True)),
    }


def measured_document(fit: MeasuredFit) -> dict[str, Any]:
    """The lobe that explains a BRDF which others measured, and the evidence for it.

    brdf : `model`, and each of its numbers with value, std, status. fit : means over angles of incidence of the errors
    of the fit and of one without that angle. incidence : the same per angle.
    reflection_map_orders : per lobe F and P, null of one too narrow. models : the ladder.
    """
    solution, form = fit.solution, fit.model.estimate.model
    return {
        "method": "measured",
        "samples": len(fit.samples),
        "brdf": {
            "model": form.form.name if form.specular else "lambertian",
            "specular": None if not form.specular else "neutral" if form.neutral else "coloured",
            **{
                name: quantity_entry(quantity, scalar=name not in _PER_CHANNEL)
                for name, quantity in solution.quantities.items()
            },
        },
        "fit": {
            "rms_relative": float(fit.errors.mean()),
            "cross_validated_rms_relative": float(fit.unseen_errors.mean()),
            "noise": {"floor": solution.noise.floor, "relative": solution.noise.relative},
        },
        "incidence": [
            {
                "angle_deg": fit.incidence_deg(group),
                "samples": len(group),
                "rms_relative": float(error),
                "cross_validated_rms_relative": float(unseen),
            }
            for group, error, unseen in zip(fit.groups, fit.errors, fit.unseen_errors, strict=True)
        ],
        "reflection_map_orders": {
            name: None if orders is None else dict(zip(("F", "P"), orders, strict=True))
            for name, orders in fit.orders.items()
        },
        "models": model_entries(solution.candidates, solution.chosen),
    }


# Where each parameter stands in a fit's covariance.
FIT_PARTS = {"kd": slice(0, 3), "ks": slice(3, 6), "mu": slice(6, 7), "sigma": slice(7, 8)}


def document(
    name: str,
    measured: Mapping[str, Any],
    photos: Sequence[Mapping[str, Any]],
    warnings: Sequence[str],
    inputs: Mapping[str, str],
) -> dict[str, Any]:
    """The whole of brdf.json. photos : file, samples, held_out and relative RMS residual of each."""
    return {
        "format": 1,
        "name": name,
        **measured,
        "photos": list(photos),
        "warnings": list(warnings),
        "inputs": dict(inputs),
        "software": software(),
    }


def _numbers(values: Floats, known: NDArray[np.bool_]) -> list[float | None]:
    return [float(value) if is_known else None for value, is_known in zip(values, known, strict=True)]


def _nested(values: Floats, known: NDArray[np.bool_]) -> Any:
    """Nested lists, null where not known; numbers to six digits, which is more than any was measured to."""
    result = np.full(values.shape, None, object)
    result[known] = [float(f"{value:.6g}") for value in values[known]]
    return result.tolist()
