"""lightfactor demo: the whole job on a synthetic gantry sequence."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def demo(
    out: Annotated[
        Path, typer.Option("-o", "--out", metavar="OUT", help="Folder for the photo set and the result.")
    ] = Path("lightfactor-demo"),
) -> None:
    """Photograph a synthetic teflon sphere on a gantry, process it, and print truth beside estimate.

    The photographs come from brute-force integration of the reflection integral over all light
    directions, with 1% noise: not from the formula that is then fitted.
    """
    from invrender.output.report.run import run_demo

    run_demo(out)
