"""`lightfactor board`: a calibration board to print."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

_KINDS = ("charuco", "chessboard")


def board(
    kind: Annotated[
        str,
        typer.Argument(
            metavar="charuco|chessboard",
            help="charuco: squares with markers in them, any part of which will do. chessboard: plain squares.",
            show_default=False,
        ),
    ],
    size: Annotated[
        str,
        typer.Argument(
            metavar="COLUMNSxROWS",
            help="Squares of a charuco board, inner corners of a chessboard, such as 7x5.",
            show_default=False,
        ),
    ],
    output: Annotated[
        Path, typer.Option("-o", "--out", metavar="OUT", help="The PDF to write.", show_default=False)
    ],
    square_mm: Annotated[float, typer.Option(help="Side of a square in millimetres.")] = 30.0,
    marker_mm: Annotated[
        float | None,
        typer.Option(
            help="Side of a charuco board's markers in millimetres; three quarters of the square's if not given."
        ),
    ] = None,
    dictionary: Annotated[
        str | None,
        typer.Option(help="OpenCV's dictionary of the markers; DICT_5X5_100 if not given."),
    ] = None,
    paper: Annotated[
        str, typer.Option(help="a4, a3, a2, a1, a0, letter, legal or tabloid; turned as the board needs.")
    ] = "a4",
) -> None:
    """Write a calibration board as a PDF, true to scale.

    Print it at 100 %, check the ruler beneath it, and glue it onto something flat and stiff. The text to pass to
    `lightfactor calibrate camera --board` stands beneath the board.
    """
    from difflib import get_close_matches

    from rich.markup import escape

    from capture.boards.board import parse_board
    from capture.boards.boardprint import board_figure
    from capture.files.outfolder import result_files
    from capture.terminal import console, leave_cleanly_when_stopped

    leave_cleanly_when_stopped()
    if kind not in _KINDS:
        near = get_close_matches(kind, _KINDS, n=1)
        hint = f"did you mean {near[0]!r}?" if near else f"say {' or '.join(_KINDS)}"
        raise ValueError(f"{kind!r} is no kind of board; {hint}")
    if output.suffix.lower() != ".pdf":
        raise ValueError(f"{output}: a board is written as PDF; give a name that ends in .pdf")
    parts = [kind, size, f"{square_mm / 1000:.7g}"]
    if kind == "chessboard":
        for option, value in (("--marker-mm", marker_mm), ("--dictionary", dictionary)):
            if value is not None:
                raise ValueError(
                    f"{option}: a chessboard has no markers; leave it out, or print a charuco board"
                )
    else:
        parts.append(f"{(0.75 * square_mm if marker_mm is None else marker_mm) / 1000:.7g}")
        parts += [dictionary] if dictionary is not None else []
    printed = parse_board(":".join(parts))
    figure = board_figure(printed, paper)
    with result_files(output) as folder:
        figure.savefig(
            folder / output.name, format="pdf", metadata={"Title": f"lightfactor board {printed.spec}"}
        )
    console.print(
        f"Wrote {escape(str(output))}: print at 100 %, and pass --board {escape(printed.spec)}",
        soft_wrap=True,
    )
