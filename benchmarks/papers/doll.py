"""RH01's fig. 15: a painted doll, whose texture is recovered under complex light."""

from __future__ import annotations

from matplotlib.figure import Figure

from benchmarks.papers.entry import Outcome, Workplace
from benchmarks.papers.pictures import draw_difference, draw_photograph, draw_rendering
from benchmarks.papers.sets import photographed
from capture.photoset import load_photoset
from invrender.process.pipeline import process


def texture(place: Workplace) -> Outcome:
    """Fig. 15: photographs and renderings, under the light of the fit and under a single source."""
    seen = list(process(load_photoset(photographed("rh01-doll", place))).predictions())
    figure = Figure(figsize=(9, 7), layout="constrained")
    off = []
    shown = {"complex light": seen[len(seen) // 2], "a single source": seen[-1]}
    for row, (light, one) in zip(figure.subplots(2, 3), shown.items(), strict=True):
        draw_photograph(row[0], one, f"photograph, {light}")
        off.append(draw_rendering(row[1], one, "rendering"))
        draw_difference(row[2], one, "difference")
    return Outcome(
        "renderings closely resemble photographs",
        f"off by {off[0]:.1%} of white, and by {off[1]:.1%} under another lamp (RMS)",
        "Kd and Ks are found for each point of the surface; the second row is under a lamp that lit none of the fitted"
        " photographs. What is off lies at the texture's edges. Points that too few photographs determine stay black.",
        place.save(figure, "rh01-fig15"),
    )
