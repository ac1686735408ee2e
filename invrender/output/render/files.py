"""Pictures as files: EXR with alpha and standard deviation, PNG to look at."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from capture.files.imagefile import read_exr_layers, read_pixels, write_exr
from capture.srgb import linear_to_srgb
from invrender.output.render.picture import Picture

# Of the covered pixels, the brightest half percent may clip.
_CLIPPED_PERCENT = 0.5


def write_picture(path: Path, picture: Picture) -> None:
    """Write an EXR: R, G, B, A, and std.R, std.G, std.B if the picture has them."""
    layers = {"A": picture.coverage} | ({} if picture.std is None else {"std": picture.std})
    write_exr(path, picture.radiance, layers=layers)


def read_picture(path: Path) -> Picture:
    """A picture that `write_picture` wrote."""
    layers = read_exr_layers(path)
    radiance, alpha, std = read_pixels(path), layers["A"], layers.get("std")
    std = None if std is None else std.astype(np.float32)
    return Picture(radiance.astype(np.float32), alpha.astype(np.float32), std)


def write_png(path: Path, picture: Picture, exposure_ev: float) -> None:
    """Write an 8-bit sRGB PNG with alpha; radiance 1 is white at exposure 0, each EV doubles."""
    write_rgba(path, encoded(picture, exposure_ev))


def save_picture(path: Path, picture: Picture, exposure_ev: float | None = None) -> list[str]:
    """Write a picture as its file's name says, .exr or .png; returns notes, in sentences.

    exposure_ev : of a PNG; None exposes it so that the brightest half percent of the object clips.
    """
    if path.suffix.lower() == ".exr":
        write_picture(path, picture)
        return []
    exposure = (automatic_exposure(picture) or 0.0) if exposure_ev is None else exposure_ev
    write_png(path, picture, exposure)
    return [] if exposure_ev is not None else [exposure_note(exposure)]


def write_rgba(path: Path, rgba: NDArray[np.uint8]) -> None:
    """Write codes (h, w, 4) as a PNG."""
    _, data = cv2.imencode(".png", np.ascontiguousarray(rgba[:, :, [2, 1, 0, 3]]))
    path.write_bytes(data.tobytes())


def encoded(picture: Picture, exposure_ev: float) -> NDArray[np.uint8]:
    """sRGB codes and alpha (h, w, 4), the object not darkened where it covers pixels in part."""
    cover = np.where(picture.coverage > 0, picture.coverage, 1)[:, :, None]
    codes = _codes(picture.radiance / cover, exposure_ev)
    return np.dstack([codes, np.round(picture.coverage * 255).astype(np.uint8)])


def before_black(picture: Picture, exposure_ev: float) -> NDArray[np.uint8]:
    """sRGB codes (h, w, 3) of the object in front of black."""
    return _codes(picture.radiance, exposure_ev)


def automatic_exposure(picture: Picture) -> float | None:
    """The exposure in EV at which only the brightest half percent of the object clips; None of a black one."""
    brightest = picture.radiance.max(axis=2)[picture.coverage > 0]
    white = float(np.percentile(brightest, 100 - _CLIPPED_PERCENT))
    return float(-np.log2(white)) if white > 0 else None


def exposure_note(exposure_ev: float) -> str:
    """What is said of an exposure that was chosen automatically."""
    return f"Exposed automatically: --exposure {exposure_ev:.2f} gives the same brightness again."


def _codes(radiance: NDArray[np.floating], exposure_ev: float) -> NDArray[np.uint8]:
    linear = np.clip(radiance * 2.0**exposure_ev, 0, 1)
    return np.asarray(np.round(linear_to_srgb(linear) * 255).astype(np.uint8))
