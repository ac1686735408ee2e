"""lightfactor brdf: reflectance without a formula from photographs, or formulas fitted to a measured BRDF."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from capture.commands.options import Fresh, ResultOut

# Degrees of a brushed surface's harmonics: by default, and at most; coefficients go as the fourth power.
_ANISOTROPIC, _MOST_ANISOTROPIC = 3, 4


class BRDFMethod(StrEnum):
    """How the BRDF is measured."""

    HARMONIC = "harmonic"
    TABLE = "table"


def brdf(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="SET|TABLE",
            help="Folder of a photo set of a sphere, or its photoset.toml; or a measured BRDF: Cornell's text (.brdf),"
            " MERL's binary (.binary), or the brdf.json of --method table.",
            show_default=False,
        ),
    ],
    out: ResultOut,
    method: Annotated[
        BRDFMethod | None,
        typer.Option(
            help="Of a photo set. harmonic: coefficients of spherical harmonics, under any known light. table: value by"
            " value, under a single source in darkness; the parametric BRDF is then fitted to the table. "
            " [default: harmonic]",
            show_default=False,
        ),
    ] = None,
    order: Annotated[
        int | None,
        typer.Option(
            help="Highest degree of the harmonics, 0 to 16. Higher ones are sharper, and ring more.  [default: 6; 3, at"
            " most 4, with --anisotropic]",
            show_default=False,
        ),
    ] = None,
    anisotropic: Annotated[
        bool,
        typer.Option(
            "--anisotropic",
            help="Harmonics of a surface that is brushed along circles about +Z, or about brushed_about in [object].",
        ),
    ] = False,
    samples: Annotated[
        int | None,
        typer.Option(
            help="Pixels of all photographs together, or values of a measured BRDF, that are used; 0: every usable one."
            "  [default: 60000; 0 of --method table]",
            show_default=False,
        ),
    ] = None,
    fresh: Fresh = False,
) -> None:
    """Measure a sphere's BRDF without assuming a formula, or fit the formulas to a BRDF that was measured.

    Of photographs under known light: coefficients of harmonics come with their error bars, with which of them the light
    determines, and with how much they ring; RH01's Fig. 6. A table is the reference that image-based measurement gives,
    after Marschner; RH01's Fig. 7. Its bins are the finer the more pixels there are, and how near the source is, is
    found, too. `lightfactor process` recovers the parametric BRDF, which doesn't ring.

    Of a measured isotropic BRDF: the lobe is chosen among all that `process` knows, by how well each predicts angles of
    incidence that it has not seen; Kd, Ks, mu and sigma come with error bars and status. Light or sensor within 3
    degrees of the horizon is left out.

    Writes OUT/brdf.json and OUT/brdf.png, a figure.
    """
    if order is not None and not 0 <= order <= 16:
        raise ValueError(f"--order is {order}; the highest degree must be 0 to 16")
    if anisotropic and (method is BRDFMethod.TABLE or (order or 0) > _MOST_ANISOTROPIC):
        raise ValueError(
            f"--anisotropic is for harmonics of degree {_MOST_ANISOTROPIC} at most, which have 325 coefficients; leave"
            " out --method table, and give a lower --order"
        )
    if samples is not None and samples < 0:
        raise ValueError(f"--samples is {samples}; it must be >= 0, 0 for every usable one")
    from invrender.inverse_brdf.measured import SUFFIXES

    if source.suffix in SUFFIXES:
        if method is not None or order is not None or anisotropic:
            raise ValueError(
                f"{source} is a measured BRDF; --method and --order are for photo sets, as --anisotropic is: leave them"
                " out"
            )
        from invrender.inverse_brdf import measured_run

        measured_run.run_measured(source, out, (measured_run.SAMPLES if samples is None else samples) or None)
        return
    from invrender.inverse_brdf.run import SAMPLES, run_brdf

    chosen = method or BRDFMethod.HARMONIC
    run_brdf(
        source,
        out,
        chosen.value,
        (_ANISOTROPIC if anisotropic else 6) if order is None else order,
        (SAMPLES[chosen.value] if samples is None else samples) or None,
        anisotropic,
        fresh,
    )
