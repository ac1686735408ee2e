"""docs/references.png: a card and a white sphere beside the object, and Kd in unknown light by them.

python -m docs.references [FOLDER]
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from capture.files.imagefile import read_pixels
from capture.photoset import load_photoset
from capture.srgb import linear_to_srgb
from invrender.process.pipeline import process
from invrender.result.run import Run
from synthetic.scenes.build import read_staging
from synthetic.writer import write_photoset
from tests.invrender.faultysets import GLOSSY
from tests.invrender.referencesets import add_card, add_sphere, forget_light
from tests.invrender.test_references import KD, SOFT, VIEWS

_CARD, _FACING = (0.0, 0.0296, 0.012), (1.0, 0.1, 0.4)
_SPHERE, _RADIUS = (0.0, 0.0296, -0.010), 0.007
_KINDS = ("card", "white sphere", "both")


def main(folder: Path) -> None:
    with TemporaryDirectory() as place:
        runs = {kind: process(load_photoset(_photographed(Path(place), kind))) for kind in _KINDS}
        draw(runs).savefig(folder / "references.png", dpi=110)
    for kind, run in runs.items():
        print(
            kind, run.solution.quantities["kd"].value, run.solution.quantities["kd"].std, run.solution.gauge
        )


def _photographed(folder: Path, kind: str) -> Path:
    """A glossy sphere from eight sides in soft light that its set doesn't give, with references in the first view."""
    base, out = folder / "base", folder / kind
    if not base.exists():
        base.mkdir()
        large = SOFT.replace(
            "width = 112, height = 68, focal_px = 918", "width = 240, height = 136, focal_px = 1836"
        )
        views = "".join(
            f'[[view]]\nazimuth_deg = {a}\nelevation_deg = {e}\nlighting = "room"\n' for a, e in VIEWS
        )
        (base / "staged.toml").write_text(large.format(seed=0, material=GLOSSY) + views)
        write_photoset(read_staging(base / "staged.toml"), base)
    shutil.copytree(base, out)
    if kind != "white sphere":
        add_card(out, 0, _CARD, _FACING, (0.014, 0.010), 0.18, 0.02)
    if kind != "card":
        add_sphere(out, 0, _SPHERE, _RADIUS, 0.9, 0.02)
    return forget_light(out)


def draw(runs: dict[str, Run]) -> Figure:
    """The photograph with both references on the left, Kd by each on the right."""
    figure = Figure(figsize=(9.6, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.25, 1))
    _draw_photograph(left, runs["both"])
    places = np.arange(3)
    for c, (name, colour) in enumerate((("red", "#b2182b"), ("green", "#1b7837"), ("blue", "#2166ac"))):
        found = [runs[kind].solution.quantities["kd"] for kind in _KINDS]
        values = np.array([own.value[c] if own.value is not None else np.nan for own in found])
        stds = np.array([own.std[c] if own.std is not None else np.nan for own in found])
        right.errorbar(
            places + 0.08 * (c - 1),
            values / KD[c],
            stds / KD[c],
            fmt="o",
            color=colour,
            label=name,
            capsize=4,
        )
    right.axhline(1, color="0.6", linewidth=1)
    right.set_xticks(places, [f"by the {kind}" if kind != "both" else "by both" for kind in _KINDS])
    right.set_xlim(-0.4, 2.4)
    right.set_ylabel("Kd over its true value (bars: one deviation)")
    right.set_ylim(0.98, 1.02)
    right.legend(fontsize=8, ncols=3, loc="upper center")
    right.set_title("Kd, the light being unknown", fontsize=10)
    return figure


def _draw_photograph(axes: Any, run: Run) -> None:
    pixels = read_pixels(run.photoset.photos[0].file)
    axes.imshow(linear_to_srgb(np.clip(pixels / np.quantile(pixels.max(axis=2), 0.995), 0, 1)))
    for table in run.photoset.references:
        if table.region:
            corners = np.array([*table.region, table.region[0]]) - 0.5
            axes.plot(*corners.T, color="#ffb000", linewidth=1.2)
            across, down = corners[:4].mean(axis=0)
            axes.text(across, down + 28, "card, 18%", color="#ffb000", fontsize=8, ha="center")
        else:
            centre = run.photoset.photos[0].camera.project(np.array([table.centre]))[0] - 0.5
            around = np.linspace(0, 2 * np.pi, 80)
            radius = _RADIUS * 1836 / 0.6
            axes.plot(
                centre[0] + radius * np.cos(around),
                centre[1] + radius * np.sin(around),
                color="#ffb000",
                linewidth=1.2,
            )
            axes.text(
                centre[0], centre[1] + radius + 9, "sphere, 90%", color="#ffb000", fontsize=8, ha="center"
            )
    axes.set_xticks([])
    axes.set_yticks([])
    axes.set_title("The object, and two references beside it", fontsize=10)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
