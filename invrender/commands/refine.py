"""`lightfactor refine SET`: poses by what the photographs show, under known light."""

from __future__ import annotations

from typing import Annotated

import typer

from capture.commands.options import Fresh, SetFolder


def refine(
    photoset: SetFolder,
    turn_deg: Annotated[
        float,
        typer.Option(
            min=0.001,
            max=10,
            help="How far off the poses may be: standard deviation of a turn about each axis of the object, degrees.",
        ),
    ] = 1.0,
    shift_px: Annotated[
        float,
        typer.Option(min=0.01, max=50, help="The same of a shift of the object in the picture, pixels."),
    ] = 2.0,
    samples: Annotated[
        int, typer.Option(min=1000, help="As `process` has it, which is run several times; few will do.")
    ] = 20_000,
    fresh: Fresh = False,
) -> None:
    """Move each photograph's pose until the photograph looks as it is predicted from the others.

    For meshes under known light whose poses are off by a pixel or a few: textures blur, and lobes get wide. The set is
    processed, each pose is moved to where the prediction fits its photograph (those of a texture all together, whatever
    the texture then is), and so on by turns while photographs that were not fitted are predicted better. Where there
    are masks, the mesh's silhouette is drawn to their outlines as well. What a photograph doesn't determine of its pose
    stays as given. Poses of photographs that are held out are refined too.

    Writes SET/refined-poses.json, which the set uses once its manifest says poses = "refined-poses.json".
    """
    from invrender.refine.run import run_refine

    run_refine(photoset, samples, turn_deg, shift_px, fresh)
