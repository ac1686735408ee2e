"""Image files to arrays and back: no radiometry here, only bytes, shapes and clear errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture.files.imageheader import Header, is_raw, read_header
from capture.files.jpegscan import jpeg_fault
from capture.files.tiff import inflates

# Larger images than any camera makes are taken for a decompression bomb: a small file that fills the memory.
MAX_PIXELS = 400_000_000

_DAMAGED = "cannot be decoded; it is truncated, damaged or not an image. Copy or export it again"


def read_pixels(path: Path) -> NDArray[np.generic]:
    """The pixels as stored, (h, w, 3) in RGB order; uint8, uint16, float16 or float32.

    PNG, JPEG, TIFF, EXR or Radiance .hdr, recognised by its content. Grey images are repeated over the channels, alpha
    is dropped, and the orientation tag is ignored because a camera model belongs to the sensor's own axes. ValueError
    names the file and the fault.
    """
    return read_image(path)[0]


def read_image(path: Path) -> tuple[NDArray[np.generic], Header]:
    """As `read_pixels`, with what the file is."""
    stored, _, header = _contents(path)
    return _in_rgb(stored, header.kind), header


def read_cover(path: Path) -> NDArray[np.generic]:
    """What a file says of how much of each pixel an object covers, (h, w), as stored.

    Its alpha where that varies, as programs that cut objects out write it; else the largest of its channels.
    """
    stored, alpha, header = _contents(path)
    if alpha is not None and alpha.min() < alpha.max():
        return alpha
    if stored.ndim == 2:
        return stored
    pixels = _in_rgb(stored, header.kind)
    # Channel by channel: numpy's maximum over three neighbours takes ten times as long.
    return np.asarray(np.maximum(np.maximum(pixels[..., 0], pixels[..., 1]), pixels[..., 2]))


def _contents(path: Path) -> tuple[NDArray[np.generic], NDArray[np.generic] | None, Header]:
    """What a file stores, as `_stored` has it, alpha (h, w) or None, and what the file is."""
    data = read_file(path)
    header = check_header(path, data)
    kind = header.kind
    if kind == "camera RAW":
        if is_raw(path):
            raise ValueError(
                f"{path}: is a camera RAW file; an ordinary image is needed here (PNG, TIFF, EXR, ...)"
            )
        raise ValueError(
            f"{path}: is a camera RAW file under another ending, of which only the preview would be read;"
            " give it its own ending back (.dng, .nef, .cr2, ...)"
        )
    if kind == "EXR":
        channels = _exr_channels(path)
        return _of_exr(path, channels), channels.get("A"), header
    time = path.stat().st_mtime_ns
    fault = _fault(path, kind, (time, data.size))
    if fault is not None:
        raise ValueError(f"{path}: {_DAMAGED} ({fault})")
    stored = _stored(path, data, kind)
    alpha = stored[..., 3] if stored.ndim == 3 and stored.shape[2] == 4 else None
    return stored, alpha, header


@lru_cache(maxsize=10_000)
def _fault(path: Path, kind: str, state: tuple[int, int]) -> str | None:
    """What is wrong with a file's compressed data that OpenCV doesn't say; None if nothing is seen.

    state : time and size, so that a file which is decoded again is not looked at again.
    """
    data = read_file(path)
    if kind == "JPEG":
        return jpeg_fault(data.tobytes())
    return "its checksums are wrong" if kind == "TIFF" and not inflates(data.data) else None


def read_file(path: Path) -> NDArray[np.uint8]:
    """A file's bytes; ValueError where there is no such file, or nothing in it."""
    check_exists(path)
    try:
        data = np.fromfile(path, np.uint8)
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror or error})") from error
    if data.size == 0:
        raise ValueError(f"{path}: is an empty file")
    return data


def check_exists(path: Path) -> None:
    """ValueError unless there is such a file."""
    if not path.exists():
        raise ValueError(f"{path}: does not exist; check its name, and the folder that it is relative to")
    if path.is_dir():
        raise ValueError(f"{path}: is a folder, not an image file")


def check_header(path: Path, data: NDArray[np.uint8]) -> Header:
    """The header of a file's bytes; ValueError if it is no image, is cut off, or would decode to a monster."""
    header = read_header(data.data)
    if not header.kind or not header.whole:
        raise ValueError(f"{path}: {_DAMAGED}")
    if header.size is not None and header.size[0] * header.size[1] > MAX_PIXELS:
        raise ValueError(
            f"{path}: says that it holds {header.size[0]}x{header.size[1]} pixels; more than"
            f" {MAX_PIXELS // 1_000_000} million are refused, because no camera takes them. Cut or shrink it"
        )
    return header


def rgbe_step(pixels: NDArray[np.generic]) -> NDArray[np.float32]:
    """The step (h, w, 1) between neighbouring numbers of a Radiance file, whose three mantissas share an exponent."""
    _, exponent = np.frexp(pixels.max(axis=2, keepdims=True))
    return np.ldexp(np.float32(1), exponent - 8)


