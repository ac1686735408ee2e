"""A sheet of small pictures of a photo set, to see at a glance what is on it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture.srgb import linear_to_srgb

Floats = NDArray[np.float64]
AnyFloats = NDArray[np.floating]

# Pictures in a row, and inches of each.
_COLUMNS, _WIDTH_IN = 6, 2.2
# So many of a set's photographs, evenly taken.
_MOST = 24
# The share of a picture's lit pixels that may be brighter than white in it.
_WHITE_QUANTILE = 0.995


def contact_sheet(pictures: Sequence[tuple[str, AnyFloats]], columns: int = _COLUMNS) -> Any:
    """A matplotlib Figure of pictures, each with its title.

    pictures : (h, w, 3) linear radiance each; scaled to its own white, then shown by the sRGB curve.
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
    for axis, (title, radiance) in zip(axes, pictures, strict=False):
        axis.imshow(displayed(radiance))
        axis.set_title(title, fontsize=8)
    return figure


def displayed(radiance: AnyFloats) -> Floats:
    """Linear radiance (h, w, 3) as it is shown on a screen, 0 to 1: white near its brightest, sRGB."""
    lit = radiance.max(axis=2)
    lit = lit[lit > 0]
    white = float(np.quantile(lit, _WHITE_QUANTILE)) if lit.size else 1.0
    return np.asarray(linear_to_srgb(np.clip(radiance / white, 0, 1)))


def write_contact_sheet(folder: Path, path: Path) -> None:
    """Write a PNG of a photo set's photographs, decoded as its manifest says; of many, evenly taken ones."""
    from capture.decode import decode_photo
    from capture.photoset import load_photoset

    photoset = load_photoset(folder)
    places = np.unique(np.linspace(0, len(photoset.photos) - 1, _MOST).round().astype(int))
    pictures = []
    for place in places[: len(photoset.photos)]:
        photo = photoset.photos[place]
        title = photo.label + (" (held out)" if photo.held_out else "")
        pictures.append((title, np.clip(decode_photo(photoset, photo).radiance, 0, None)))
    # Without the time and version that matplotlib would write: the same set gives the same bytes.
    contact_sheet(pictures).savefig(path, dpi=110, metadata={"Software": None})
