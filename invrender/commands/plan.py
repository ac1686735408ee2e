"""lightfactor plan: what photographs will determine, before anyone takes them, and which one more would help."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from synthetic.commands.synth import LightOfSet


def plan(
    scene: Annotated[
        str,
        typer.Argument(
            metavar="SCENE|RESULT",
            help="Name of a built-in scene (`lightfactor synth --list`), a scene file, NAME.toml, or a result of"
            " `process`, whose set one photograph more may join.",
            show_default=False,
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--out",
            metavar="FOLDER",
            help="Folder for plan.json and plan.png; an earlier plan in it is replaced. Without it only the terminal.",
            show_default=False,
        ),
    ] = None,
    light: Annotated[
        LightOfSet | None,
        typer.Option(
            help="What the set will give of the light, instead of what the scene file says: all, all with lamps as if"
            " they were distant, photographs of a mirror ball, or nothing. Of a result: all or nothing.",
            show_default=False,
        ),
    ] = None,
    photoset: Annotated[
        Path | None,
        typer.Option(
            "--set",
            metavar="SET",
            help="Folder of the photo set that a result was made from, where it isn't beside it.",
            show_default=False,
        ),
    ] = None,
    degree: Annotated[
        int, typer.Option(help="Highest degree of spherical harmonics of light that is unknown, 0 to 30.")
    ] = 10,
    samples: Annotated[
        int,
        typer.Option(
            help="Pixels of all photographs together that are looked at; their information is scaled to as many as"
            " `process` takes. More are slower and steadier."
        ),
    ] = 20_000,
) -> None:
    """See what photographs will determine, and how well, before you take them; and which one more would help most.

    Reckons from the scene's views, light, object and noise how certain Kd, Ks, mu, sigma and unknown light will be
    (Fisher information; no unbiased estimate is better), with the words that `process` uses afterwards; then tries a
    hundred further views and a hundred further lights. Nothing is rendered.

    Of a result it starts from the numbers and the light that were found, the set's cameras, the noise of its
    photographs and what the fit left unexplained.

    Writes FOLDER/plan.json and FOLDER/plan.png, a figure.
    """
    from invrender.plan.run import run_plan

    run_plan(scene, out, light.value if light else None, photoset, degree, samples)
