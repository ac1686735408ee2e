"""RH01's fig. 6 and 7: the BRDF of a teflon sphere under complex light, beside a measurement under one source."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from benchmarks.papers.entry import Outcome, Workplace
from benchmarks.papers.sets import photographed
from capture.decode import decode_photo
from capture.photoset import load_photoset
from invrender.brdf.microfacet import Microfacet
from invrender.inverse_brdf.figure import draw_picture, draw_slice, dress_profile
from invrender.inverse_brdf.fit import table_misfit
from invrender.inverse_brdf.harmonic import FURTHER, HarmonicBRDF, estimate_harmonic
from invrender.inverse_brdf.near import Measured, measure_under
from invrender.inverse_brdf.observe import Observations, light_coefficients, observe, single_source
from invrender.inverse_brdf.rendering import Rendering
from invrender.inverse_brdf.slices import (
    harmonic_transfer,
    parametric_transfer,
    plane_of_incidence,
    ringing,
    slice_grid,
    table_transfer,
)
from invrender.process.pipeline import DEFAULT_SAMPLES, process
from recon.harmonics.complex import project_sources
from synthetic.materials.rh01 import RH01_MATERIALS, radiometric

_ORDERS, _SAMPLES = (6, 12), 30_000
_FEW_ORDERS, _FEW_SAMPLES = (2, 4), 1000
_PRINTED = {
    "albedo": ("0.86", "0.87"),
    "Kd / (Kd + Ks)": ("0.89", "0.91"),
    "Ks / (Kd + Ks)": ("0.11", "0.09"),
    "mu": ("1.78", "1.85"),
    "sigma (rad)": ("0.12", "0.13"),
    "RMS on the table": ("9.3%", "8.5%"),
}


def slices(place: Workplace) -> Outcome:
    """Fig. 6: slices of the transfer function, renderings of low orders, and the slices' profile."""
    measured = _measured(photographed("rh01-marschner", place))
    orders, samples = (_FEW_ORDERS, _FEW_SAMPLES) if place.quick else (_ORDERS, _SAMPLES)
    seen = _observed(photographed("rh01-teflon", place), samples)
    area = _observed(photographed("rh01-area", place), samples)
    low, high = brdfs = [_harmonic(seen, order) for order in orders]
    figure = Figure(figsize=(14, 11.5), layout="constrained")
    grid = figure.add_gridspec(3, 3, height_ratios=[1, 1.05, 0.9])
    pairs = slice_grid()
    top = 0.6 * float(parametric_transfer(measured.fit.brdf, pairs)[:, 1].max())
    draw_slice(
        figure.add_subplot(grid[0, 0]),
        *table_transfer(measured.table, pairs),
        "measured under one source; blue: no sample",
        top,
    )
    for column, brdf in enumerate(brdfs, start=1):
        title = f"harmonics, order {brdf.order}; red: below zero"
        draw_slice(figure.add_subplot(grid[0, column]), harmonic_transfer(brdf, pairs), None, title, top)

    photo, _ = area.fitted[2 * len(area.fitted) // 5]
    rendering = Rendering.of(area, photo)
    observed = rendering.cut(decode_photo(area.photoset.radiometry, photo).radiance)
    white = float(np.quantile(observed, 0.995))
    soft = rendering.of_brdf(low, light_coefficients(area.lightings[photo.lighting], low.order))
    flash = rendering.of_brdf(high, project_sources(rendering.towards[None], np.ones((1, 3)), high.order))
    draw_picture(figure.add_subplot(grid[1, 0]), "photograph, area light", observed, white)
    draw_picture(figure.add_subplot(grid[1, 1]), f"rendered, order {low.order}, the same light", soft, white)
    title = f"rendered, order {high.order}, source at the viewpoint"
    draw_picture(figure.add_subplot(grid[1, 2]), title, flash)
    inside = soft.sum(axis=2) > 0
    error = np.sqrt(np.mean((soft - observed)[inside] ** 2) / np.mean(observed[inside] ** 2))

    axes = figure.add_subplot(grid[2, :])
    degrees, along = plane_of_incidence(361)
    values, filled = table_transfer(measured.table, along)
    axes.plot(degrees[filled], values[filled, 1], ".", markersize=4, label="table")
    axes.plot(
        degrees, parametric_transfer(measured.fit.brdf, along)[:, 1], label="parametric fit to the table"
    )
    for brdf in brdfs:
        axes.plot(degrees, harmonic_transfer(brdf, along)[:, 1], label=f"harmonics, order {brdf.order}")
    dress_profile(axes)
    rings = [ringing(brdf) for brdf in brdfs]
    told = " and ".join(
        f"order {brdf.order} has {ring.negative_share:.0%} of its values below 0, down to {ring.depth:.0%} of its peak"
        for brdf, ring in zip(brdfs, rings, strict=True)
    )
    return Outcome(
        "ringing at both orders; order 6 does under low-frequency light",
        f"order {low.order} under the area light: off by {error:.1%} (RMS)",
        f"As printed, harmonics ring: {told}. Under the area light that doesn't show. The table has no sample where the"
        " camera would hide the lamp.",
        place.save(figure, "rh01-fig6"),
    )


def parameters(place: Workplace) -> Outcome:
    """Fig. 7: what complex light yields beside a fit to the table, and the truth."""
    measured = _measured(photographed("rh01-marschner", place))
    samples = _FEW_SAMPLES if place.quick else DEFAULT_SAMPLES
    result = process(load_photoset(photographed("rh01-teflon", place)), samples)
    truth = radiometric(RH01_MATERIALS["teflon"])
    found = {
        "complex light": result.solution.brdf,
        "fit to the table": measured.fit.brdf,
        "truth": Microfacet(truth.kd, truth.ks, truth.mu, truth.sigma),
    }
    cells = [_numbers(brdf, table_misfit(measured.table, brdf)) for brdf in found.values()]
    rows = [["parameter", "printed: complex light", "printed: fit to data", *found]]
    rows += [[name, *_PRINTED[name], *(cell[name] for cell in cells)] for name in _PRINTED]
    ours, fit, true = cells
    return Outcome(
        "mu 1.78 beside 1.85, sigma 0.12 beside 0.13",
        f"mu {ours['mu']} beside {fit['mu']}, sigma {ours['sigma (rad)']} beside {fit['sigma (rad)']}",
        f"Our sphere has the paper's numbers of the left column; RMS is that of the measured values. The true BRDF"
        f" leaves {true['RMS on the table']}: the table is of a lamp and a camera that are near, with noise.",
        table=rows,
    )


def _numbers(brdf: Microfacet, misfit: float) -> dict[str, str]:
    """The rows of the table, of the green channel."""
    kd, ks = brdf.kd[1], brdf.ks[1]
    assert brdf.mu is not None
    assert brdf.sigma is not None
    return {
        # The lobe's own part of what is reflected is left out, as in print.
        "albedo": f"{np.pi * kd:.4f}",
        "Kd / (Kd + Ks)": f"{kd / (kd + ks):.4f}",
        "Ks / (Kd + Ks)": f"{ks / (kd + ks):.4f}",
        "mu": f"{brdf.mu:.3f}",
        "sigma (rad)": f"{brdf.sigma:.4f}",
        "RMS on the table": f"{misfit:.1%}",
    }


@lru_cache(maxsize=1)
def _measured(folder: Path) -> Measured:
    """The table of Marschner's method, as `lightfactor brdf --method table` measures it."""
    seen = _observed(folder, None)
    sources = [single_source(seen.photoset, seen.lightings[photo.lighting]) for photo, _ in seen.fitted]
    return measure_under([field for _, field in seen.fitted], sources, seen.centre)


def _observed(folder: Path, samples: int | None) -> Observations:
    return observe(load_photoset(folder), samples)


def _harmonic(seen: Observations, order: int) -> HarmonicBRDF:
    """Coefficients under the set's light."""
    lights = {name: light_coefficients(light, order + FURTHER) for name, light in seen.lightings.items()}
    return estimate_harmonic(
        [field for _, field in seen.fitted], [lights[photo.lighting] for photo, _ in seen.fitted], order
    )
