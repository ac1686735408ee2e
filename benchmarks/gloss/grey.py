"""Disjoint photographs and disjoint parts of the surface of the real grey sphere: what its numbers repeat to."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.gloss.measure import numbers_of
from capture.photoset import load_photoset
from invrender.process.pipeline import process
from invrender.result.run import Run

# Side of the squares that parts of the surface are made of, pixels.
_SQUARE = 45


def by_photographs(
    manifest: Path, whole: Run, folder: Path, parts: int, samples: int
) -> list[dict[str, Any]]:
    """Numbers of every so many of the photographs, Kd in the gauge of the lamps of all of them."""
    head, *tables = re.split(r"(?m)^(?=\[\[)", manifest.read_text())
    lightings = whole.solution.lightings
    found = []
    for part in range(parts):
        own = {entry.lighting.name for entry in lightings[part::parts]}
        kept = [table for table in tables if _lighting_of(table) in own]
        numbers = _processed("".join([head, *kept]), folder / f"photographs {part}", samples)
        mean_lamp = np.mean([entry.lighting.irradiances[0] for entry in lightings[part::parts]], axis=0)
        numbers["kd"] = (np.array(numbers["kd"]) / mean_lamp).tolist()
        found.append(numbers)
    return found


def by_surface(manifest: Path, whole: Run, folder: Path, parts: int, samples: int) -> list[dict[str, Any]]:
    """Numbers of squares of all photographs, by turns, under the lamps that all of the surface shows."""
    text = manifest.read_text()
    for entry in whole.solution.lightings:
        lamp = entry.lighting
        given = f"direction = {lamp.directions[0].tolist()}, irradiance = {lamp.irradiances[0].tolist()}"
        text = re.sub(
            rf'(name = "{lamp.name}"\n)mirror_ball = .*\nrecover = .*\n',
            rf'\1directional = [{{ {given} }}]\nrecover = ["ambient"]\n',
            text,
        )
    found = []
    for part in range(parts):
        own = folder / f"surface {part}"
        own.mkdir(parents=True)
        for photo in whole.photoset.photos:
            pixels = cv2.imread(str(photo.file))
            rows, columns = (np.arange(size) // _SQUARE for size in pixels.shape[:2])
            # What is saturated says nothing: the sphere's outline stays, of its surface a part is seen.
            pixels[(rows[:, None] + columns) % parts != part] = 255
            cv2.imwrite(str(own / photo.file.name), pixels)
        local = re.sub(r'(?m)^file = ".*/', 'file = "', text)
        found.append(_processed(local, own, samples))
    return found


def _lighting_of(table: str) -> str:
    key = "name" if table.startswith("[[lighting]]") else "lighting"
    named = re.search(rf'(?m)^{key} = "(.*)"', table)
    assert named is not None
    return named.group(1)


def _processed(manifest: str, folder: Path, samples: int) -> dict[str, Any]:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "photoset.toml").write_text(manifest, encoding="utf-8")
    return numbers_of(process(load_photoset(folder), samples))
