"""Photo sets of the real glossy ball (DiLiGenT's, Shi et al. 2016), written from its photographs and lights."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Lamps:
    """The lamps of a set's photographs.

    names : of the photographs, without a suffix. directions : (k, 3) unit, towards them; x right, y up, z to the
    camera. irradiances : (k, 3), relative, RGB.
    """

    names: tuple[str, ...]
    directions: Floats
    irradiances: Floats


def read_lamps(folder: Path) -> Lamps:
    """The lamps in a folder's `lights.txt`."""
    rows = [line.split() for line in (folder / "lights.txt").read_text().splitlines() if line[:1] != "#"]
    numbers = np.array([[float(value) for value in row[1:]] for row in rows if row])
    directions = numbers[:, :3] / np.linalg.norm(numbers[:, :3], axis=1, keepdims=True)
    return Lamps(tuple(row[0] for row in rows if row), directions, numbers[:, 3:])


def write_photoset(
    source: Path,
    folder: Path,
    fitted: Sequence[int],
    held_out: Sequence[int] = (),
    known: bool = True,
    sphere: tuple[float, float, float] | None = None,
) -> Path:
    """Write a photo set of the ball in `source` into a folder, whose path is returned; pixels are its unit of length.

    fitted, held_out : places in `read_lamps` of the photographs. known : False to hide the lamps, which are then one
    unknown lighting in the dark per photograph. sphere : centre x, y (world) and radius, pixels; None leaves it to the
    masks. The world's x points right, y up, z to the camera; its origin is the crop's upper left corner.
    """
    lamps = read_lamps(source)
    lines = [
        'format = 1\nname = "glossy ball"\n',
        '[camera]\nmodel = "ORTHOGRAPHIC"\nwidth = 160\nheight = 160\n',
        '[radiometry]\nencoding = "linear"\n',
        '[object]\nshape = "sphere"',
    ]
    if sphere is not None:
        lines.append(f"centre = [{sphere[0]}, {sphere[1]}, 0]\nradius = {sphere[2]}")
    lines.append("")
    for k in (*fitted, *held_out):
        lines.append(f'[[lighting]]\nname = "lamp {lamps.names[k]}"')
        if known or k in held_out:
            direction, irradiance = (
                json.dumps(values[k].tolist()) for values in (lamps.directions, lamps.irradiances)
            )
            lines.append(f"directional = [{{ direction = {direction}, irradiance = {irradiance} }}]\n")
        else:
            lines.append("unknown = true\ndark = true\n")
    for k in (*fitted, *held_out):
        lines += [
            f"[[photo]]\nfile = {json.dumps(str(source / lamps.names[k]) + '.png')}",
            f"mask = {json.dumps(str(source / 'mask.png'))}",
            "world_to_camera = [[1,0,0,0],[0,-1,0,0],[0,0,-1,1000],[0,0,0,1]]",
            f'lighting = "lamp {lamps.names[k]}"',
            *(["held_out = true"] if k in held_out else []),
            "",
        ]
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "photoset.toml").write_text("\n".join(lines), encoding="utf-8")
    return folder
