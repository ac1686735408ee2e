"""lightfactor prefilter: reflection maps of a BRDF under a map of light."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from capture.commands.options import Assumptions, ResultOut


def prefilter(
    light: Annotated[
        Path,
        typer.Argument(
            metavar="MAP",
            help="The light: a lat-long map, EXR or .hdr, twice as wide as high, +Z at its top.",
            show_default=False,
        ),
    ],
    out: ResultOut,
    brdf: Annotated[
        str,
        typer.Option(
            metavar="RESULT|TABLE|NAME",
            help="The BRDF: a folder that `process` wrote, or its result.json; a measured one, Cornell's text (.brdf),"
            " MERL's binary (.binary), or the brdf.json of `brdf --method table`; or lambertian, phong:EXPONENT (R02,"
            " eq. 5.26), microfacet:SIGMA (radians; R02, eq. 5.34), skin (Lafortune's lobes), kajiya-kay:EXPONENT"
            " (fibres, about their tangent).",
            show_default=False,
        ),
    ],
    epsilon: Annotated[
        float,
        typer.Option(
            help="Share of a lobe's energy (integral of its square) that the maps may leave out; it chooses F and P."
        ),
    ] = 0.03,
    orders: Annotated[
        str | None,
        typer.Option(
            metavar="F,P",
            help="Highest degrees over mirrored directions and over views instead, of the narrowest lobe.",
            show_default=False,
        ),
    ] = None,
    rows: Annotated[
        int | None,
        typer.Option(help="Rows of the maps; 10 F, and 20 or more, if left out.", show_default=False),
    ] = None,
    view: Annotated[
        list[str] | None,
        typer.Option(
            metavar="AZIMUTH,ELEVATION",
            help="A distant viewer to write the explicit map for: degrees, from +X towards +Y and above the horizon."
            " Repeatable.  [default: 0,20]",
        ),
    ] = None,
    panorama: Annotated[
        bool,
        typer.Option(
            "--panorama",
            help="The map is a panorama as one sees it, left on the left; our maps are mirrored: azimuth grows to"
            " the right.",
        ),
    ] = False,
    assume: Assumptions = None,
) -> None:
    """Prefilter a map of light for a BRDF: what it reflects, for every mirrored direction and view, as a few maps.

    Spherical harmonic reflection maps (Ramamoorthi's thesis, chapter 5). Each lobe has its own, about the normal where
    it is diffuse, about the mirrored view where it is specular, about the tangent where it is a fibre's. Radiance is
    in the map's unit. With the maps goes how far they can be off: the RMS of what they leave out, and a bound that
    nothing exceeds.

    Writes OUT/prefilter.json (orders, coefficients, errors), per lobe LOBE-local.exr and LOBE-world.exr (the maps in
    the frame of the mirrored direction and in the world's), LOBE-view-1.exr, ... (the explicit map of each viewer),
    and prefilter.png (look at it).
    """
    from invrender.output.prefilter.run import PrefilterOptions, run_prefilter

    views = tuple(view or ("0,20",))
    run_prefilter(
        PrefilterOptions(light, out, brdf, epsilon, orders, rows, views, panorama, tuple(assume or ()))
    )
