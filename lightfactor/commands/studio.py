"""lightfactor studio: the workbench in a browser."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def studio(
    path: Annotated[
        Path,
        typer.Argument(
            metavar="SET|RESULT",
            help="A photo set's folder (or its photoset.toml), or a result's.",
            show_default=False,
        ),
    ],
    port: Annotated[
        int | None,
        typer.Option(
            min=1, max=65535, help="Port on this machine.  [default: any that is free]", show_default=False
        ),
    ] = None,
    browser: Annotated[
        bool, typer.Option("--browser/--no-browser", help="Open the page in the browser.")
    ] = True,
) -> None:
    """Look at a capture, fit it, judge the fit and relight it, in the browser.

    Serves a page to this machine alone, and to who has the address that is printed: the part behind # is a key that is
    made anew at each start. Fits run as processes of their own, into SET/fit-1 and so on; a reload, a second tab or the
    end of this command loses nothing. SET/.studio holds thumbnails and logs, and may be deleted.

    Needs the extra packages of `pip install 'lightfactor[studio]'`.
    """
    from lightfactor.studio.serve import serve

    serve(path, port, browser)
