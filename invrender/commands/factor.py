"""lightfactor factor: light and BRDF from the same photographs."""

from __future__ import annotations

from typing import Annotated

import typer

from capture.commands.options import Fresh, ResultOut, SetFolder


def factor(
    photoset: SetFolder,
    out: ResultOut,
    order: Annotated[
        str | None,
        typer.Option(
            metavar="DEGREES",
            help="Degrees of the light's spherical harmonics that are tried, 1 to 20, as 4,8,12; those above 10 as long"
            " as it takes the one before; the simplest that explains the photographs is taken.  [default: lamps in the"
            " dark, and 4,6,8,10,12,16]",
            show_default=False,
        ),
    ] = None,
    source_region: Annotated[
        str | None,
        typer.Option(
            metavar="AZIMUTH,ELEVATION,RADIUS",
            help="Where lamps may be: within so many degrees (0 to 180) of a direction in degrees, azimuth from +X"
            " towards +Y (-360 to 360), elevation above the horizon (-90 to 90).  [default:"
            " source_regions of the set's manifest, or anywhere]",
            show_default=False,
        ),
    ] = None,
    transfer: Annotated[
        str | None,
        typer.Option(
            metavar="TRANSFER",
            help="What the highlight does to the light: exact; filtered, blurred alike at all angles; mirror, nothing."
            "  [default: exact]",
            show_default=False,
        ),
    ] = None,
    ladder: Annotated[
        bool,
        typer.Option(
            "--ladder/--no-ladder",
            help="Whether simpler and richer models are tried as well; without it one microfacet model is fitted, with"
            " the highest of the degrees up to 10, which is several times faster.",
        ),
    ] = True,
    published: Annotated[
        bool,
        typer.Option(
            "--published",
            help="Solve as Ramamoorthi and Hanrahan (2001, section 6.3) did, to compare with: a mirror's light, sigma"
            " from the lamp's peak, no error bars. A sphere's light is a map; with --order 12 it is harmonics of that"
            " degree, of meshes too.",
        ),
    ] = False,
    samples: Annotated[
        int,
        typer.Option(
            help="Pixels of all photographs together that enter the fit, drawn evenly; 500 or more. Fewer are faster,"
            " with larger error bars."
        ),
    ] = 60_000,
    fresh: Fresh = False,
) -> None:
    """Recover light and BRDF of a sphere together, whatever the set says of the light; as RH01 did, of a mesh too.

    Light twice as bright on a surface half as bright gives the same photographs: Kd + Ks is 1 in each colour channel,
    and the light is in units of the photographs over that. All photographs must be under one lighting; held-out ones
    are predicted. mu is the refractive index, sigma the roughness in radians. Where the set knows its light, or a
    truth.json lies beside it, the columns "given" say what should have been found; nothing of it enters the fit.

    Writes what `process` writes, for `render` and `compare` too: OUT/result.json, report.html, predicted/, lighting.exr
    (the light without its lamps); and factor.png: look at it.
    """
    from capture.photoset import check_present

    check_present(photoset)
    from invrender.factor.choices import read_choices
    from invrender.factor.run import run_factor

    choices = read_choices(order, source_region, transfer, ladder, published, samples)
    run_factor(photoset, out, choices, fresh)
