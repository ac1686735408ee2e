"""Pictures as files: EXR with alpha and standard deviation, PNG to look at."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from capture.files.imagefile import write_exr
from capture.srgb import linear_to_srgb
from invrender.render.picture import Picture

# Of the covered pixels, the brightest half percent may clip.
_CLIPPED_PERCENT = 0.5


def write_picture(path: Path, picture: Picture) -> None:
    """Write an EXR: R, G, B, A, and std.R, std.G, std.B if the picture has them."""
    layers = {"A": picture.alpha} | ({} if picture.std is None else {"std": picture.std})
    write_exr(path, picture.radiance, layers=layers)


def write_png(path: Path, picture: Picture, exposure_ev: float) -> None:
    """Write an 8-bit sRGB PNG with alpha; radiance 1 is white at exposure 0, each EV doubles."""
    rgba = np.dstack([encoded(picture, exposure_ev), np.round(picture.alpha * 255).astype(np.uint8)])
    _, data = cv2.imencode(".png", np.ascontiguousarray(rgba[:, :, [2, 1, 0, 3]]))
    path.write_bytes(data.tobytes())


def encoded(picture: Picture, exposure_ev: float) -> NDArray[np.uint8]:
    """sRGB codes (h, w, 3) of the object itself, not darkened where it covers pixels in part."""
    cover = np.where(picture.alpha > 0, picture.alpha, 1)[:, :, None]
    linear = np.clip(picture.radiance / cover * 2.0**exposure_ev, 0, 1)
    return np.round(linear_to_srgb(linear) * 255).astype(np.uint8)


def automatic_exposure(picture: Picture) -> float:
    """The exposure in EV at which only the brightest half percent of the object clips; 0 of a black one."""
    brightest = picture.radiance.max(axis=2)[picture.alpha > 0]
    white = float(np.percentile(brightest, 100 - _CLIPPED_PERCENT))
    return float(-np.log2(white)) if white > 0 else 0.0
