"""Pictures as files: EXR with alpha and standard deviation, PNG to look at."""

from __future__ import annotations

import struct
import zlib
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from capture.files.imagefile import read_exr_layers, read_pixels, write_exr
from capture.primaries import Primaries
from capture.srgb import linear_to_srgb
from invrender.output.render.picture import Picture

# Bytes of a PNG's signature and header chunk; the code of sRGB's curve [ITU-T H.273].
_PNG_HEADER, _SRGB_CURVE = 33, 13
# Of the covered pixels, the brightest half percent may clip.
_CLIPPED_PERCENT = 0.5


def in_primaries(picture: Picture, primaries: Primaries) -> Picture:
    """A picture in linear sRGB in other primaries; ValueError for one with standard deviations."""
    if picture.std is not None and primaries.name != "srgb":
        raise ValueError(
            f"standard deviations are known of sRGB's channels only, not of {primaries.name}'s: leave one of them out"
        )
    return replace(picture, radiance=(picture.radiance @ primaries.of_srgb.T).astype(np.float32))


def write_picture(path: Path, picture: Picture, primaries: Primaries | None = None) -> None:
    """Write an EXR: R, G, B, A, and std.R, std.G, std.B if the picture has them.

    primaries : that it is in, to be written beside it; None where nobody knows them.
    """
    layers = {"A": picture.coverage} | ({} if picture.std is None else {"std": picture.std})
    chromaticities = None if primaries is None else primaries.chromaticities
    write_exr(path, picture.radiance, layers=layers, chromaticities=chromaticities)


def read_picture(path: Path) -> Picture:
    """A picture that `write_picture` wrote."""
    layers = read_exr_layers(path)
    radiance, alpha, std = read_pixels(path), layers["A"], layers.get("std")
    std = None if std is None else std.astype(np.float32)
    return Picture(radiance.astype(np.float32), alpha.astype(np.float32), std)


def write_png(path: Path, picture: Picture, exposure_ev: float, primaries: Primaries | None = None) -> None:
    """Write an 8-bit PNG with sRGB's curve and alpha; radiance 1 is white at exposure 0, each EV doubles.

    primaries : as of `write_picture`; ValueError for those that no PNG is written in.
    """
    write_rgba(path, encoded(picture, exposure_ev), primaries)


def save_picture(
    path: Path, picture: Picture, exposure_ev: float | None = None, primaries: Primaries | None = None
) -> list[str]:
    """Write a picture as its file's name says, .exr or .png; returns notes, in sentences.

    exposure_ev : of a PNG; None exposes it so that the brightest half percent of the object clips. primaries : as of
    `write_png`.
    """
    if path.suffix.lower() == ".exr":
        write_picture(path, picture, primaries)
        return []
    exposure = (automatic_exposure(picture) or 0.0) if exposure_ev is None else exposure_ev
    write_png(path, picture, exposure, primaries)
    return [] if exposure_ev is not None else [exposure_note(exposure)]


def write_rgba(path: Path, rgba: NDArray[np.uint8], primaries: Primaries | None = None) -> None:
    """Write codes (h, w, 4) as a PNG; primaries : as of `write_png`."""
    _, data = cv2.imencode(".png", np.ascontiguousarray(rgba[:, :, [2, 1, 0, 3]]))
    path.write_bytes(data.tobytes() if primaries is None else _tagged(data.tobytes(), primaries))


def check_png(primaries: Primaries) -> None:
    """ValueError for primaries that no PNG is written in."""
    if primaries.png_code is None:
        raise ValueError(
            f"{primaries.name}: its white isn't D65, so no PNG is written in it; write an .exr, or give p3 or rec2020"
        )


def _tagged(png: bytes, primaries: Primaries) -> bytes:
    """A PNG with chunks behind its header that say its primaries, both old and new [PNG 2025, 11.3.2]."""
    check_png(primaries)
    assert primaries.png_code is not None
    # White first, in units of 1e-5.
    places = np.roll(primaries.chromaticities, 2)
    chunks = {
        # sRGB's curve, RGB, full range.
        b"cICP": bytes([primaries.png_code, _SRGB_CURVE, 0, 1]),
        b"cHRM": struct.pack(">8I", *(round(1e5 * place) for place in places)),
    }
    added = [
        struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
        for kind, content in chunks.items()
    ]
    return b"".join([png[:_PNG_HEADER], *added, png[_PNG_HEADER:]])


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
