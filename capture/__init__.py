"""From the shutter to linear radiance: photo sets, cameras, decoding, calibration, known lighting.

What calibration scripts need can be imported from here; docs/calibration.md works through an example.
"""

from __future__ import annotations

import importlib
from typing import Any

# Loaded at first use, so that importing one part does not wait for all libraries.
_HOME = {
    "Board": "board",
    "Camera": "camera",
    "board_pose": "boardpose",
    "calibrate_camera": "intrinsics",
    "calibrate_gantry": "gantrycalibration",
    "detect_board": "boardsearch",
    "load_photoset": "photoset",
    "merge": "hdr",
    "open_bracket": "hdrfiles",
    "parse_board": "board",
    "read_flat_field": "flatfield",
    "read_noise_model": "noise",
    "read_response": "response",
    "recover_flat_field": "flatrecovery",
    "recover_noise": "noiserecovery",
    "recover_response": "responserecovery",
}
__all__ = list(_HOME)


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)
