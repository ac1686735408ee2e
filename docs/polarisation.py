"""docs/polarisation.png: a painted doll through parallel and crossed filters, photographed and predicted.

python -m docs.polarisation [FOLDER]
"""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from capture.photoset import load_photoset
from capture.srgb import linear_to_srgb
from invrender.process.pipeline import process
from invrender.result.run import Run
from invrender.result.sentences import filters_in_words
from tests.invrender.polarisedsets import write_pairs
from tests.invrender.test_textures import LAMP_LIT

_EXTINCTION = 0.013
# The view that is shown, and samples of all photographs.
_VIEW, _SAMPLES = 2, 20_000
_COLUMNS = ("parallel", "crossed", "parallel less crossed:\nthe lobe")


def draw(run: Run) -> Figure:
    """Photographs of one view above, predictions below."""
    pair = [photo for photo in run.photoset.photos if photo.name.startswith(f"{_VIEW:03d}-")]
    parallel, crossed = (
        run.predict(photo) for photo in sorted(pair, key=lambda photo: "cross" in photo.name)
    )
    inside = parallel.counted
    white = float(np.quantile(parallel.observed.radiance[inside], 0.98))

    def shown(radiance: NDArray[np.floating]) -> NDArray[np.floating]:
        picture = np.where(inside[..., None], linear_to_srgb(np.clip(radiance / white, 0, 1)), 1)
        rows, columns = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
        return picture[rows[0] - 2 : rows[-1] + 3, columns[0] - 2 : columns[-1] + 3]

    rows = {
        "photographs": (parallel.observed.radiance, crossed.observed.radiance),
        "predictions": (parallel.predicted, crossed.predicted),
    }
    figure = Figure(figsize=(7.2, 7.6), layout="constrained")
    axes = figure.subplots(2, 3)
    for line, (name, (along, across)) in zip(axes, rows.items(), strict=True):
        for panel, title, radiance in zip(line, _COLUMNS, (along, across, along - across), strict=True):
            panel.imshow(shown(radiance))
            panel.set_xticks([])
            panel.set_yticks([])
            if name == "photographs":
                panel.set_title(title, fontsize=10)
        line[0].set_ylabel(name)
    extinction = run.photoset.extinction
    assert extinction is not None
    found = filters_in_words(extinction).replace(", of which", ",\nof which")
    figure.suptitle(
        f"{found}\nTruth: {100 * _EXTINCTION:.1f}%. White: not seen by enough photographs.", fontsize=9
    )
    return figure


def main(folder: Path) -> None:
    with TemporaryDirectory() as place:
        scene = Path(place) / "doll.toml"
        scene.write_text(LAMP_LIT)
        run = process(load_photoset(write_pairs(Path(place), scene, _EXTINCTION)), _SAMPLES)
        draw(run).savefig(folder / "polarisation.png", dpi=110)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
