"""`lightfactor align SET`: where the mesh stands in the photographs' world."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from capture.commands.options import Fresh, SetFolder


def align(
    photoset: SetFolder,
    picks: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="CSV of picked points, rows photo,u,v,x,y,z: a photo's file, column and row there in pixels (the first"
            " pixel's centre is 0.5, 0.5), and the point of the mesh that it shows, in the mesh file's unit. Four at"
            " least, not on a line; 8 or more let a wrong one be found.",
            show_default="[object] align of the manifest",
        ),
    ] = None,
    auto: Annotated[
        bool,
        typer.Option(
            "--auto", help="By the masks' outlines, and the cloud of points if there is one, alone."
        ),
    ] = False,
    free_scale: Annotated[
        bool,
        typer.Option(
            "--free-scale",
            help="Estimate the world's scale though poses are in metres; where they are relative it always is.",
        ),
    ] = False,
    fresh: Fresh = False,
) -> None:
    """Place the mesh in the photographs' world.

    Starts from picks, from mesh_to_world of the manifest, or from nothing (--auto: all orientations are tried), and
    then moves the mesh until its silhouettes lie on the masks' outlines. A start may be wrong by 10 degrees and 5% and
    more. The mesh is never mirrored, nor scaled: where poses are relative, the cameras' positions are scaled to its
    metres. Photos that are held out are not fitted to, but judged.

    Writes SET/alignment.json, which is read wherever the set is, unless the manifest itself gives mesh_to_world, and
    SET/alignment.png, the mesh's outline on the photographs.
    """
    from capture.terminal import leave_cleanly_when_stopped
    from recon.poses.align.run import run_align

    leave_cleanly_when_stopped()
    if picks is not None and auto:
        raise ValueError("--picks and --auto both say how to align: give one of them")
    run_align(photoset, picks, auto, free_scale, fresh)
