"""Picked correspondences: a point of a photograph and the point of the mesh that it shows, as picks.csv has them."""

from __future__ import annotations

import csv
import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from capture.arrays import frozen_array
from capture.photo import Photo

Floats = NDArray[np.float64]

COLUMNS = ("photo", "u", "v", "x", "y", "z")
# Picks farther from the mesh than this share of its size were made on something else, or in another unit.
_OFF_SURFACE = 0.05


@dataclass(frozen=True, eq=False)
class Picks:
    """n picks. lines : (n,) int, in the file, from 1. photos : (n,) int, index into the set's photos.

    pixels : (n, 2), first pixel's centre (0.5, 0.5). points : (n, 3) in the mesh's frame, metres.
    """

    lines: NDArray[np.int64]
    photos: NDArray[np.int64]
    pixels: Floats
    points: Floats

    def __post_init__(self) -> None:
        for name in ("lines", "photos"):
            object.__setattr__(self, name, frozen_array(getattr(self, name), np.int64))
        for name in ("pixels", "points"):
            object.__setattr__(self, name, frozen_array(getattr(self, name)))

    def __len__(self) -> int:
        return len(self.lines)

    def of(self, chosen: NDArray[np.bool_]) -> Picks:
        return Picks(self.lines[chosen], self.photos[chosen], self.pixels[chosen], self.points[chosen])


def read_picks(path: Path, photos: Sequence[Photo], metres: float) -> Picks:
    """Picks of a CSV file, rows of photo,u,v,x,y,z, with or without these names as its first row.

    metres : what the mesh file's unit is. ValueError names the line and what is wrong with it.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror or error})") from error
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: is not a text file in UTF-8; save it as CSV, UTF-8") from error
    index = _index_of_names(photos)
    rows: list[tuple[int, int, list[float]]] = []
    header = False
    for line, fields in enumerate(csv.reader(text.splitlines(), skipinitialspace=True), start=1):
        fields = [field.strip() for field in fields]
        if not any(fields) or fields[0].startswith("#"):
            continue
        if not rows and not header and fields[0].lower() == COLUMNS[0]:
            if tuple(field.lower() for field in fields) != COLUMNS:
                raise ValueError(
                    f"{path}: line {line}: columns are {','.join(fields)}, not {','.join(COLUMNS)}"
                )
            header = True
            continue
        rows.append((line, *_row(f"{path}: line {line}", fields, index)))
    if not rows:
        raise ValueError(f"{path}: holds no picks; write rows of {','.join(COLUMNS)}")
    lines, which, numbers = zip(*rows, strict=True)
    values = np.array(numbers)
    picks = Picks(np.array(lines), np.array(which), values[:, :2], values[:, 2:] * metres)
    _check_inside(path, picks, photos)
    return picks


def check_on_surface(path: Path, picks: Picks, vertices: Floats, faces: NDArray[np.integer]) -> list[str]:
    """Sentences on picks that lie off the mesh; ValueError if most of them do: another unit, or another mesh."""
    corners = vertices[faces]
    size = float(np.ptp(corners.reshape(-1, 3), axis=0).max())
    away = _distances(picks.points, corners) / size
    far = away > _OFF_SURFACE
    if far.sum() * 2 > len(picks):
        reach = float(np.linalg.norm(picks.points - corners.reshape(-1, 3).mean(axis=0), axis=1).max()) / size
        worst = int(away.argmax())
        raise ValueError(
            f"{path}: {int(far.sum())} of {len(picks)} picks lie off the mesh, that of line {picks.lines[worst]} by"
            f" {away[worst]:.3g} times its size (they reach {reach:.3g} sizes from its middle): x, y, z must be in the"
            " mesh file's own coordinates and unit"
        )
    return [
        f"line {line} of {path.name} is {share:.0%} of the mesh's size off its surface"
        for line, share in zip(picks.lines[far], away[far], strict=True)
    ]


def _index_of_names(photos: Sequence[Photo]) -> Mapping[str, int]:
    index: dict[str, int] = {}
    for number, photo in enumerate(photos):
        index[photo.label] = index[photo.name] = number
    return index


def _row(where: str, fields: Sequence[str], index: Mapping[str, int]) -> tuple[int, list[float]]:
    if len(fields) != len(COLUMNS):
        hint = "; separate them by commas" if len(fields) == 1 else ""
        raise ValueError(
            f"{where} has {len(fields)} fields, not the {len(COLUMNS)} of {','.join(COLUMNS)}{hint}"
        )
    numbers = []
    for name, field in zip(COLUMNS[1:], fields[1:], strict=True):
        try:
            number = float(field)
        except ValueError as error:
            raise ValueError(f"{where}: {name} is {field!r}, not a number") from error
        if not np.isfinite(number):
            raise ValueError(f"{where}: {name} is {field}; it must be finite")
        numbers.append(number)
    if fields[0] not in index:
        near = difflib.get_close_matches(fields[0], index, n=1, cutoff=0.5)
        hint = f"did you mean {near[0]!r}?" if near else f"they are {', '.join(list(index)[:4])}, ..."
        raise ValueError(f"{where}: {fields[0]!r} is no photo of the set; {hint}")
    return index[fields[0]], numbers


def _check_inside(path: Path, picks: Picks, photos: Sequence[Photo]) -> None:
    sizes = np.array([[photos[i].camera.width, photos[i].camera.height] for i in picks.photos])
    outside = ((picks.pixels < 0) | (picks.pixels > sizes)).any(axis=1)
    if not outside.any():
        return
    first = int(np.flatnonzero(outside)[0])
    turned = picks.pixels[:, ::-1]
    swapped = ((turned >= 0) & (turned <= sizes)).all()
    hint = "; u and v look swapped: u is the column, v the row" if swapped else ""
    u, v = picks.pixels[first]
    raise ValueError(
        f"{path}: line {picks.lines[first]}: ({u:g}, {v:g}) is outside the photo, which has"
        f" {sizes[first, 0]}x{sizes[first, 1]} pixels{hint}"
    )


def _distances(points: Floats, corners: Floats) -> Floats:
    """Distance (n,) of each point from the nearest of triangles (f, 3, 3)."""
    middles = corners.mean(axis=1)
    reaches = np.linalg.norm(corners - middles[:, None], axis=2).max(axis=1)
    found = []
    for point in points:
        away = np.linalg.norm(middles - point, axis=1)
        # No triangle farther than the nearest middle can be the nearest.
        near = corners[away - reaches <= away.min()]
        close = trimesh.triangles.closest_point(near, np.broadcast_to(point, (len(near), 3)))
        found.append(np.linalg.norm(close - point, axis=1).min())
    return np.array(found)
