"""Photographs for the page: thumbnails, made once, and radiance that it can expose, mask and probe."""

from __future__ import annotations

import hashlib
from pathlib import Path
from threading import Lock
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from capture.camera import Camera
from capture.decode import decode_photo, photo_mask
from capture.files.imagefile import read_pixels
from capture.files.outfolder import result_files
from capture.photo import Photo
from capture.photoset import PhotoSet
from capture.radiance import CHANNELS, RadianceImage
from capture.srgb import linear_to_srgb
from invrender.output.live.packed import packed
from invrender.result.saved import SavedResult
from recon.mesh.bodies import Body

Floats = NDArray[np.float64]

# Pixels of a thumbnail's longer side, and of a picture's on the page.
_THUMBNAIL, SHOWN_SIDE = 240, 1200
# Octaves of a histogram below white, and its bins per octave.
_OCTAVES, _PER_OCTAVE = 16, 4
_COUNTED = 1_000_000
_WHITE = 99.5
# Level of compression; and pictures are decoded one after the other, as each takes much memory.
_QUICKLY = 1
ONE_AT_A_TIME = Lock()
# These are decoded at an eighth of their size in a fraction of the time.
_REDUCIBLE = (".jpg", ".jpeg")


def thumbnail(photoset: PhotoSet, photo: Photo, kept: Path) -> bytes:
    """A JPEG of a photograph, from the folder `kept` if it has it; ValueError says why it can't be shown."""
    state = photo.file.stat()
    name = hashlib.sha256(f"{photo.file}:{state.st_mtime_ns}:{state.st_size}".encode()).hexdigest()[:24]
    path = kept / f"{name}.jpg"
    if path.is_file():
        return path.read_bytes()
    _, encoded = cv2.imencode(".jpg", _small(photoset, photo), [cv2.IMWRITE_JPEG_QUALITY, 85])
    data = encoded.tobytes()
    kept.mkdir(exist_ok=True)
    with result_files(path) as folder:
        (folder / path.name).write_bytes(data)
    return data


def _small(photoset: PhotoSet, photo: Photo) -> NDArray[np.uint8]:
    """Codes (h, w, 3), BGR, of a small picture."""
    if photo.file.suffix.lower() in _REDUCIBLE:
        pixels = cv2.imread(str(photo.file), cv2.IMREAD_REDUCED_COLOR_8 | cv2.IMREAD_IGNORE_ORIENTATION)
        if pixels is not None:
            return np.asarray(_fitted(pixels, _THUMBNAIL), np.uint8)
    with ONE_AT_A_TIME:
        radiance = _fitted(decode_photo(photoset.radiometry, photo).radiance, _THUMBNAIL)
    white = max(float(np.percentile(radiance, _WHITE)), 1e-12)
    codes = np.round(255 * linear_to_srgb(np.clip(radiance / white, 0, 1)))
    return np.ascontiguousarray(codes[..., ::-1].astype(np.uint8))


def _fitted(image: NDArray[Any], side: int) -> NDArray[Any]:
    """A picture no larger than a side; where it is, means over pixels."""
    shrink = max(image.shape[:2]) / side
    if shrink <= 1:
        return image
    size = max(round(image.shape[1] / shrink), 1), max(round(image.shape[0] / shrink), 1)
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))


def shown_photo(photoset: PhotoSet, photo: Photo) -> bytes:
    """A photograph as the page shows it: radiance, where it is saturated, its mask, and facts about it."""
    with ONE_AT_A_TIME:
        # One after the other: of a large photograph each takes a hundred megabytes and more.
        masked, shares = _masked(photo)
        return _shown(decode_photo(photoset.radiometry, photo), photo, masked, shares)


def _masked(photo: Photo) -> tuple[float | None, dict[str, NDArray[Any]]]:
    """The share of a photograph that its mask keeps, None without one, and the mask as it is shown."""
    mask = photo_mask(photo)
    if mask is None:
        return None, {}
    kept = mask > 0.5
    del mask
    return float(kept.mean()), {"mask": _shares(kept)}


