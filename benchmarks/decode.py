"""Decoding photographs to radiance against bare `cv2.imread`, in one run.

    python -m benchmarks.decode [PHOTOGRAPHS [PHOTO.jpg]]

Both go over all cores, photograph by photograph, in turns; the ratio of the best times is what counts. The memory is
the peak over many photographs against that over few: it must not grow with their number.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.memory import peak_megabytes
from capture.decode import decode
from capture.parallel import parallel_map

WIDTH, HEIGHT, _PHOTOS, _FEW, _ROUNDS = 4000, 3000, 60, 6, 3


def main(arguments: list[str]) -> None:
    """Print the ratio of times and the peak memory."""
    with tempfile.TemporaryDirectory() as folder:
        count = int(arguments[0]) if arguments else _PHOTOS
        photo = Path(arguments[1]) if arguments[1:] else photograph(Path(folder) / "photo.jpg")
        paths = [photo] * count
        few = _peak_after(_radiance, paths[:_FEW])
        times: dict[str, list[float]] = {"imread": [], "decode": []}
        for _ in range(_ROUNDS):
            times["imread"].append(_seconds(lambda path: cv2.imread(str(path)), paths))
            times["decode"].append(_seconds(_radiance, paths))
        many = _peak_after(_radiance, paths)
        size = photo.stat().st_size / 1e6
    bare, ours = min(times["imread"]), min(times["decode"])
    print(f"{count} photographs of {size:.1f} MB on {os.cpu_count()} cores")
    print(f"cv2.imread {bare:.2f} s, decode to radiance {ours:.2f} s: {ours / bare:.2f}x")
    print(f"peak memory {few:.0f} MB after {_FEW} photographs, {many:.0f} MB after all")


def _radiance(path: Path) -> float:
    return float(decode(path, "srgb").radiance[0, 0, 0])


def _seconds(work: Callable[[Path], Any], paths: list[Path]) -> float:
    begin = time.perf_counter()
    for _ in parallel_map(work, paths):
        pass
    return time.perf_counter() - begin


def _peak_after(work: Callable[[Path], Any], paths: list[Path]) -> float:
    _seconds(work, paths)
    return peak_megabytes()


def photograph(path: Path) -> Path:
    """A 12-megapixel JPEG with the detail and the noise of a photograph: 1/f texture, about 5 MB."""
    rng = np.random.default_rng(0)
    picture = np.full((HEIGHT, WIDTH, 3), 110.0, np.float32)
    for octave in range(9):
        cells = rng.normal(0, 18, (HEIGHT >> octave, WIDTH >> octave, 3)).astype(np.float32)
        picture += cv2.resize(cells, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC) * (0.2 + 0.1 * octave)
    cv2.imwrite(str(path), np.clip(picture, 0, 255).astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, 90])
    return path


if __name__ == "__main__":
    main(sys.argv[1:])
