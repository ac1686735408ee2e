"""From the shutter to linear radiance: photo sets, cameras, decoding, calibration, known lighting.

What calibration scripts need can be imported from here; docs/calibration.md works through an example.
"""

from __future__ import annotations

import importlib
from typing import Any

# Loaded at first use, so that importing one part does not wait for all libraries.
_HOME = {
    "Board": "boards.board",
    "Camera": "camera",
    "board_pose": "boards.boardpose",
    "calibrate_camera": "lens.intrinsics",
    "calibrate_gantry": "arc.gantrycalibration",
    "detect_board": "boards.boardsearch",
    "load_photoset": "photoset",
    "merge": "bracket.hdr",
    "merge_hdr": "bracket.hdrfiles",
    "open_bracket": "bracket.hdrfiles",
    "parse_board": "boards.board",
    "read_flat_field": "sensor.flatfield",
    "read_noise_model": "sensor.noise",
    "read_response": "bracket.response",
    "recover_flat_field": "sensor.flatrecovery",
    "recover_noise": "sensor.noiserecovery",
    "recover_response": "bracket.responserecovery",
}
__all__ = list(_HOME)


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)
