"""lightfactor process: a photo set in, BRDF with error bars and a report out."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

DEFAULT_SAMPLES = 60_000


def process(
    photoset: Annotated[
        Path,
        typer.Argument(
            metavar="SET", help="Folder of a photo set, or its photoset.toml.", show_default=False
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(
            "-o",
            "--out",
            metavar="OUT",
            help="Result folder; an earlier result in it is replaced.",
            show_default=False,
        ),
    ],
    samples: Annotated[
        int,
        typer.Option(
            min=1000,
            help="Pixels of all photographs together that enter the fit, drawn evenly; fewer are faster, with"
            " larger error bars.",
        ),
    ] = DEFAULT_SAMPLES,
) -> None:
    """Recover BRDF and error bars, and the lighting where it is unknown, from a photo set of a sphere or a mesh.

    Writes OUT/result.json (every number with its standard deviation), OUT/report.html (open it in a
    browser), OUT/predicted/ (EXR) and the lighting as used. Kd is in 1/sr, so the albedo is pi Kd; sigma is
    in radians.
    """
    from invrender.output.report.run import run_process

    run_process(photoset, out, samples)
