"""References: a card, a sphere or a colour chart of known reflectance that lies in a photograph.

What it shows over what it reflects is what a perfect white would show there: the light that falls on it, in the
photographs' own unit. That fixes the scale of light and reflectance where no light was measured, and white.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from capture.decode import decode_photo
from capture.manifest import Manifest, resolve
from capture.photo import Photo
from capture.radiance import RadianceImage
from capture.radiometry import Radiometry
from capture.referencetable import ReferenceTable

if TYPE_CHECKING:
    from capture.chart.chartsearch import FoundChart

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Pixels that a reference takes at least, and the most that are kept of it; share of them that may be saturated.
_FEWEST, _MOST, _SATURATED = 50, 2000, 0.01
# Parts across and down in which a reference's evenness is judged.
_PARTS = 3
# Of a sphere's radius as it is seen, what is used: farther out little light falls, and pixels show what is behind.
_SPHERE = 0.85
# Grey patches of a chart that are used reflect this at least: glare adds most to the dark ones.
_GREY = 0.15


@dataclass(frozen=True, eq=False)
class SeenReference:
    """A reference as a photograph shows it.

    where, name : for messages. photo : that shows it. rows, columns : (n,) of its pixels, or some of them. white :
    (n, 3), radiance that a perfect white would have there, in the photograph's unit. parts : (n,), which of its parts
    each pixel is in. corners, plane : (k, 2) points in pixels, and where they are on the flat reference: metres, or for
    a chart cells; none of a sphere, or where its normal is given.
    """

    where: str
    name: str
    table: ReferenceTable
    photo: Photo
    rows: Ints
    columns: Ints
    white: Floats
    parts: Ints
    corners: Floats
    plane: Floats


def mean_of_parts(values: Floats, parts: Ints) -> Floats:
    """Mean (...) over the parts of a reference of what its pixels have, (n, ...); parts : (n,)."""
    return np.mean([values[parts == part].mean(axis=0) for part in np.unique(parts)], axis=0)


def check_references(manifest_path: Path, manifest: Manifest) -> None:
    """ValueError where [[reference]] names no photograph of the set, or white balance asks for one that isn't there."""
    files = [photo.file for photo in manifest.photo]
    for number, table in enumerate(manifest.reference, start=1):
        if table.photo not in files:
            raise ValueError(
                f'{manifest_path}: [[reference]] {number}: photo "{table.photo}" is no [[photo]] of the set; list it,'
                " with held_out = true if it shouldn't be fitted"
            )
    if manifest.radiometry.white_balance == "reference" and not manifest.reference:
        raise ValueError(
            f"{manifest_path}: [radiometry] white_balance = 'reference', but there is no [[reference]]: add one, or"
            " give factors"
        )


def see_references(
    manifest_path: Path, tables: Sequence[ReferenceTable], photos: Sequence[Photo], radiometry: Radiometry
) -> list[SeenReference]:
    """References of a manifest, the first ones in its order, as their photographs show them.

    Raises ValueError where one lies beyond the picture, is saturated, small or black, or has a chart that isn't found.
    """
    seen = {}
    for photo in photos:
        own = [(number, table) for number, table in enumerate(tables, start=1) if table.photo == photo.name]
        image = decode_photo(radiometry, photo) if own else None
        for number, table in own:
            assert image is not None
            where = f'{manifest_path}: [[reference]] {number} (photo "{table.photo}")'
            seen[number] = _seen(where, manifest_path, table, photo, image)
    return [seen[number] for number in sorted(seen)]


def _seen(
    where: str, manifest_path: Path, table: ReferenceTable, photo: Photo, image: RadianceImage
) -> SeenReference:
    corners, plane = np.zeros((0, 2)), np.zeros((0, 2))
    try:
        if table.chart is not None:
            found, masks, reflectances = _grey_patches(manifest_path, table.chart, image)
            corners, plane = found.patches().mean(axis=1), found.places
        elif table.centre is not None:
            masks, reflectances = [_on_sphere(photo, np.array(table.centre), float(table.radius or 0))], []
        else:
            masks, reflectances = [_within(np.array(table.region), image.saturated.shape)], []
            if table.size is not None:
                corners = np.array(table.region)
                plane = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * table.size
        if not reflectances:
            assert table.reflectance is not None
            reflectances = [np.array(table.reflectance)]
        rows, columns, parts, white = _pixels(image, masks, reflectances)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from error
    if table.normal is not None:
        corners, plane = np.zeros((0, 2)), np.zeros((0, 2))
    kind = "chart" if table.chart else "sphere" if table.centre else "card"
    name = f"the {kind} in {photo.label}"
    return SeenReference(where, name, table, photo, rows, columns, white, parts, corners, plane)


def balance(reference: SeenReference) -> Floats:
    """Factors (3,) for red, green and blue, green being 1, under which a reference shows its own colour."""
    white = mean_of_parts(reference.white, reference.parts)
    return np.asarray(white[1] / white)


