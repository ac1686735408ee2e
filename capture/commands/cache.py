"""lightfactor cache: what runs have kept, listed and removed."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def cache(
    photoset: Annotated[
        Path | None,
        typer.Argument(
            metavar="[SET]",
            help="Folder of a photo set, or its photoset.toml; without it, all sets.",
            show_default=False,
        ),
    ] = None,
    prune: Annotated[bool, typer.Option("--prune", help="Remove what would be listed.")] = False,
    older: Annotated[
        float, typer.Option(min=0, metavar="DAYS", help="Only what no run has used for so many days.")
    ] = 0.0,
) -> None:
    """List what runs have kept of photo sets, or remove it.

    `process` keeps what it makes of each photograph, so that a run that was stopped, or one after a photograph has
    changed, computes only what lacks. It lies in ~/.cache/lightfactor, or where LIGHTFACTOR_CACHE says. Every run
    removes what none has used for 30 days, and beyond 2 GB in all what was used least recently. What is removed is
    computed again when it is needed.
    """
    from capture.tasks.listing import run_cache

    run_cache(photoset, prune, older)
