"""Photographs of a real object in; its reflectance, the light on it, and how certain each number is, out.

    import lightfactor as lf

    fit = lf.process("SET")
    fit.brdf.kd.value, fit.brdf.kd.std

docs/python.md describes what can be imported from here; everything else is internal and may change.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from capture.arc.gantrycalibration import calibrate_gantry
    from capture.bracket.hdrfiles import merge_hdr
    from capture.bracket.responserecovery import recover_response as calibrate_response
    from capture.chart.colorrecovery import recover_color as calibrate_color
    from capture.lens.intrinsics import calibrate_camera
    from capture.sensor.flatrecovery import recover_flat_field as calibrate_flatfield
    from capture.sensor.noiserecovery import recover_noise as calibrate_noise
    from lightfactor.actions import compare, export, export_page, plan, save_picture, synth
    from lightfactor.fit import Fit
    from lightfactor.measured import MeasuredBrdf, fit_brdf
    from lightfactor.runs import load_photoset, photometric_stereo, process, read_fit

# Loaded at first use, so that importing one part does not wait for all libraries.
_HOME = {
    "Fit": ("lightfactor.fit", "Fit"),
    "MeasuredBrdf": ("lightfactor.measured", "MeasuredBrdf"),
    "calibrate_camera": ("capture.lens.intrinsics", "calibrate_camera"),
    "calibrate_color": ("capture.chart.colorrecovery", "recover_color"),
    "calibrate_flatfield": ("capture.sensor.flatrecovery", "recover_flat_field"),
    "calibrate_gantry": ("capture.arc.gantrycalibration", "calibrate_gantry"),
    "calibrate_noise": ("capture.sensor.noiserecovery", "recover_noise"),
    "calibrate_response": ("capture.bracket.responserecovery", "recover_response"),
    "compare": ("lightfactor.actions", "compare"),
    "export": ("lightfactor.actions", "export"),
    "export_page": ("lightfactor.actions", "export_page"),
    "fit_brdf": ("lightfactor.measured", "fit_brdf"),
    "load_photoset": ("lightfactor.runs", "load_photoset"),
    "merge_hdr": ("capture.bracket.hdrfiles", "merge_hdr"),
    "photometric_stereo": ("lightfactor.runs", "photometric_stereo"),
    "plan": ("lightfactor.actions", "plan"),
    "process": ("lightfactor.runs", "process"),
    "read_fit": ("lightfactor.runs", "read_fit"),
    "save_picture": ("lightfactor.actions", "save_picture"),
    "synth": ("lightfactor.actions", "synth"),
}
__all__ = [
    "Fit",
    "MeasuredBrdf",
    "calibrate_camera",
    "calibrate_color",
    "calibrate_flatfield",
    "calibrate_gantry",
    "calibrate_noise",
    "calibrate_response",
    "compare",
    "export",
    "export_page",
    "fit_brdf",
    "load_photoset",
    "merge_hdr",
    "photometric_stereo",
    "plan",
    "process",
    "read_fit",
    "save_picture",
    "synth",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, attribute = _HOME[name]
    return getattr(importlib.import_module(module), attribute)


def __dir__() -> list[str]:
    return sorted(__all__)
