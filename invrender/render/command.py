"""lightfactor render: new views and new light of a result."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def render(
    result: Annotated[
        Path,
        typer.Argument(
            metavar="RESULT", help="Folder that `process` wrote, or its result.json.", show_default=False
        ),
    ],
    output: Annotated[
        Path,
        typer.Option(
            "-o",
            "--out",
            metavar="OUT",
            help="x.exr: linear RGB and alpha. x.png: sRGB and alpha. With --turntable a folder.",
            show_default=False,
        ),
    ],
    lighting: Annotated[
        str | None, typer.Option(metavar="NAME", help="Which of the result's lightings, if it has several.")
    ] = None,
    light: Annotated[
        Path | None,
        typer.Option(metavar="MAP", help="Other light: a lat-long map, EXR or .hdr, +Z at its top."),
    ] = None,
    panorama: Annotated[
        bool,
        typer.Option(
            "--panorama",
            help="The map is a panorama as one sees it, left on the left; our maps are mirrored: azimuth grows to"
            " the right.",
        ),
    ] = False,
    source: Annotated[
        list[str] | None,
        typer.Option(
            metavar="AZIMUTH,ELEVATION,IRRADIANCE",
            help="Other light: a distant source; degrees, the irradiance one number or R,G,B. Repeatable, and added"
            " to --light.",
        ),
    ] = None,
    view: Annotated[
        str | None,
        typer.Option(
            metavar="AZIMUTH,ELEVATION[,DISTANCE]",
            help="Where the camera is: degrees, from +X towards +Y and above the horizon; metres from the object's"
            " centre, by default as the photographs. It looks at the centre, +Z up.  [default: 0,20]",
        ),
    ] = None,
    photo: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="The camera of a photograph of the set, by its file's name."),
    ] = None,
    photoset: Annotated[
        Path | None,
        typer.Option(
            "--set",
            metavar="SET",
            help="The photo set that the result was made from; looked for beside the result otherwise.",
        ),
    ] = None,
    size: Annotated[
        str | None,
        typer.Option(metavar="WxH", help="Pixels, by default as the photographs; the field of view stays."),
    ] = None,
    fov: Annotated[
        float | None,
        typer.Option(metavar="DEG", help="Field of view across the width, by default as the photographs'."),
    ] = None,
    turntable: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=10_000,
            metavar="N",
            help="N views all around at the elevation of --view; the light stays. OUT gets 000.exr, 000.png, ...",
        ),
    ] = None,
    radius: Annotated[
        float | None,
        typer.Option(metavar="M", help="Another sphere's radius, metres; centre as in the result."),
    ] = None,
    mesh: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="A mesh instead of the sphere: PLY, OBJ, STL, GLB, in metres. It shadows itself (what"
            " that takes to compute is kept beside it, NAME.transfer.npz); light from one part of it to another is"
            " left out.",
        ),
    ] = None,
    mesh_to_world: Annotated[
        Path | None,
        typer.Option(
            metavar="JSON", help="Its place: a file with mesh_to_world (4x4), such as alignment.json."
        ),
    ] = None,
    exposure: Annotated[
        float | None,
        typer.Option(metavar="EV", help="Of PNG: radiance 1 is white at 0; automatic if left out."),
    ] = None,
    std: Annotated[
        bool,
        typer.Option(
            "--std",
            help="Also write the standard deviation of each pixel: channels std.R, std.G, std.B of the EXR.",
        ),
    ] = False,
    assume: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=VALUE",
            help="A guess for mu or sigma where the photographs left it undetermined. Repeatable.",
        ),
    ] = None,
) -> None:
    """Predict what the object of a result looks like from other sides and under other light.

    Without --light or --source the light is the result's own. Radiance is in the unit of the light. Pixels at the
    outline are covered in part: alpha says how far, and radiance is multiplied by it, as EXR has it.

    --std carries the covariance of Kd, Ks, mu and sigma into the picture by first order. Not in it: doubts of the
    light, of the shape, and of the model itself, which report.html shows under "Where the model falls short".
    """
    from invrender.render.run import RenderOptions, run_render

    run_render(
        RenderOptions(
            result=result,
            out=output,
            lighting=lighting,
            light=light,
            panorama=panorama,
            sources=tuple(source or ()),
            view=view,
            photo=photo,
            photoset=photoset,
            size=size,
            fov_deg=fov,
            turntable=turntable,
            radius=radius,
            mesh=mesh,
            mesh_to_world=mesh_to_world,
            exposure_ev=exposure,
            std=std,
            assume=tuple(assume or ()),
        )
    )