def _pixels(
    image: RadianceImage, masks: Sequence[NDArray[np.bool_]], reflectances: Sequence[Floats]
) -> tuple[Ints, Ints, Ints, Floats]:
    """Pixels of regions, or some of them, the part that each is in, and the radiance of a perfect white there."""
    found = []
    for k, (mask, reflectance) in enumerate(zip(masks, reflectances, strict=True)):
        rows, columns = np.nonzero(mask)
        if len(rows) < _FEWEST:
            raise ValueError(
                f"it has {len(rows)} pixels, {_FEWEST} are needed: check its place, or go nearer"
            )
        saturated = image.saturated[rows, columns].mean()
        if saturated > _SATURATED:
            raise ValueError(f"{saturated:.0%} of its pixels are saturated: expose less")
        # A few that are saturated may be dust that glints.
        whole = ~image.saturated[rows, columns]
        rows, columns = rows[whole], columns[whole]
        kept = np.linspace(0, len(rows) - 1, min(len(rows), _MOST)).astype(int)
        rows, columns = rows[kept], columns[kept]
        parts = np.full(len(rows), k) if len(masks) > 1 else _ninths(rows, columns)
        found.append((rows, columns, parts, image.radiance[rows, columns].astype(float) / reflectance))
    rows, columns, parts, white = (np.concatenate(each) for each in zip(*found, strict=True))
    if not (white.mean(axis=0) > 0).all():
        raise ValueError("it is black: check its place, the black level and the exposure")
    return rows, columns, parts, white


def _ninths(rows: Ints, columns: Ints) -> Ints:
    """In which of three bands across and three down each pixel is."""

    def third(places: Ints) -> Ints:
        return (places - places.min()) * _PARTS // (np.ptp(places) + 1)

    return np.asarray(_PARTS * third(rows) + third(columns))


def _within(corners: Floats, size: tuple[int, ...]) -> NDArray[np.bool_]:
    """Pixels within a polygon (k, 2), without those at its border."""
    height, width = size
    if corners.min() < 0 or (corners.max(axis=0) > [width, height]).any():
        outside = next(corner for corner in corners if (corner < 0).any() or (corner > [width, height]).any())
        raise ValueError(
            f"region has a corner at {outside.tolist()}, outside the picture of {width}x{height} pixels; corners are"
            " [x, y] from its upper left"
        )
    from skimage.draw import polygon

    mask = np.zeros((height, width), np.uint8)
    # The centre of the first pixel is (0.5, 0.5).
    mask[polygon(corners[:, 1] - 0.5, corners[:, 0] - 0.5, (height, width))] = 1
    return np.asarray(cv2.erode(mask, np.ones((3, 3), np.uint8), borderValue=0) > 0)


def _on_sphere(photo: Photo, centre: Floats, radius: float) -> NDArray[np.bool_]:
    """Pixels whose rays pass well within a sphere; ValueError where it lies beyond the picture, partly or all."""
    camera = photo.camera
    if not photo.posed:
        raise ValueError("a sphere is found by its place in the world, but the photo has no pose yet")
    mask = np.zeros((camera.height, camera.width), bool)
    # Around a cube that holds it; of one partly behind the camera all that is on that side.
    cube = camera.project(centre + radius * np.stack(np.meshgrid(*3 * [(-1, 1)]), axis=-1).reshape(-1, 3))
    size = [camera.width, camera.height]
    first = np.clip(np.nan_to_num(cube.min(axis=0), nan=0), 0, size).astype(int)
    last = np.clip(np.nan_to_num(cube.max(axis=0) + 1, nan=np.inf), first, size).astype(int)
    rows, columns = np.mgrid[first[1] : last[1], first[0] : last[0]]
    origins, directions = camera.rays(np.column_stack([columns.ravel(), rows.ravel()]) + 0.5)
    to_centre = centre - origins
    along = np.einsum("nc,nc->n", to_centre, directions)
    apart = np.linalg.norm(to_centre - along[:, None] * directions, axis=1)
    mask[rows, columns] = ((apart < _SPHERE * radius) & (along > radius)).reshape(rows.shape)
    if not mask.any():
        raise ValueError("the sphere isn't in the picture: check centre and radius, metres in the world")
    if mask[[0, -1]].any() or mask[:, [0, -1]].any():
        raise ValueError("the sphere reaches beyond the picture: photograph all of it")
    return mask


def _grey_patches(
    manifest_path: Path, named: str, image: RadianceImage
) -> tuple[FoundChart, list[NDArray[np.bool_]], list[Floats]]:
    """A chart in a photograph, and pixels and reflectances of its grey patches that aren't dark or saturated."""
    # Whoever opens a set loads this module, few of them a chart.
    from capture.chart.chart import read_chart
    from capture.chart.chartsearch import find_chart

    chart = read_chart(str(resolve(manifest_path, named)) if named.lower().endswith(".csv") else named)
    found = find_chart(image.radiance, chart)
    quads = found.patches()
    masks, reflectances = [], []
    for k in chart.greys:
        mask = _within(quads[k], image.saturated.shape)
        if chart.srgb[k].mean() >= _GREY and mask.any() and image.saturated[mask].mean() <= _SATURATED:
            masks.append(mask)
            # Exact where colours go through a matrix; the camera's own differ from it by less than grey from grey.
            reflectances.append(chart.srgb[k])
    if not masks:
        raise ValueError("all of the chart's bright grey patches are saturated: expose less")
    return found, masks, reflectances
