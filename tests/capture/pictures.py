"""Pictures on disk, written without the code that is to read them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np


def write(path: Path, rgb: np.ndarray) -> Path:
    """With OpenCV, whose channels are in the order blue, green, red."""
    assert cv2.imwrite(str(path), rgb[..., ::-1] if rgb.ndim == 3 else rgb)
    return path
