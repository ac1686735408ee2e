"""lightfactor export: a result for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from capture.commands.options import Assumptions, LightingName, SavedFolder, SourceSet, check_useful


def export(
    result: SavedFolder,
    output: Annotated[
        Path,
        typer.Option(
            "-o",
            "--out",
            metavar="OUT",
            help="Folder for the files; an earlier export in it is replaced.",
            show_default=False,
        ),
    ],
    form: Annotated[
        str,
        typer.Option(
            "--format",
            metavar="FORMAT",
            help="gltf, mitsuba, materialx, openpbr or html.",
            show_default=False,
        ),
    ],
    light: Annotated[
        bool,
        typer.Option(
            "--light",
            help="gltf: the light, too. Sources go into the file, the map beside it as environment.exr. A scene for"
            " mitsuba always has its light.",
        ),
    ] = False,
    lighting: LightingName = None,
    albedo: Annotated[
        str | None,
        typer.Option(
            metavar="A",
            help="Of a result in a relative gauge: what pi Kd + Ks of the brightest channel is, or R,G,B."
            "  [default: 0.5]",
        ),
    ] = None,
    assume: Assumptions = None,
    view: Annotated[
        str | None,
        typer.Option(
            metavar="AZIMUTH,ELEVATION[,DISTANCE]",
            help="mitsuba, html: where the camera is; degrees, and metres from the object's centre.  [default: 0,20]",
        ),
    ] = None,
    photoset: SourceSet = None,
) -> None:
    """Write a result for other programs: the object, textures if there are any, and the material in their numbers.

    Each program has a formula of its own; its numbers are those that come nearest to the BRDF that was found. What is
    lost by that is printed, and stands with the numbers in OUT/export.json.

    gltf: object.glb, metres, +Y up. mitsuba: scene.xml, with light and camera. materialx: material.mtlx, with a
    standard_surface, and object.obj. openpbr: the same with an open_pbr_surface.
    html: object.html, one page that shows the object under light that you turn, without a server or a network. It has
    the result's own material; how far its pictures are off from `lightfactor render` is printed and stands on it.

    Of a result of normals without a mesh gltf, materialx and openpbr are a flat panel with a normal map.
    """
    from invrender.result.saved import result_kind

    if result_kind(result) is not None:
        from invrender.photometric_stereo.panel import run_panel

        given = {
            "--light": light,
            "--lighting": lighting is not None,
            "--albedo": albedo is not None,
            "--assume": bool(assume),
            "--view": view is not None,
            "--set": photoset is not None,
        }
        check_useful(given, "a result of normals, which is exported as a panel")
        run_panel(result, output, form)
        return
    from invrender.output.export.run import ExportOptions, run_export

    run_export(
        ExportOptions(
            result=result,
            out=output,
            form=form,
            light=light,
            lighting=lighting,
            albedo=albedo,
            assume=tuple(assume or ()),
            view=view,
            photoset=photoset,
        )
    )
