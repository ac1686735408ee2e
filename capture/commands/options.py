"""Options that several commands share, so that they read and mean the same everywhere."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Times = Annotated[
    str | None,
    typer.Option(
        metavar="SECONDS",
        help="Exposure times by hand, one per photo in their order: 1/60,1/15,0.25, or a text file of them."
        " Without it they are read from each file's EXIF (time, ISO and f-number).",
    ),
]
Photos = Annotated[list[Path], typer.Argument(metavar="IMAGES...", help="Photographs.", show_default=False)]
