"""Image files to arrays and back: no radiometry here, only bytes, shapes and clear errors."""

from __future__ import annotations

import contextlib
import io
import os
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray


def read_pixels(path: Path) -> NDArray[np.generic]:
    """The pixels as stored, (h, w, 3) in RGB order; uint8, uint16, float16 or float32.

    Grey images are repeated over the channels, alpha is dropped, and the orientation tag is ignored
    because a camera model belongs to the sensor's own axes. ValueError names the file and the fault.
    """
    if not path.exists():
        raise ValueError(f"{path}: does not exist")
    if path.is_dir():
        raise ValueError(f"{path}: is a folder, not an image file")
    return _read_exr(path) if path.suffix.lower() == ".exr" else _read_with_opencv(path)


def write_exr(path: Path, pixels: NDArray[np.floating], half: bool = False) -> None:
    """Write an RGB image (h, w, 3) as a ZIP-compressed EXR, float32 unless `half`."""
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    data = np.ascontiguousarray(pixels, dtype=np.float16 if half else np.float32)
    with OpenEXR.File(header, {"RGB": data}) as file:
        file.write(str(path))


def _read_with_opencv(path: Path) -> NDArray[np.generic]:
    import cv2

    try:
        data = np.fromfile(path, np.uint8)
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror or error})") from error
    if data.size == 0:
        raise ValueError(f"{path}: is an empty file")
    with _silenced():
        image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    if image is None:
        raise ValueError(
            f"{path}: cannot be decoded; it is truncated, damaged or not an image. Copy or export it again"
        )
    if image.ndim == 2:
        return np.repeat(image[:, :, None], 3, axis=2)
    if image.shape[2] == 1:
        return np.repeat(image, 3, axis=2)
    return np.ascontiguousarray(image[:, :, 2::-1])


def _read_exr(path: Path) -> NDArray[np.generic]:
    import OpenEXR

    try:
        with _silenced(), OpenEXR.File(str(path), separate_channels=True) as file:
            # A damaged file opens with no parts; channels() then raises.
            channels = {name: channel.pixels for name, channel in file.channels().items()}
    except (RuntimeError, ValueError) as error:
        raise ValueError(
            f"{path}: cannot be decoded as EXR; it is truncated, damaged or not an EXR file."
            " Copy or export it again"
        ) from error
    if "RY" in channels:
        raise ValueError(f"{path}: holds luminance and chroma (Y, RY, BY); write it as R, G, B")
    for names in (("R", "G", "B"), ("Y", "Y", "Y")):
        if all(name in channels for name in names):
            return np.stack([channels[name] for name in names], axis=-1)
    raise ValueError(f"{path}: holds the channels {', '.join(sorted(channels))}; R, G, B (or Y) are needed")


@contextlib.contextmanager
def _silenced() -> Iterator[None]:
    """Hold back what codecs print to stdout and stderr on damaged files; the ValueError says it instead.

    C libraries write to the file descriptors, OpenEXR's wrapper to Python's own streams: both are held.
    """
    sys.stdout.flush()
    sys.stderr.flush()
    saved = os.dup(1), os.dup(2)
    null = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(null, 1)
        os.dup2(null, 2)
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            yield
    finally:
        for number, copy in zip((1, 2), saved, strict=True):
            os.dup2(copy, number)
            os.close(copy)
        os.close(null)
