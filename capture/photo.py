"""One photograph of a set."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from capture.camera import Camera
from capture.exposure import ExposureSettings
from capture.polarisation import Polariser


@dataclass(frozen=True, eq=False)
class Photo:
    """One photograph: its files, its posed camera, the name of its lighting.

    label : how the manifest names it, for messages and results. name : its file, as the manifest writes it.
    posed : false where nothing gives its pose, which only those may load who look for it; its camera then stands at
        the world's origin. polariser : the filter that it was taken through, before a lamp behind another one; None
        without.
    """

    label: str
    name: str
    file: Path
    mask: Path | None
    camera: Camera
    lighting: str
    exposure: ExposureSettings
    held_out: bool
    posed: bool = True
    polariser: Polariser | None = None
