"""docs/meshlight.png: RH01's Fig. 13 and 14: a cat from three photographs, its lighting known and unknown.

python docs/meshlight.py [FOLDER] [SET]
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from capture.manifest import LightingTable
from capture.photoset import load_photoset
from capture.srgb import linear_to_srgb
from invrender.output.compare.lightings import first_coefficients
from invrender.process.pipeline import process
from invrender.process.run import Prediction
from invrender.result.document import result_document
from invrender.result.factorization import Factorization
from invrender.result.truth import truth_side
from synthetic.run import run_synth

SCENE = "rh01-cat"
SAMPLES = 20_000
HELD_OUT = (3, 4)
TITLES = ("a new view", "under another lamp")
# Of the photograph's white, where the colours of differences end.
LIMIT = 0.05
CHANNELS = ("tab:red", "tab:green", "tab:blue")
HARMONICS = ("0,0", "1,-1", "1,0", "1,1", "2,-2", "2,-1", "2,0", "2,1", "2,2")


def draw_photograph(panels: Sequence[Axes], seen: Prediction, title: str) -> None:
    """A photograph, its prediction and their difference."""
    rows, columns = np.nonzero(seen.inside)
    crop = np.s_[rows.min() - 4 : rows.max() + 5, columns.min() - 4 : columns.max() + 5]
    observed = seen.observed.radiance[crop].astype(float)
    white = float(np.percentile(observed.max(axis=2), 99.5))
    for axes, picture in ((panels[0], observed), (panels[1], seen.predicted[crop])):
        axes.imshow(linear_to_srgb(np.clip(picture / white, 0, 1)))
    off = (observed - seen.predicted[crop]).mean(axis=2) / white
    rms = np.sqrt(np.mean(off[seen.inside[crop]] ** 2))
    off[~seen.inside[crop]] = np.nan
    colours = matplotlib.colormaps["RdBu_r"].with_extremes(bad="0.9")
    drawn = panels[2].imshow(100 * off, cmap=colours, vmin=-100 * LIMIT, vmax=100 * LIMIT)
    panels[2].set_title(f"difference:\n{100 * rms:.2f}% of white (RMS)", fontsize=10)
    panels[0].set_title(f"photograph, never fitted:\n{title}", fontsize=10)
    panels[1].set_title("prediction, from light\nthat nobody measured", fontsize=10)
    panels[2].figure.colorbar(
        drawn, ax=panels[2], label="photograph minus prediction (% of white)", shrink=0.9
    )
    for axes in panels:
        axes.set_xticks([])
        axes.set_yticks([])


def draw_number(
    axes: Axes, name: str, title: str, truth: np.ndarray, results: Sequence[Factorization]
) -> None:
    """A number of the BRDF: the truth as a line, estimates with two standard deviations."""
    for place, result in enumerate(results):
        quantity = result.quantities[name]
        assert quantity.value is not None
        assert quantity.std is not None
        several = len(quantity.value) > 1
        for c, (value, std) in enumerate(zip(quantity.value, quantity.std, strict=True)):
            at = place + (0.15 * (c - 1) if several else 0)
            axes.errorbar(at, value, 2 * std, fmt="o", capsize=3, color=CHANNELS[c] if several else "black")
    axes.axhline(float(truth.mean()), color="0.5", linestyle="--", label="truth")
    axes.set_xticks([0, 1], ["light\nknown", "light\nunknown"])
    axes.set_xlim(-0.5, 1.5)
    axes.set_title(title, fontsize=10)
    axes.legend(fontsize=8)


def draw_light(axes: Axes, truth: np.ndarray, found: np.ndarray, std: np.ndarray) -> None:
    """The first nine coefficients (9, 3) over that of degree 0, in truth and as found."""
    place = np.arange(9)
    for c, colour in enumerate(CHANNELS):
        at = place + 0.22 * (c - 1)
        axes.bar(at, truth[:, c], 0.2, color=colour, alpha=0.3, label="truth" if c == 1 else None)
        label = "light unknown" if c == 1 else None
        axes.errorbar(at, found[:, c], 2 * std[:, c], fmt=".", capsize=2, color=colour, label=label)
    axes.axhline(0, color="0.5", linewidth=0.8)
    axes.set_xticks(place, HARMONICS)
    axes.set_xlabel("degree, order")
    axes.set_title("lighting: first nine coefficients over that of degree 0", fontsize=10)
    axes.legend(fontsize=8)


def main(out: Path) -> None:
    with TemporaryDirectory() as folder:
        given = Path(sys.argv[2]) if len(sys.argv) > 2 else Path(folder) / "set"
        if not given.exists():
            run_synth(SCENE, given, None, None)
        known = load_photoset(given)
        lab, lamp = known.lightings
        unknown = replace(known, lightings=(LightingTable(name=lab.name, unknown=True), lamp))
        runs = [process(photoset, SAMPLES) for photoset in (known, unknown)]
        results = [run.result for run in runs]
        truth = truth_side(given / "truth.json")
        predictions = list(runs[1].predictions())
    figure = Figure(figsize=(13, 8), layout="constrained")
    upper, lower = figure.subfigures(2, 1, height_ratios=(1.2, 1))
    panels = upper.subplots(1, 6)
    for place, held_out, title in zip((0, 3), HELD_OUT, TITLES, strict=True):
        draw_photograph(panels[place : place + 3], predictions[held_out], title)
    axes = lower.subplots(1, 4, width_ratios=(1, 1, 1, 2.6))
    for panel, name, title in (
        (axes[0], "ks_normalised", "Ks / (Kd + Ks)"),
        (axes[1], "mu", "mu"),
        (axes[2], "sigma", "sigma (radians)"),
    ):
        value = truth.numbers[name].value
        assert value is not None
        draw_number(panel, name, title, value, results)
        for result in results:
            found = result.quantities[name]
            print(name, found.value, "+-", found.std, "in truth", value)
    entry = results[1].lightings[0]
    files = {light.lighting.name: "" for light in results[1].lightings}
    coefficients = result_document(results[1], files, {}, {})["lighting"][0]["sh"]
    found, std = (np.array(coefficients[key])[:9] for key in ("value", "std"))
    true = first_coefficients(truth.lightings[0].lighting)
    true, found, std = true / true[0], found / found[0], std / found[0]
    draw_light(axes[3], true, found, std)
    print(f"nine coefficients off by at most {np.abs(found - true).max():.4f}")
    for direction in truth.lightings[0].lighting.directions:
        nearest = (entry.lighting.directions @ direction).max()
        print(f"source off by {np.degrees(np.arccos(min(nearest, 1))):.3f} degrees")
    for result in results:
        print([f"{photo.label} {photo.rms:.2%}" for photo in result.photos])
    figure.savefig(out / "meshlight.png", dpi=90)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
