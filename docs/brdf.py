"""RH01's Fig. 6 and Fig. 7 on synthetic photographs: the figure docs/brdf.png, and the table on the terminal.

python docs/brdf.py [OUT.png [SETS]]

SETS : a folder in which the three photo sets are kept, and made where they are missing.
"""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from matplotlib.figure import Figure
from rich.table import Table

from capture.decode import decode_photo
from capture.photoset import load_photoset
from capture.terminal import console, track
from invrender.brdf.microfacet import Microfacet
from invrender.inverse_brdf.figure import draw_picture, draw_slice, dress_profile
from invrender.inverse_brdf.fit import TableFit, table_misfit
from invrender.inverse_brdf.harmonic import FURTHER, HarmonicBRDF, estimate_harmonic
from invrender.inverse_brdf.near import Measured, measure_under
from invrender.inverse_brdf.observe import Observations, light_coefficients, observe, single_source
from invrender.inverse_brdf.rendering import Rendering
from invrender.inverse_brdf.run import SAMPLES
from invrender.inverse_brdf.slices import (
    harmonic_transfer,
    parametric_transfer,
    plane_of_incidence,
    ringing,
    slice_grid,
    table_transfer,
)
from invrender.inverse_brdf.table import BRDFTable
from invrender.process.pipeline import process
from recon.harmonics.complex import project_sources
from synthetic.materials.rh01 import RH01_MATERIALS, radiometric
from synthetic.scenes.build import read_staging
from synthetic.scenes.builtin import scene_path
from synthetic.writer import write_photoset

ORDERS = (6, 12)
FEWER_SAMPLES = 30_000


def photographs(name: str, sets: Path, samples: int | None) -> Observations:
    """Samples of a built-in scene, photographed if it hasn't been yet."""
    folder = sets / name
    if not folder.exists():
        write_photoset(read_staging(scene_path(name)), folder)
    return observe(load_photoset(folder), samples, track)


def measured_table(seen: Observations) -> Measured:
    """The table of Marschner's method, as `lightfactor brdf --method table` measures it."""
    sources = [single_source(seen.photoset, seen.lightings[photo.lighting]) for photo, _ in seen.fitted]
    return measure_under([field for _, field in seen.fitted], sources, seen.centre)


def harmonic(seen: Observations, order: int) -> HarmonicBRDF:
    """Coefficients under the set's light."""
    lights = {name: light_coefficients(light, order + FURTHER) for name, light in seen.lightings.items()}
    return estimate_harmonic(
        [field for _, field in seen.fitted], [lights[photo.lighting] for photo, _ in seen.fitted], order
    )


def print_parameters(table: BRDFTable, fit: TableFit, estimate: Microfacet) -> None:
    """Fig. 7: what complex light yields beside a fit to the table, and the truth."""
    truth = radiometric(RH01_MATERIALS["teflon"])
    true = Microfacet(truth.kd, truth.ks, truth.mu, truth.sigma)
    shown = Table(
        "parameter", "complex light", "fit to table", "truth", title="RH01's Fig. 7", title_justify="left"
    )
    columns = (estimate, fit.brdf, true)
    total = [brdf.kd[1] + brdf.ks[1] for brdf in columns]
    rows = {
        "albedo pi Kd": [np.pi * brdf.kd[1] for brdf in columns],
        "Kd / (Kd + Ks)": [brdf.kd[1] / whole for brdf, whole in zip(columns, total, strict=True)],
        "Ks / (Kd + Ks)": [brdf.ks[1] / whole for brdf, whole in zip(columns, total, strict=True)],
        "mu": [brdf.mu or np.nan for brdf in columns],
        "sigma (rad)": [brdf.sigma or np.nan for brdf in columns],
    }
    for name, values in rows.items():
        shown.add_row(name, *(f"{value:.4f}" for value in values))
    shown.add_row("RMS on table", *(f"{table_misfit(table, brdf):.2%}" for brdf in columns))
    console.print(shown)