def write_exr(
    path: Path,
    pixels: NDArray[np.floating],
    half: bool = False,
    layers: Mapping[str, NDArray[np.floating]] | None = None,
    chromaticities: Sequence[float] | None = None,
) -> None:
    """Write an RGB image (h, w, 3) as a ZIP-compressed EXR, float32 unless `half`.

    layers : further channels by name, (h, w), or (h, w, 3) for name.R, name.G and name.B; always float32.
    chromaticities : x, y of red, green, blue and white, to be written; None where nobody knows them.
    """
    import OpenEXR

    header: dict[str, Any] = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    if chromaticities is not None:
        header["chromaticities"] = tuple(chromaticities)
    channels = {"RGB": np.ascontiguousarray(pixels, dtype=np.float16 if half else np.float32)}
    for name, layer in (layers or {}).items():
        parts = (
            {name: layer} if layer.ndim == 2 else {f"{name}.{c}": layer[..., i] for i, c in enumerate("RGB")}
        )
        channels |= {key: np.ascontiguousarray(part, dtype=np.float32) for key, part in parts.items()}
    try:
        with OpenEXR.File(header, channels) as file:
            file.write(str(path))
    except RuntimeError as error:
        raise OSError(f"{path}: cannot be written; is the disk full?") from error


def write_png(path: Path, codes: NDArray[np.unsignedinteger]) -> None:
    """Write codes (h, w, 3), of 8 or 16 bits, as a PNG."""
    import cv2

    if not cv2.imwrite(str(path), codes[..., ::-1]):
        raise OSError(f"{path}: cannot be written; is the disk full?")


def read_exr_layers(path: Path) -> dict[str, NDArray[np.floating]]:
    """The channels of an EXR besides R, G, B, as `write_exr` takes them: (h, w), or (h, w, 3) for name.R, .G, .B."""
    check_header(path, read_file(path))
    channels = _exr_channels(path)
    layers: dict[str, NDArray[np.floating]] = {}
    for name in channels:
        layer, _, part = name.rpartition(".")
        if part in ("R", "G", "B") and all(f"{layer}.{c}" in channels for c in "RGB"):
            layers[layer] = np.stack([channels[f"{layer}.{c}"] for c in "RGB"], axis=-1)
        elif name not in ("R", "G", "B"):
            layers[name] = channels[name]
    return layers


def _in_rgb(image: NDArray[Any], kind: str) -> NDArray[np.generic]:
    """Pixels (h, w, 3) of what OpenCV makes of a file, see `_stored`."""
    import cv2

    if kind in ("JPEG", "EXR"):
        return image
    if kind == "Radiance":
        # Writers cut mantissas off (Ward, Real Pixels, 1991): a number stands for the middle of its step.
        image = np.where(image.max(axis=2, keepdims=True) > 0, image + rgbe_step(image) / 2, image)
    if image.ndim == 2 or image.shape[2] == 1:
        return np.repeat(image.reshape(*image.shape[:2], 1), 3, axis=2)
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB) if image.shape[2] == 3 else image[:, :, 2::-1].copy()


def _stored(path: Path, data: NDArray[np.uint8], kind: str) -> NDArray[Any]:
    """What OpenCV makes of a file's bytes: (h, w), or (h, w, c) in BGR or BGRA order, of JPEG and EXR in RGB order."""
    import cv2

    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # the error below says it
    # Straight to RGB for JPEG, whose photographs are large; for 16-bit TIFF that flag mixes the channels up.
    rgb = cv2.IMREAD_COLOR_RGB | cv2.IMREAD_IGNORE_ORIENTATION
    try:
        image = cv2.imdecode(data, rgb if kind == "JPEG" else cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise ValueError(f"{path}: {_DAMAGED}") from error
    if image is None:
        raise ValueError(f"{path}: {_DAMAGED}")
    return image


def _exr_channels(path: Path) -> dict[str, NDArray[np.floating]]:
    import OpenEXR

    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            # A damaged file may open with no parts; channels() then raises.
            return {name: channel.pixels for name, channel in file.channels().items()}
    except (RuntimeError, ValueError) as error:
        raise ValueError(f"{path}: {_DAMAGED}") from error


def _of_exr(path: Path, channels: Mapping[str, NDArray[np.floating]]) -> NDArray[np.generic]:
    if "RY" in channels:
        raise ValueError(f"{path}: holds luminance and chroma (Y, RY, BY); write it as R, G, B")
    for names in (("R", "G", "B"), ("Y", "Y", "Y")):
        if all(name in channels for name in names):
            return np.stack([channels[name] for name in names], axis=-1)
    raise ValueError(f"{path}: holds the channels {', '.join(sorted(channels))}; R, G, B (or Y) are needed")
