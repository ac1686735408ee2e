"""lightfactor compare: two results side by side, or a result beside the truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def compare(
    first: Annotated[
        Path,
        typer.Argument(
            metavar="A",
            help="Folder that `process` wrote, its result.json, or a truth.json.",
            show_default=False,
        ),
    ],
    second: Annotated[Path, typer.Argument(metavar="B", help="Likewise.", show_default=False)],
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--out",
            metavar="PAGE.html",
            help="Also a page with both predictions and both lightings.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Show two results side by side: each number with its standard deviation, their difference, and whether they agree.

    z is the difference B - A over both standard deviations combined, as of independent results; two numbers agree where
    it is at most 2. Where one result is in a relative gauge, Kd and Ks are compared by their shares of Kd + Ks, and
    lightings up to a factor per channel. Lightings: the difference of the first nine spherical-harmonic coefficients,
    relative to their mean, and the angles between sources. The truth, from `lightfactor synth`, counts as exact; of a
    textured object its Kd and Ks are means over the part of the surface that the result determines.
    """
    from invrender.output.compare.run import run_compare

    run_compare(first, second, output)
