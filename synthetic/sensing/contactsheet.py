"""A sheet of small pictures of a photo set, to see at a glance what is on it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from capture.srgb import linear_to_srgb

if TYPE_CHECKING:
    from capture.photo import Photo
from capture.photoset import PhotoSet

Floats = NDArray[np.float64]
AnyFloats = NDArray[np.floating]

# Pictures in a row, and inches of each.
_COLUMNS, _WIDTH_IN = 6, 2.2
# So many of a set's photographs, evenly taken.
_MOST = 24
# The share of the object's pixels that may be brighter than white, which is at most so many times their median: dust
# and highlights shall not make all the rest dark.
_WHITE_QUANTILE, _WHITE_MEDIANS = 0.995, 10.0


def contact_sheet(pictures: Sequence[tuple[str, AnyFloats]], columns: int = _COLUMNS) -> Any:
    """A matplotlib Figure of pictures, each with its title.

    pictures : (h, w, 3) each, 0 to 1, as of `displayed`.
    """
    from matplotlib.figure import Figure

    columns = min(columns, len(pictures))
    rows = -(-len(pictures) // columns)
    shape = pictures[0][1].shape
    height = _WIDTH_IN * shape[0] / shape[1] + 0.25
    figure = Figure(figsize=(columns * _WIDTH_IN, rows * height), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for axis in axes:
        axis.set_axis_off()
    for axis, (title, picture) in zip(axes, pictures, strict=False):
        axis.imshow(picture)
        axis.set_title(title, fontsize=8)
    return figure


def displayed(radiance: AnyFloats, seen: NDArray[np.bool_]) -> Floats:
    """Linear radiance (h, w, 3) as it is shown on a screen, 0 to 1: sRGB, white near the brightest of what is `seen`.

    seen : (h, w), where the object is.
    """
    levels = radiance.max(axis=2)[seen]
    white = min(float(np.quantile(levels, _WHITE_QUANTILE)), _WHITE_MEDIANS * float(np.median(levels)))
    if not white > 0:
        white = float(levels.max()) or 1.0
    return np.asarray(linear_to_srgb(np.clip(radiance / white, 0, 1)))


def displayed_photo(photoset: PhotoSet, photo: Photo) -> Floats:
    """A photograph of a synthetic set (h, w, 3), `displayed`."""
    from capture.decode import decode_photo, read_mask

    image = decode_photo(photoset.radiometry, photo).radiance
    assert photo.mask is not None, "synthetic photographs have masks"
    return displayed(np.maximum(image, 0), read_mask(photo.mask, image.shape[:2]) > 0)


def write_contact_sheet(folder: Path, path: Path) -> None:
    """Write a PNG of a photo set's photographs, decoded as its manifest says; of many, evenly taken ones."""
    from capture.photoset import load_photoset

    photoset = load_photoset(folder)
    places = np.unique(np.linspace(0, len(photoset.photos) - 1, _MOST).round().astype(int))
    pictures = []
    for place in places[: len(photoset.photos)]:
        photo = photoset.photos[place]
        title = photo.label + (" (held out)" if photo.held_out else "")
        pictures.append((title, displayed_photo(photoset, photo)))
    # Without the time and version that matplotlib would write: the same set gives the same bytes.
    contact_sheet(pictures).savefig(path, dpi=110, metadata={"Software": None})