def draw(table: BRDFTable, fit: TableFit, brdfs: dict[int, HarmonicBRDF], area: Observations) -> Figure:
    """Fig. 6, and the profile of its slices."""
    figure = Figure(figsize=(14, 11.5), dpi=100, layout="constrained")
    grid = figure.add_gridspec(3, 3, height_ratios=[1, 1.05, 0.9])
    pairs = slice_grid()
    model = parametric_transfer(fit.brdf, pairs)
    top = 0.6 * float(model[:, 1].max())
    draw_slice(
        figure.add_subplot(grid[0, 0]),
        *table_transfer(table, pairs),
        "measured under one source; blue: no sample",
        top,
    )
    for column, (order, brdf) in enumerate(brdfs.items(), start=1):
        axes = figure.add_subplot(grid[0, column])
        title = f"harmonics, order {order}; red: below zero"
        draw_slice(axes, harmonic_transfer(brdf, pairs), None, title, top)

    low, high = brdfs.values()
    photo, _ = next(pair for pair in area.fitted[len(area.fitted) // 3 :])
    rendering = Rendering.of(area, photo)
    observed = rendering.cut(decode_photo(area.photoset, photo).radiance)
    white = float(np.quantile(observed, 0.995))
    draw_picture(figure.add_subplot(grid[1, 0]), "photograph, area light", observed, white)
    soft = rendering.of_brdf(low, light_coefficients(area.lightings[photo.lighting], low.order))
    draw_picture(figure.add_subplot(grid[1, 1]), f"rendered, order {low.order}, same light", soft, white)
    flash = rendering.of_brdf(high, project_sources(rendering.towards[None], np.ones((1, 3)), high.order))
    title = f"rendered, order {high.order}, source at the viewpoint"
    draw_picture(figure.add_subplot(grid[1, 2]), title, flash)
    inside = soft.sum(axis=2) > 0
    error = np.sqrt(np.mean((soft - observed)[inside] ** 2) / np.mean(observed[inside] ** 2))
    console.print(f"Order {low.order} under the area light: RMS {error:.2%} of the photograph's radiance.")

    axes = figure.add_subplot(grid[2, :])
    degrees, along = plane_of_incidence(361)
    values, filled = table_transfer(table, along)
    axes.plot(degrees[filled], values[filled, 1], ".", markersize=4, label="table")
    axes.plot(degrees, parametric_transfer(fit.brdf, along)[:, 1], label="parametric fit to the table")
    for order, brdf in brdfs.items():
        axes.plot(degrees, harmonic_transfer(brdf, along)[:, 1], label=f"harmonics, order {order}")
        rings = ringing(brdf)
        console.print(
            f"Order {order}: {rings.negative_share:.1%} of the BRDF below zero, down to {rings.depth:.1%} of its peak;"
            f" {int(np.all(brdf.determined, axis=1).sum())} of {len(brdf.determined)} coefficients determined."
        )
    dress_profile(axes)
    return figure


def main(out: Path, sets: Path) -> None:
    """Write the figure and print the table."""
    measured = measured_table(photographs("rh01-marschner", sets, SAMPLES["table"]))
    table, fit = measured.table, measured.fit
    seen = photographs("rh01-teflon", sets, FEWER_SAMPLES)
    print_parameters(table, fit, process(seen.photoset, track=track).result.brdf)
    brdfs = {order: harmonic(seen, order) for order in track(ORDERS, "Solving")}
    figure = draw(table, fit, brdfs, photographs("rh01-area", sets, FEWER_SAMPLES))
    figure.savefig(out, metadata={"Software": None})


if __name__ == "__main__":
    place = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).with_name("brdf.png")
    if len(sys.argv) > 2:
        main(place, Path(sys.argv[2]))
    else:
        with TemporaryDirectory() as folder:
            main(place, Path(folder))
