"""Image files to arrays and back: no radiometry here, only bytes, shapes and clear errors."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

_DAMAGED = "cannot be decoded; it is truncated, damaged or not an image. Copy or export it again"


def read_pixels(path: Path) -> NDArray[np.generic]:
    """The pixels as stored, (h, w, 3) in RGB order; uint8, uint16, float16 or float32.

    Grey images are repeated over the channels, alpha is dropped, and the orientation tag is ignored
    because a camera model belongs to the sensor's own axes. ValueError names the file and the fault.
    """
    if not path.exists():
        raise ValueError(f"{path}: does not exist; check its name, and the folder that it is relative to")
    if path.is_dir():
        raise ValueError(f"{path}: is a folder, not an image file")
    return _read_exr(path) if path.suffix.lower() == ".exr" else _read_with_opencv(path)


def write_exr(path: Path, pixels: NDArray[np.floating], half: bool = False) -> None:
    """Write an RGB image (h, w, 3) as a ZIP-compressed EXR, float32 unless `half`."""
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    data = np.ascontiguousarray(pixels, dtype=np.float16 if half else np.float32)
    try:
        with OpenEXR.File(header, {"RGB": data}) as file:
            file.write(str(path))
    except RuntimeError as error:
        raise OSError(f"{path}: cannot be written; is the disk full?") from error


def _read_with_opencv(path: Path) -> NDArray[np.generic]:
    import cv2

    try:
        data = np.fromfile(path, np.uint8)
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror or error})") from error
    if data.size == 0:
        raise ValueError(f"{path}: is an empty file")
    _check_png(path, data)
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # the error below says it
    image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    if image is None:
        raise ValueError(f"{path}: {_DAMAGED}")
    if image.ndim == 2:
        return np.repeat(image[:, :, None], 3, axis=2)
    if image.shape[2] == 1:
        return np.repeat(image, 3, axis=2)
    return np.ascontiguousarray(image[:, :, 2::-1])


def _read_exr(path: Path) -> NDArray[np.generic]:
    import OpenEXR

    _check_exr(path)
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            # A damaged file may open with no parts; channels() then raises.
            channels = {name: channel.pixels for name, channel in file.channels().items()}
    except (RuntimeError, ValueError) as error:
        raise ValueError(f"{path}: {_DAMAGED}") from error
    if "RY" in channels:
        raise ValueError(f"{path}: holds luminance and chroma (Y, RY, BY); write it as R, G, B")
    for names in (("R", "G", "B"), ("Y", "Y", "Y")):
        if all(name in channels for name in names):
            return np.stack([channels[name] for name in names], axis=-1)
    raise ValueError(f"{path}: holds the channels {', '.join(sorted(channels))}; R, G, B (or Y) are needed")


def _check_png(path: Path, data: NDArray[np.uint8]) -> None:
    if data[:4].tobytes() == b"\x89PNG" and b"IEND" not in data[-64:].tobytes():
        raise ValueError(f"{path}: {_DAMAGED}")


def _check_exr(path: Path) -> None:
    """ValueError unless the file is EXR and, if of the common kind, holds every chunk that it announces.

    The codec would notice as well, but prints its own complaints to the terminal.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror or error})") from error
    try:
        if data[:4] != b"\x76\x2f\x31\x01":
            raise IndexError("no EXR signature")
        # Bit 9 tiled, 11 deep, 12 multi-part: left to the codec.
        if int.from_bytes(data[4:8], "little") & 0x1A00:
            return
        position = 8
        while data[position]:
            for _ in range(2):  # an attribute's name and type
                position = data.index(0, position) + 1
            position += 4 + struct.unpack_from("<I", data, position)[0]
        table = position + 1
        (first,) = struct.unpack_from("<Q", data, table)
        offsets = struct.unpack_from(f"<{(first - table) // 8}Q", data, table)
        for offset in offsets:
            _, size = struct.unpack_from("<iI", data, offset)
            if not offset or offset + 8 + size > len(data):
                raise IndexError("a chunk lies beyond the end of the file")
    except (IndexError, ValueError, struct.error) as error:
        raise ValueError(f"{path}: {_DAMAGED}") from error
