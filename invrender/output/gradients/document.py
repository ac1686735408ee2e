"""gradients.json: per photograph how strong each term is, and where light counts as near."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture.files.documents import input_hashes, software
from invrender.gradients.predicted import FAR
from invrender.output.gradients.photograph import PhotoGradients

Floats = NDArray[np.float64]

# As they are drawn and listed; the last is what they leave.
TERMS = ("spatial", "curvature", "perspective", "texture", "visibility", "remainder")


def gradients_document(
    result: Path, photos: Sequence[dict[str, Any]], warnings: Sequence[str], inputs: Iterable[Path]
) -> dict[str, Any]:
    """What is written. photos : `photo_entry` of each."""
    return {
        "format": 1,
        "name": result.parent.resolve().name,
        "far_below": FAR,
        "photos": list(photos),
        "warnings": list(warnings),
        "inputs": input_hashes(inputs),
        "software": software(),
    }


def photo_entry(file: str, lighting: str, found: PhotoGradients, files: Sequence[str]) -> dict[str, Any]:
    """What gradients.json says of a photograph."""
    whole, radiance = _rms(found.difference), float(np.sqrt((found.terms.radiance**2).mean()))
    return {
        "file": file,
        "lighting": lighting,
        "pixels": len(found.rows),
        "first_pixel": list(found.first),
        "stride": found.stride,
        "rms_radiance": radiance,
        "rms_gradient": whole,
        "terms": {
            name: {"rms": _rms(values), "share": share_of(values, found.difference)}
            for name, values in named_terms(found).items()
        },
        "near": _near(found),
        "files": list(files),
    }


def named_terms(found: PhotoGradients) -> dict[str, Floats]:
    """The terms of a photograph by name, (n, 2, 3) each, and the remainder."""
    values = {name: getattr(found.terms, name) for name in TERMS[:-1]}
    return {**values, TERMS[-1]: found.remainder}


def share_of(term: Floats, whole: Floats) -> float | None:
    """How much of the whole a term makes, by projection: the shares of all terms and of the remainder add up to 1."""
    power = float((whole**2).sum())
    return float((term * whole).sum()) / power if power > 0 else None


def near_below(curvature: Floats) -> Floats:
    """Distances (n,), metres, below which a lamp counts as near, by the curvature (n,); infinite on a plane."""
    bend = 2 * FAR * curvature
    return np.divide(1, bend, out=np.full(len(bend), np.inf), where=bend > 0)


def _near(found: PhotoGradients) -> dict[str, Any]:
    lit = found.nearness > 0
    # The strongest curvature makes the least distance.
    distances = near_below(np.percentile(found.curvature, (95, 50, 5)))
    return {
        "share": float((found.nearness >= FAR).mean()),
        "median_ratio": _finite(np.median(found.nearness[lit])) if lit.any() else None,
        "near_below_m": dict(zip(("low", "median", "high"), map(_finite, distances), strict=True)),
    }


def _finite(value: np.floating) -> float | None:
    return float(value) if np.isfinite(value) else None


def _rms(values: Floats) -> float:
    """Of a gradient's length (n, 2, 3), over pixels and channels."""
    return float(np.sqrt((values**2).sum(axis=1).mean()))
