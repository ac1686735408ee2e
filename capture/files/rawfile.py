"""Camera RAW files through LibRaw: linear, in the sensor's own colours, saturation found before demosaicing."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from capture.files.imagefile import read_file
from capture.files.imageheader import read_header

Floats = NDArray[np.float32]

# The mosaic goes through LibRaw's demosaicing as 16-bit numbers: black lies here, so that noise below black is
# kept and dark pixels stay unbiased (LibRaw would clip it), and white here.
_BLACK, _WHITE = 4096, 60000
# Bilinear demosaicing looks one photosite far: a clipped one spoils its neighbours to that distance.
_DEMOSAIC_REACH = 1
# Photosites within the highest 0.2% of the range, beside those in the next 0.4%, that betray a clip level below the
# white level that the file states; never below three quarters of it, where a plain bright wall may do the same.
_PILE_SHARE, _PILE_RATIO, _PILE_COUNT, _PILE_LEVEL = 0.002, 10, 50, 0.75
# Hot photosites, above the clip level of all others.
_OUTLIERS = 20


@dataclass(frozen=True, eq=False)
class RawImage:
    """A developed RAW photograph.

    linear : (h, w, 3) float32 in the camera's own colours, not white-balanced; 0 is black, 1 the white level.
        May be slightly negative: noise about black.
    saturated : (h, w) bool, true where a photosite within the reach of demosaicing is at its clip level.
    mosaic : (h, w) or (h, w, k) float32, the photosites on the same scale before demosaicing.
    step : the step between neighbouring stored numbers, on the same scale.
    """

    linear: Floats
    saturated: NDArray[np.bool_]
    mosaic: Floats
    step: float


def read_raw(path: Path) -> RawImage:
    """Develop a RAW file: black level subtracted, white level at 1, demosaiced, and nothing else.

    Demosaicing is bilinear: each value is a mean of the nearest photosites of its colour, which keeps proportions,
    can't overshoot at edges and has no more noise than a photosite; sharper methods have none of these properties.
    No gamma, no brightening, no colour matrix, no white balance; highlights are not rebuilt; the orientation tag is
    ignored. Pixels that aren't square are made so (LibRaw stretches them). ValueError names the file and the fault.
    """
    import rawpy

    with _opened(path) as raw:
        if raw.raw_type == rawpy.RawType.Stack:  # every pixel has all its colours: nothing to demosaic
            values = np.asarray(_developed(raw) / 65535, np.float32)
            return RawImage(values, values.max(axis=2) >= 1, values, step=1 / 65535)
        colours = raw.raw_colors_visible
        black = np.asarray(raw.black_level_per_channel, np.float32)
        white = float(raw.white_level)
        values = raw.raw_image_visible.astype(np.float32)
        mosaic = (values - black[colours]) / (white - black)[colours]
        clipped = values >= np.minimum(_clip_levels(raw)[colours], _pile_up(values, white))
        # Through LibRaw's demosaicing with black and white where noise is clipped at neither.
        raw.raw_image_visible[:] = np.clip(np.rint(mosaic * (_WHITE - _BLACK) + _BLACK), 0, 65535)
        linear = _developed(raw, user_black=0, user_cblack=[0, 0, 0, 0], user_sat=65535).astype(np.float32)
    linear -= _BLACK
    linear *= 1 / (_WHITE - _BLACK)
    reach = 2 * _DEMOSAIC_REACH + 1
    saturated = cv2.dilate(clipped.astype(np.uint8), np.ones((reach, reach), np.uint8))
    if saturated.shape != linear.shape[:2]:
        saturated = cv2.resize(saturated, linear.shape[1::-1], interpolation=cv2.INTER_NEAREST_EXACT)
    return RawImage(linear, saturated > 0, mosaic, step=float(1 / (white - black.mean())))


def raw_exposure(path: Path) -> tuple[float, float, float]:
    """Exposure time in seconds, ISO and f-number as LibRaw finds them; 0 where the file doesn't state it."""
    with _opened(path, unpack=False) as raw:
        return raw.other.shutter_speed, raw.other.iso_speed, raw.other.aperture


def camera_white_balance(path: Path) -> NDArray[np.float64]:
    """The camera's white balance as shot: factors (3,) for red, green and blue, green being 1."""
    with _opened(path, unpack=False) as raw:
        factors = np.array(raw.camera_whitebalance[:3], float)
    if not (factors > 0).all():
        raise ValueError(
            f"{path}: holds no white balance (factors {factors.tolist()}); give three factors, or 'none'"
        )
    return factors / factors[1]


@contextmanager
def _opened(path: Path, unpack: bool = True) -> Iterator[Any]:
    """A RAW file; `unpack` for its pixels as well as what it says of them."""
    import rawpy

    if not read_header(read_file(path).data).whole:
        raise ValueError(f"{path}: is cut off: image data that it announces are missing. Copy it again")
    try:
        with rawpy.RawPy() as raw:
            raw.open_file(str(path))
            if unpack:
                raw.unpack()
            yield raw
    except rawpy.LibRawFileUnsupportedError as error:
        kind = read_header(read_file(path).data).kind
        if kind in ("", "camera RAW"):
            raise ValueError(
                f"{path}: is no camera RAW file, or damaged, or of a camera that LibRaw doesn't know"
            ) from error
        raise ValueError(f"{path}: is a {kind} file, not camera RAW; give it its own ending back") from error
    except rawpy.LibRawError as error:
        raise ValueError(f"{path}: cannot be decoded; it is truncated or damaged. Copy it again") from error


def _developed(raw: Any, **levels: Any) -> NDArray[np.uint16]:
    """(h, w, 3) in the camera's own colours, on LibRaw's scale: 65535 is the white level."""
    import rawpy

    developed = raw.postprocess(
        demosaic_algorithm=rawpy.DemosaicAlgorithm.LINEAR,
        output_color=rawpy.ColorSpace.raw,
        output_bps=16,
        gamma=(1, 1),
        user_wb=[1, 1, 1, 1],
        no_auto_bright=True,
        adjust_maximum_thr=0,  # else the white level would follow each photograph's brightest pixel
        user_flip=0,
        **levels,
    )
    return developed if developed.shape[2] == 3 else np.repeat(developed[:, :, :1], 3, axis=2)


def _clip_levels(raw: Any) -> Floats:
    """The stored number at which each of the four colours clips, as far as the file states it."""
    limits = np.asarray(raw.camera_white_level_per_channel or [0] * 4, np.float32)
    return np.where(limits > 0, np.minimum(limits, raw.white_level), np.float32(raw.white_level))


def _pile_up(values: Floats, white: float) -> float:
    """The stored number at which photosites pile up below the stated white level; infinite where they don't.

    Some cameras clip earlier at some ISO settings than their files say.
    """
    top = float(np.partition(values.ravel(), -_OUTLIERS)[-_OUTLIERS])
    clip = top - _PILE_SHARE * white
    at_top = int((values >= clip).sum())
    below = int((values >= clip - 2 * _PILE_SHARE * white).sum()) - at_top
    piled = top > _PILE_LEVEL * white and at_top > max(_PILE_COUNT, _PILE_RATIO * below)
    return clip if piled else np.inf
