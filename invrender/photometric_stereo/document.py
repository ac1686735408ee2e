"""result.json of photometric stereo."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from capture.files.documents import numbers, software
from capture.radiance import CHANNELS
from invrender.photometric_stereo.result import StereoResult, odd_photographs
from invrender.photometric_stereo.shading import ASSUMED_MU
from invrender.photometric_stereo.solve import SolvedSurface
from invrender.wording import with_error

KIND = "photometric stereo"


@dataclass(frozen=True)
class SharedQuantity:
    """A number that all pixels share, and its standard deviation."""

    value: float
    std: float

    @property
    def text(self) -> str:
        return with_error(self.value, self.std)


def shared_quantities(solved: SolvedSurface) -> dict[str, SharedQuantity]:
    """What all pixels share, by its name in tables."""
    names = [*solved.reflection.numbers, *(f"Ks {channel}" for channel in CHANNELS)]
    values = [*solved.reflection.numbers.values(), *solved.reflection.ks]
    deviations = np.sqrt(np.diag(solved.covariance))
    found = {
        name: SharedQuantity(float(value), float(std))
        for name, value, std in zip(names, values, deviations, strict=True)
    }
    if solved.stack.bounced is None:
        del found["bounce"]
    if solved.reflection.form is None:
        for channel in CHANNELS:
            del found[f"Ks {channel}"]
    return found


def stereo_document(
    result: StereoResult, errors: Sequence[float], inputs: Mapping[str, str]
) -> dict[str, Any]:
    """The content of result.json; errors : relative RMS of the set's photographs."""
    capture, solved = result.capture, result.solved
    sought, bars = capture.normals is None, solved.deviations.normal_deg
    quantities = shared_quantities(solved)
    form_numbers = [] if solved.reflection.form is None else list(solved.reflection.form.numbers)
    return {
        "format": 1,
        "kind": KIND,
        "name": capture.photoset.name,
        "object": {
            "shape": "normals",
            "pixels": int(capture.inside.sum()),
            "normals": {
                "file": "normals.npz",
                "given": not sought,
                "axes": "x right, y up, z towards the camera",
                "std_deg_median": float(np.median(bars)) if sought else None,
                "std_deg_95": float(np.quantile(bars, 0.95)) if sought else None,
            },
            "camera": {
                "model": capture.camera.model,
                "params": numbers(capture.camera.params),
                "width": capture.camera.width,
                "height": capture.camera.height,
                "world_to_camera": numbers(capture.camera.world_to_camera),
            },
            "depth": capture.depth,
        },
        "brdf": {
            "model": "lambertian" if solved.reflection.form is None else solved.reflection.form.name,
            "albedo": {"file": "albedo.exr", "mean": numbers(np.pi * solved.surface.kd.mean(axis=0))},
            "mu": {
                "value": None,
                "reason": f"assumed {ASSUMED_MU}: lamps near the camera don't show how reflection grows at grazing"
                " angles",
                "remedy": "process a mesh of the object (`lightfactor integrate`) from several sides",
            },
            "ks": _channels(quantities),
            "sigma": _entry(quantities.get("sigma")),
            "form_numbers": {name: _entry(quantities[name]) for name in form_numbers},
            "ambient": _entry(quantities["ambient"]),
            "bounce": _entry(quantities.get("bounce")),
        },
        "models": [
            {"model": model.name, "error_unseen": model.error, "chosen": model is solved.model}
            for model in solved.models
        ],
        "photos": [
            {
                "file": photo.name,
                "lighting": photo.lighting,
                "held_out": photo.held_out,
                "rms_relative": error,
            }
            for photo, error in zip(capture.photoset.photos, errors, strict=True)
        ],
        "warnings": [*capture.warnings, *odd_photographs(capture.photoset.photos, errors)],
        "inputs": dict(inputs),
        "software": software(),
    }


def _entry(quantity: SharedQuantity | None) -> dict[str, float] | None:
    return None if quantity is None else {"value": quantity.value, "std": quantity.std}


def _channels(quantities: Mapping[str, SharedQuantity]) -> dict[str, list[float]] | None:
    """Ks of all channels; None of a Lambertian surface."""
    found = [quantities[f"Ks {channel}"] for channel in CHANNELS if f"Ks {channel}" in quantities]
    return {"value": [of.value for of in found], "std": [of.std for of in found]} if found else None
