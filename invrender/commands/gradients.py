"""lightfactor gradients: what makes the gradients of the predicted photographs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from capture.commands.options import Assumptions, ResultOut, SourceSet


def gradients(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="SET|RESULT",
            help="A result: the folder that `process` wrote, or its result.json; or a photo set, which is processed"
            " first, into OUT/result.",
            show_default=False,
        ),
    ],
    out: ResultOut,
    photo: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="A photograph of the set, by its file's name. Repeatable.  [default: all of them]",
            show_default=False,
        ),
    ] = None,
    photoset: SourceSet = None,
    pixels: Annotated[
        int,
        typer.Option(
            min=100, help="About so many pixels around the object, of each photograph; more take longer."
        ),
    ] = 20_000,
    assume: Assumptions = None,
) -> None:
    """Split the gradient of each predicted photograph into what makes it: light, curvature, texture, visibility.

    Terms as in Ramamoorthi, Mahajan and Belhumeur (2007), in radiance per pixel of the photograph, to the right and
    down: spatial (a lamp nearby looks different from point to point), curvature (the normal turns), perspective (the
    view turns), texture (Kd and Ks vary), visibility (the object's shadow on itself), and a remainder that isn't of
    first order. Beside them 1 / d against 2 k: the distance d of a lamp against the curvature k. Light counts as near
    where 1 / d is a hundredth of 2 k or more.

    Writes OUT/gradients.json (strength and share of each term), and per photograph NAME.exr (the terms as layers) and
    NAME.png (look at it). Of a SET these are in OUT/gradients.
    """
    from invrender.output.gradients.run import GradientsOptions, run_gradients

    run_gradients(GradientsOptions(source, out, tuple(photo or ()), photoset, pixels, tuple(assume or ())))