def _shown(
    image: RadianceImage, photo: Photo, masked: float | None, shares: dict[str, NDArray[Any]]
) -> bytes:
    arrays: dict[str, NDArray[Any]] = {
        "radiance": _fitted(image.radiance, SHOWN_SIDE).astype(np.float32),
        "saturated": _shares(image.saturated),
    }
    exposure = photo.exposure
    facts = {
        "label": photo.label,
        "width": photo.camera.width,
        "height": photo.camera.height,
        "saturated": float(image.saturated.mean()),
        "masked": masked,
        "exposure": {"seconds": exposure.exposure_s, "iso": exposure.iso, "f_number": exposure.f_number},
        "histogram": _histogram(image),
    }
    return packed(facts, arrays | shares, _QUICKLY)


def _histogram(image: RadianceImage) -> dict[str, Any]:
    """Counts of pixels, of large pictures some, by octaves below the brightest, for each channel."""
    white = max(float(image.radiance.max()), 1e-12)
    step = max(int(np.sqrt(image.saturated.size / _COUNTED)), 1)
    edges = np.linspace(-_OCTAVES, 0, _OCTAVES * _PER_OCTAVE + 1)
    octaves = np.log2(np.maximum(image.radiance[::step, ::step] / white, 2.0**-_OCTAVES))
    counts = {name: np.histogram(octaves[..., c], edges)[0].tolist() for c, name in enumerate(CHANNELS)}
    return {"white": white, "octaves": _OCTAVES, "counts": counts}


def judged(result: SavedResult, body: Body, photoset: PhotoSet, photo: Photo) -> bytes:
    """A photograph beside what a result predicts of it: radiance, its deviation, where both count, and the surface.

    body : the result's object in the world.
    """
    file = result.folder / "predicted" / f"{Path(photo.label).stem}.exr"
    if not file.is_file():
        raise ValueError(f"{file}: the result has no prediction of {photo.label}")
    predicted = read_pixels(file).astype(np.float32)
    observed = decode_photo(photoset.radiometry, photo)
    factor = max(round(observed.radiance.shape[0] / predicted.shape[0]), 1)
    if factor > 1:
        observed = observed.binned(factor)
    mask = photo_mask(photo)
    counted = predicted.any(axis=2) & ~observed.saturated
    if mask is not None:
        counted &= _fitted(mask, max(counted.shape))[: counted.shape[0], : counted.shape[1]] > 0.5
    arrays: dict[str, NDArray[Any]] = {
        "radiance": observed.radiance.astype(np.float32),
        "std": np.sqrt(observed.variance).astype(np.float32),
        "predicted": predicted,
        "counted": counted.astype(np.uint8),
        "normals": _normals(body, photo.camera.binned(factor), counted),
    }
    entry = next((each for each in result.content.photos if each.file == photo.label), None)
    error = None if entry is None else entry.rms_relative
    return packed({"label": photo.label, "error": error, "factor": factor}, arrays, _QUICKLY)


def _normals(body: Body, camera: Camera, counted: NDArray[np.bool_]) -> NDArray[np.float16]:
    """The surface's normal in the middle of each pixel that counts, and its cosine to the view, (h, w, 4)."""
    found = np.zeros((*counted.shape, 4), np.float16)
    rows, columns = np.nonzero(counted)
    hits = body.hits(camera, np.column_stack([columns, rows]).astype(float) + 0.5)
    found[rows, columns, :3] = hits.normals
    found[rows, columns, 3] = (hits.normals * hits.views).sum(axis=1) * hits.hit
    return found


def _shares(where: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Shares of pixels, 0 to 255, of the size that is shown; what is small isn't lost."""
    shares = _fitted(where.astype(np.float32), SHOWN_SIDE)
    return np.asarray(np.ceil(255 * np.clip(shares, 0, 1)), np.uint8)
