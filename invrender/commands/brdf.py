"""lightfactor brdf: reflectance without a formula, from photographs under known light."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

import typer

from capture.commands.options import ResultOut, SphereSet


class BRDFMethod(StrEnum):
    """How the BRDF is measured."""

    HARMONIC = "harmonic"
    TABLE = "table"


def brdf(
    photoset: SphereSet,
    out: ResultOut,
    method: Annotated[
        BRDFMethod,
        typer.Option(
            help="harmonic: coefficients of spherical harmonics, under any known light. table: value by value, under a"
            " single source in darkness; the parametric BRDF is then fitted to the table."
        ),
    ] = BRDFMethod.HARMONIC,
    order: Annotated[
        int,
        typer.Option(
            help="Highest degree of the harmonics, 0 to 16. Higher ones are sharper, and ring more."
        ),
    ] = 6,
    samples: Annotated[
        int | None,
        typer.Option(
            help="Pixels of all photographs together that are used; 0: every usable one.  [default: 60000; 0 of a"
            " table]",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Measure a sphere's BRDF without assuming a formula, under light that is known.

    Coefficients of harmonics come with their error bars, with which of them the light determines, and with how much
    they ring; RH01's Fig. 6. A table is the reference that image-based measurement gives, after Marschner; RH01's
    Fig. 7. Its bins are the finer the more pixels there are, and how near the source is, is found, too.
    `lightfactor process` recovers the parametric BRDF, which doesn't ring.

    Writes OUT/brdf.json and OUT/brdf.png, a figure.
    """
    if not 0 <= order <= 16:
        raise ValueError(f"--order is {order}; the highest degree must be 0 to 16")
    if samples is not None and samples < 0:
        raise ValueError(f"--samples is {samples}; it must be >= 0, 0 for every usable pixel")
    from invrender.inverse_brdf.run import SAMPLES, run_brdf

    run_brdf(
        photoset, out, method.value, order, (SAMPLES[method.value] if samples is None else samples) or None
    )
