"""docs/nearlamps.png: a sphere under a near lamp, fitted as if the lamp were distant, and with its distance found.

python docs/nearlamps.py [FOLDER]
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from capture.photoset import load_photoset
from capture.srgb import linear_to_srgb
from invrender.process.pipeline import process
from invrender.result.run import Prediction, Run
from invrender.wording import with_error
from synthetic.run import run_synth

# The set calls its lamp distant.
SCENE = "fail-near-light"
SHOWN = 2
# Percent of the photograph's RMS radiance, where the colours of differences end.
LIMIT = 50


def numbers_of(run: Run, predictions: list[Prediction]) -> list[str]:
    """What a run says: the share that is left, Kd in green, Ks, mu, sigma, and the lamp's distance in centimetres."""
    said = [f"{np.mean([prediction.error.rms for prediction in predictions]):.1%}"]
    for name in ("kd", "ks", "mu", "sigma"):
        one = run.solution.quantities.get(name)
        if one is None:
            said.append("not needed")
        elif one.value is None or one.std is None:
            said.append(one.status)
        else:
            green = min(1, len(one.value) - 1)
            said.append(with_error(one.value[green], one.std[green]))
    light = run.solution.lightings[0].lighting
    if light.closeness is None or light.closeness_std is None:
        return [*said, "far away, as told"]
    (near,), (std,) = light.closeness, light.closeness_std
    return [*said, with_error(100 / near, 100 * std / near**2)]


def truth_of(truth: dict[str, Any]) -> list[str]:
    """The same numbers of the scene."""
    brdf, (lamp,) = truth["brdf"], truth["lighting"][0]["lamps"]
    distance = np.linalg.norm(np.subtract(lamp["position"], truth["object"]["centre"]))
    numbers = brdf["kd"][1], brdf["ks"][1], brdf["mu"], brdf["sigma"], 100 * distance
    return ["1% noise", *(f"{number:.4g}" for number in numbers)]


def table(axes: Axes, columns: list[list[str]]) -> None:
    """The numbers below each other: truth, as distant, found near."""
    names = ("left unexplained", "Kd, green (1/sr)", "Ks", "mu", "sigma (rad)", "distance (cm)")
    lines = [("", "true", "taken for distant", "distance found"), ("",) * 4]
    lines += [(name, *row) for name, row in zip(names, zip(*columns, strict=True), strict=True)]
    text = "\n".join(f"{name:18}{true:10}{distant:20}{near}" for name, true, distant, near in lines)
    axes.text(0, 0.5, text, family="monospace", fontsize=9, va="center", linespacing=1.7)


def comparison(distant: Prediction, near: Prediction, columns: list[list[str]]) -> Figure:
    """A photograph, its predictions with the lamp far away and near, differences in one scale, and numbers."""
    rows, across = np.nonzero(distant.inside)
    crop = np.s_[rows.min() - 6 : rows.max() + 7, across.min() - 6 : across.max() + 7]
    inside = distant.inside[crop]
    photograph = distant.observed.radiance[crop].astype(float)
    white = np.percentile(photograph[inside], 99)
    level = np.sqrt(np.mean(photograph[inside] ** 2))
    figure = Figure(figsize=(13, 6.6), layout="constrained")
    figure.suptitle("A lamp 12 cm from a sphere of 2 cm radius that the photo set calls distant")
    panels = figure.subplots(2, 3, width_ratios=(1.5, 1, 1))
    panels[0, 0].imshow(linear_to_srgb(np.clip(photograph / white, 0, 1)))
    panels[0, 0].set_title("photograph, one of 13")
    table(panels[1, 0], columns)
    drawn = None
    for (_, picture, residual), prediction, lamp, cause in (
        (panels[0], distant, "lamp taken for distant", ""),
        (panels[1], near, "its distance found", ", the noise"),
    ):
        predicted = prediction.predicted[crop].astype(float)
        picture.imshow(linear_to_srgb(np.clip(predicted / white, 0, 1)))
        picture.set_title(f"prediction: {lamp}")
        off = 100 * (photograph - predicted).mean(axis=2) / level
        off[~inside] = np.nan
        colours = matplotlib.colormaps["RdBu_r"].with_extremes(bad="0.8")
        drawn = residual.imshow(off, cmap=colours, vmin=-LIMIT, vmax=LIMIT)
        residual.set_title(f"difference: {prediction.error.rms:.1%} (RMS){cause}")
    for axes in panels.flat:
        axes.set_axis_off()
    assert drawn is not None
    label = "photograph minus prediction\n(% of the photograph's RMS radiance)"
    figure.colorbar(drawn, ax=panels[:, 2], label=label, extend="both", shrink=0.8)
    return figure


def main(out: Path) -> None:
    with TemporaryDirectory() as folder:
        given = Path(folder) / "set"
        run_synth(SCENE, given, None, None)
        # What a distant lamp leaves makes the program ask how near it is, unless it is told not to look for causes.
        runs = [process(load_photoset(given), causes=causes) for causes in (False, True)]
        predictions = [list(run.predictions()) for run in runs]
        truth = json.loads((given / "truth.json").read_text(encoding="utf-8"))
    columns = [truth_of(truth), *map(numbers_of, runs, predictions)]
    distant, near = (each[SHOWN] for each in predictions)
    comparison(distant, near, columns).savefig(out / "nearlamps.png", dpi=80, metadata={"Software": None})


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
