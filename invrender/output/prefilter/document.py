"""prefilter.json: orders, coefficients, and how far the maps can be off."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from capture.files.documents import input_hashes, numbers, software
from invrender.output.prefilter.brdfs import ChosenBrdf
from invrender.prefilter.bounds import ErrorBound
from invrender.prefilter.prefiltered import PrefilteredLight, PrefilteredLobe


def prefilter_document(
    source: Path,
    chosen: ChosenBrdf,
    found: PrefilteredLight,
    epsilon: float | None,
    views: Sequence[tuple[float, float]],
    files: Mapping[str, Mapping[str, Any]],
    warnings: Sequence[str],
) -> dict[str, Any]:
    """What is written; epsilon None where orders were given. files : of each lobe, by what they hold."""
    cos = found.bound.cos_angles
    return {
        "format": 1,
        "name": source.name,
        "brdf": found.brdf.description,
        "axis": found.brdf.axis,
        "epsilon": epsilon,
        "lighting": numbers(found.lighting),
        "lobes": [_of_lobe(each, files[each.lobe.name]) for each in found.lobes],
        "angles_deg": numbers(np.degrees(np.arccos(cos))),
        "albedo": numbers(found.albedo),
        "error": _of_bound(found.bound),
        "views": [{"azimuth_deg": azimuth, "elevation_deg": elevation} for azimuth, elevation in views],
        "warnings": list(warnings),
        "inputs": input_hashes([source, *chosen.inputs]),
        "software": software(),
    }


def _of_lobe(each: PrefilteredLobe, files: Mapping[str, Any]) -> dict[str, Any]:
    factor = each.lobe.view_factor
    return {
        "name": each.lobe.name,
        "centre": "mirrored view" if each.lobe.mirrored else "axis",
        "strength": numbers(each.lobe.strength),
        "f": each.orders[0],
        "p": each.orders[1],
        "rows": each.local.maps.shape[2],
        "energy_left_out": each.left_out,
        "between_pixels": each.between_pixels,
        "rho": numbers(each.rho),
        "view_factor": None
        if factor is None
        else {"cos": numbers(factor.cos), "value": numbers(factor.values)},
        "error": _of_bound(each.bound),
        "files": dict(files),
    }


def _of_bound(bound: ErrorBound) -> dict[str, Any]:
    return {
        "rms": numbers(bound.rms),
        "largest": numbers(bound.largest),
        "reflected": numbers(bound.reflected),
        "picture": {
            "rms": numbers(bound.picture_rms),
            "largest_rms": numbers(bound.picture_largest),
            "reflected": numbers(bound.picture_reflected),
        },
    }
