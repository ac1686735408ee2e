"""docs/normals.png: normals of two real objects, how far off they are, and what their error bars say.

LIGHTFACTOR_DATA=DATA python -m docs.normals [FOLDER]: DATA holds `glossball/` and `normals_cat/` (DiLiGenT, Shi et al.
2016).
"""

from __future__ import annotations

import os
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from capture.photoset import load_photoset
from capture.srgb import linear_to_srgb
from invrender.photometric_stereo.result import StereoResult, photometric_stereo
from recon.normals.normalmap import read_normal_map
from tests.invrender.stereosets import angles_to, write_real

SETS = (("glossball", "glossy sphere"), ("normals_cat", "glazed cat"))
# The largest error that colours show, degrees.
_TOP = 12.0


@dataclass(frozen=True, eq=False)
class Judged:
    """A set, solved, with the angles (h, w) to its true normals in degrees: least squares', robust ones', ours."""

    title: str
    result: StereoResult
    errors: tuple[NDArray[np.float64], ...]
    seconds: float

    @staticmethod
    def of(source: Path, title: str, folder: Path) -> Judged:
        begun = time.perf_counter()
        result = photometric_stereo(load_photoset(write_real(source, folder)))
        seconds = time.perf_counter() - begun
        truth = read_normal_map(source / "normals.npz").normals[result.capture.inside]
        solved = result.solved
        found = (solved.least, solved.robust, solved.surface.normals)
        errors = tuple(result.as_picture(angles_to(normals, truth)) for normals in found)
        return Judged(title, result, errors, seconds)

    @property
    def covered(self) -> float:
        """Share of the pixels whose error is below twice their bar."""
        bars = self.result.normal_map.std_deg
        assert bars is not None
        inside = self.result.capture.inside
        return float((self.errors[-1][inside] < 2 * bars[inside]).mean())


def draw(judged: list[Judged]) -> Figure:
    figure = Figure(figsize=(15, 6.2), layout="constrained")
    panels = figure.subplots(len(judged), 5)
    for row, one in zip(panels, judged, strict=True):
        _draw_row(figure, row, one)
    return figure


def _draw_row(figure: Figure, row: Any, judged: Judged) -> None:
    result = judged.result
    middle = np.asarray(result.capture.radiance[:, result.capture.radiance.shape[1] // 2], float)
    photograph = result.as_picture(linear_to_srgb(np.clip(middle / np.quantile(middle, 0.99), 0, 1)))
    bars = result.normal_map.std_deg
    least, _, ours = (float(np.nanmean(error)) for error in judged.errors)
    photos = result.capture.radiance.shape[1]
    panels = (
        (f"{judged.title}, one of {photos} photographs", photograph),
        (f"normals, found in {judged.seconds:.0f} s", (result.normal_map.normals + 1) / 2),
        (f"off by {least:.1f}° on average: least squares", judged.errors[0]),
        (f"off by {ours:.1f}° on average: lightfactor", judged.errors[-1]),
        (f"error bar; {judged.covered:.0%} of errors within 2", bars),
    )
    for axes, (title, picture) in zip(row, panels, strict=True):
        assert picture is not None
        if picture.ndim == 3:
            axes.imshow(np.where(np.isfinite(picture), picture, 1))
        else:
            image = axes.imshow(picture, vmin=0, vmax=_TOP, cmap="viridis")
        axes.set_title(title, fontsize=10)
        axes.set_xticks([])
        axes.set_yticks([])
    figure.colorbar(image, ax=row[-1], label="degrees", extend="max")


def main(out: Path) -> None:
    data = Path(os.environ["LIGHTFACTOR_DATA"]).resolve()
    with TemporaryDirectory() as temporary:
        judged = [Judged.of(data / name, title, Path(temporary) / name) for name, title in SETS]
    for one in judged:
        means = ", ".join(f"{np.nanmean(error):.2f}" for error in one.errors)
        print(f"{one.title}: least squares, robust, ours {means} degrees; {one.covered:.1%} within 2")
    draw(judged).savefig(out / "normals.png", dpi=100)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
