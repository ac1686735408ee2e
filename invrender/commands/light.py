"""lightfactor light: the light that fell on an object of known BRDF."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from capture.commands.options import Fresh, ResultOut, SphereSet


def light(
    photoset: SphereSet,
    out: ResultOut,
    brdf: Annotated[
        Path | None,
        typer.Option(
            metavar="RESULT",
            help="The object's BRDF: a result.json of `process`, a truth.json of `synth`, or the folder of one.",
            show_default=False,
        ),
    ] = None,
    kd: Annotated[
        str | None,
        typer.Option(help="Kd in 1/sr instead, one number or three, as 0.3,0.2,0.1.", show_default=False),
    ] = None,
    ks: Annotated[
        str | None, typer.Option(help="Ks, one number or three; 0 if left out.", show_default=False)
    ] = None,
    mu: Annotated[
        float | None,
        typer.Option(help="Refractive index; no Fresnel factor if left out.", show_default=False),
    ] = None,
    sigma: Annotated[float | None, typer.Option(help="Roughness in radians.", show_default=False)] = None,
    degree: Annotated[
        int | None,
        typer.Option(
            help="Highest degree of the light's spherical harmonics, 0 to 30; what the photographs determine if left"
            " out.",
            show_default=False,
        ),
    ] = None,
    rung: Annotated[
        str,
        typer.Option(
            help="What the highlight does to light: exact; filtered, blurred alike at all angles; mirror, nothing."
        ),
    ] = "exact",
    truth: Annotated[
        Path | None,
        typer.Option(
            metavar="MAP",
            help="Lat-long map (EXR, .hdr) of the true light, to compare with; by default what the set's photoset.toml,"
            " or a truth.json beside it, says.",
            show_default=False,
        ),
    ] = None,
    samples: Annotated[
        int, typer.Option(help="Pixels of all photographs together that enter, drawn evenly.")
    ] = 20_000,
    fresh: Fresh = False,
) -> None:
    """Recover the light on a sphere of known BRDF: as spherical harmonics, and as a map.

    Each lighting of the set is found from the photographs under it; held-out ones are predicted. The map comes from
    what the sphere mirrors once its diffuse part is taken off, and is the light as blurred by the highlight. Where the
    set knows its light, or a truth.json lies beside it, the columns "given" and "off" say what should have been found;
    nothing of it enters the fit.

    Writes OUT/lighting.json (coefficients and their standard deviations, null where undetermined), lighting-sh.exr,
    lighting-std.exr (its standard deviation), lighting-dual.exr, lighting-dual-std.exr, lighting.png (look at it).
    """
    from invrender.inverse_lighting.run import given_brdf, run_light

    run_light(photoset, out, given_brdf(brdf, kd, ks, mu, sigma), degree, rung, samples, truth, fresh)
