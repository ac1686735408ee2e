"""Options that several commands share, so that they read and mean the same everywhere."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from capture.decode import Encoding as DecodeEncoding


class Encoding(StrEnum):
    """How an integer file's values stand for light."""

    LINEAR = "linear"
    SRGB = "srgb"


Times = Annotated[
    str | None,
    typer.Option(
        metavar="SECONDS",
        help="Exposure times by hand, one per photo in their order: 1/60,1/15,0.25, or a text file of them."
        " Without it they are read from each file's EXIF (time, ISO and f-number).",
    ),
]
IntegerEncoding = Annotated[
    Encoding, typer.Option(help="What integer files hold; RAW, EXR and .hdr are always linear.")
]
ResponseFile = Annotated[
    Path | None,
    typer.Option(
        help="response.json of the camera, from 'lightfactor calibrate response', instead of --encoding."
    ),
]
Photos = Annotated[list[Path], typer.Argument(metavar="IMAGES...", help="Photographs.", show_default=False)]
SetFolder = Annotated[
    Path,
    typer.Argument(metavar="SET", help="Folder of a photo set, or its photoset.toml.", show_default=False),
]
SphereSet = Annotated[
    Path,
    typer.Argument(
        metavar="SET", help="Folder of a photo set of a sphere, or its photoset.toml.", show_default=False
    ),
]
SourceSet = Annotated[
    Path | None,
    typer.Option(
        "--set",
        metavar="SET",
        help="The photo set that the result was made from; looked for beside the result otherwise.",
    ),
]
SavedFolder = Annotated[
    Path,
    typer.Argument(
        metavar="RESULT", help="Folder that `process` wrote, or its result.json.", show_default=False
    ),
]
LightingName = Annotated[
    str | None, typer.Option(metavar="NAME", help="Which of the result's lightings, if it has several.")
]
Assumptions = Annotated[
    list[str] | None,
    typer.Option(
        metavar="NAME=VALUE",
        help="A guess for mu or sigma where the photographs left it undetermined. Repeatable.",
    ),
]
ResultOut = Annotated[
    Path,
    typer.Option(
        "-o",
        "--out",
        metavar="OUT",
        help="Result folder; an earlier result in it is replaced.",
        show_default=False,
    ),
]
Workers = Annotated[
    int | None,
    typer.Option(
        min=1,
        metavar="N",
        help="Processes on this machine that the work is spread over, photograph by photograph, instead of threads: one"
        " that is killed, for memory or by a file that a library fails on, takes only its photograph with it.",
    ),
]
ClusterAddress = Annotated[
    str | None,
    typer.Option(
        "--cluster",
        metavar="ADDRESS",
        help="Dask scheduler whose workers the work is spread over, tcp://HOST:8786; needs 'lightfactor[cluster]' and a"
        " folder that all see, named by LIGHTFACTOR_CACHE.",
    ),
]
Fresh = Annotated[
    bool,
    typer.Option(
        "--fresh", help="Compute all anew, whatever earlier runs kept (`lightfactor cache` lists it)."
    ),
]
JsonOut = Annotated[
    Path,
    typer.Option("-o", "--out", metavar="OUT", help="JSON file to write; an earlier one is replaced."),
]


def encoding_of(encoding: Encoding, response: Path | None) -> DecodeEncoding:
    """What --encoding and --response say together, as `capture.decode.decode` takes it."""
    if response is not None:
        from capture.bracket.response import read_response

        return read_response(response)
    return encoding.value


def check_useful(given: Mapping[str, bool], what: str) -> None:
    """ValueError for the first option that is given, where it does nothing of what the command is about."""
    for name, is_given in given.items():
        if is_given:
            raise ValueError(f"{name} does nothing for {what}; leave it out")
