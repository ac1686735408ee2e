"""Masks that a person draws on photographs: kept as PNG files, which the manifest names."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from itertools import count
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from capture.decode import photo_mask
from capture.files.imageheader import read_header
from capture.files.outfolder import result_files
from capture.photo import Photo
from capture.photoset import PhotoSet
from lightfactor.studio.manifest import write_key
from lightfactor.studio.opened import Opened

Codes = NDArray[np.uint8]

# A pixel of which the object covers this much, of 255, shows it.
_OBJECT = 128


def mask_picture(photo: Photo) -> bytes:
    """A photograph's mask as a PNG of 8-bit grey levels, as large as the photograph: 255 is all object.

    ValueError where the photograph has no mask, or it can't be read.
    """
    mask = photo_mask(photo)
    if mask is None:
        raise ValueError(f"{photo.label}: has no mask yet")
    return _encoded(np.round(255 * mask).astype(np.uint8))


def save_mask(opened: Opened, key: str, sent: bytes) -> Path:
    """Keep a PNG as the mask of the photograph with an id, name it in the manifest, and return its path.

    sent : grey levels as large as the photograph; those between black and white are partial cover. A file that is the
    photograph's own mask already is replaced, and a copy kept. ValueError where the PNG is no mask of the photograph,
    or the manifest can't be changed; nothing is written then.
    """
    photoset, photo = opened.photo(key)
    encoded = _encoded(_decoded(photo, sent))
    root = photoset.folder.resolve()
    file = _own_mask(root, photoset, photo)
    if file is not None:
        _keep_copy(file, opened.own / "masks" / file.relative_to(root))
        with result_files(file) as folder:
            (folder / file.name).write_bytes(encoded)
        return file
    file = _new_mask(root, photo)
    name = file.relative_to(root).as_posix()
    if photoset.resolve(name).resolve() != file:
        raise ValueError(f"{file}: the manifest can't name a file whose path has a $ or a ~; rename it")
    number = [each.name for each in photoset.photos].index(photo.name)
    with result_files(file) as folder:
        (folder / file.name).write_bytes(encoded)
        # The mask only takes its place if the manifest could be changed.
        write_key(photoset.manifest, "photo", number, "mask", name)
    return file


def _decoded(photo: Photo, sent: bytes) -> Codes:
    """Grey levels (h, w) of a PNG; ValueError unless it is a mask of the photograph."""
    if not sent:
        raise ValueError(f"{photo.label}: no mask was sent; send a PNG that is white where the object is")
    header = read_header(memoryview(sent))
    if header.kind != "PNG":
        raise ValueError(f"{photo.label}: the mask that was sent is no PNG")
    width, height = photo.camera.width, photo.camera.height
    # Before it is decoded: a few bytes may claim to be a picture that fills the memory.
    if header.size is not None and header.size != (width, height):
        raise ValueError(
            f"{photo.label}: the mask that was sent is {header.size[0]}x{header.size[1]} pixels, but the photograph is"
            f" {width}x{height}; draw it at that size"
        )
    pixels = cv2.imdecode(np.frombuffer(sent, np.uint8), cv2.IMREAD_GRAYSCALE) if header.whole else None
    if pixels is None:
        raise ValueError(f"{photo.label}: the mask that was sent is damaged or cut off")
    if pixels.max() < _OBJECT:
        raise ValueError(f"{photo.label}: the mask that was sent is empty; draw where the object is")
    return np.asarray(pixels, np.uint8)


def _own_mask(root: Path, photoset: PhotoSet, photo: Photo) -> Path | None:
    """The file that may be replaced: a PNG in the set's folder that is this photograph's mask, and nothing else."""
    if photo.mask is None or photo.mask.suffix.lower() != ".png":
        return None
    file = photo.mask.resolve()
    used = {path.resolve() for path in _others(photoset, photo)}
    return file if file.is_relative_to(root) and file not in used else None


def _others(photoset: PhotoSet, photo: Photo) -> Iterator[Path]:
    """Pictures that the manifest names, but for the photograph's mask."""
    for each in photoset.photos:
        yield each.file
        if each.mask is not None and each is not photo:
            yield each.mask
    for lighting in photoset.lightings:
        for name in lighting.mirror_ball.files if lighting.mirror_ball else ():
            yield photoset.resolve(name)


def _new_mask(root: Path, photo: Photo) -> Path:
    """A file that isn't there yet, beside the photograph if that lies in the set's folder, else in the folder."""
    file = photo.file.resolve()
    folder = file.parent if file.is_relative_to(root) else root
    numbered = (f"-{number}" if number > 1 else "" for number in count(1))
    places = (folder / f"{photo.file.stem}{ending}_mask.png" for ending in numbered)
    return next(place for place in places if not place.exists())


def _keep_copy(file: Path, beside: Path) -> None:
    """Copy a file, if it is there, under a number of its own: every former mask is kept."""
    if not file.exists():
        return
    beside.parent.mkdir(parents=True, exist_ok=True)
    names = (beside.with_name(f"{beside.stem}-{number}{beside.suffix}") for number in count(1))
    copy = next(name for name in names if not name.exists())
    with result_files(copy) as folder:
        shutil.copyfile(file, folder / copy.name)


def _encoded(pixels: Codes) -> bytes:
    return cv2.imencode(".png", pixels)[1].tobytes()
