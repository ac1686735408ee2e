"""docs/meshes.png: a cat from three photographs, with its shadows on itself and without.

python docs/meshes.py [FOLDER]
"""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from capture.photoset import load_photoset
from capture.srgb import linear_to_srgb
from invrender.process.pipeline import process
from invrender.result.run import Prediction
from synthetic.run import run_synth

SCENE = "rh01-cat"
HELD_OUT = 3
# Of the photograph's white, where the colours of differences end.
LIMIT = 0.1


def comparison(seen: Prediction, blind: Prediction) -> Figure:
    """A held-out photograph, its prediction, and differences with and without visibility."""
    rows, columns = np.nonzero(seen.inside)
    crop = np.s_[rows.min() - 4 : rows.max() + 5, columns.min() - 4 : columns.max() + 5]
    observed = seen.observed.radiance[crop].astype(float)
    white = float(np.percentile(observed.max(axis=2), 99.5))
    figure = Figure(figsize=(12, 4.4), layout="constrained")
    panels = figure.subplots(1, 4)
    for axes, picture, title in (
        (panels[0], observed, "photograph, never fitted"),
        (panels[1], seen.predicted[crop], "prediction with visibility"),
    ):
        axes.imshow(linear_to_srgb(np.clip(picture / white, 0, 1)))
        axes.set_title(title)
    drawn = None
    for axes, prediction, title in (
        (panels[2], seen, "difference with visibility"),
        (panels[3], blind, "difference without"),
    ):
        off = (observed - prediction.predicted[crop]).mean(axis=2) / white
        rms = np.sqrt(np.mean(off[prediction.inside[crop]] ** 2))
        off[~prediction.inside[crop]] = np.nan
        colours = matplotlib.colormaps["RdBu_r"].with_extremes(bad="0.9")
        drawn = axes.imshow(100 * off, cmap=colours, vmin=-100 * LIMIT, vmax=100 * LIMIT)
        axes.set_title(f"{title}\n{100 * rms:.1f}% of white (RMS)")
    for axes in panels:
        axes.set_xticks([])
        axes.set_yticks([])
    assert drawn is not None
    figure.colorbar(drawn, ax=panels[2:], label="photograph minus prediction (% of white)", shrink=0.8)
    return figure


def main(out: Path) -> None:
    with TemporaryDirectory() as folder:
        given = Path(sys.argv[2]) if len(sys.argv) > 2 else Path(folder) / "set"
        if not given.exists():
            run_synth(SCENE, given, None, None)
        photoset = load_photoset(given)
        predictions = []
        for shadowing in (True, False):
            predictions.append(list(process(photoset, shadowing=shadowing).predictions())[HELD_OUT])
        comparison(*predictions).savefig(out / "meshes.png", dpi=110)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
