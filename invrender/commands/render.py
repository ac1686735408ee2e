"""lightfactor render: new views and new light of a result."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from capture.commands.options import Assumptions, LightingName, SavedFolder, SourceSet


def render(
    result: SavedFolder,
    output: Annotated[
        Path,
        typer.Option(
            "-o",
            "--out",
            metavar="OUT",
            help="x.exr: linear RGB and alpha. x.png: sRGB and alpha. With --turntable x.mp4, x.png (a strip), or a"
            " folder.",
            show_default=False,
        ),
    ],
    lighting: LightingName = None,
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
    rotate_light: Annotated[
        float,
        typer.Option(
            "--rotate-light",
            metavar="DEG",
            help="Turn the light about +Z, counter-clockwise seen from above.",
            show_default=False,
        ),
    ] = 0.0,
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
        typer.Option(
            metavar="NAME", help="The camera of a photograph of the set, by its file's name, and its light."
        ),
    ] = None,
    photoset: SourceSet = None,
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
            help="N pictures all around, from --view on. As a folder OUT gets 000.exr, 000.png, ...",
        ),
    ] = None,
    turn: Annotated[
        str | None,
        typer.Option(
            metavar="WHAT",
            help="What goes round, the rest at rest: view (at the elevation of --view), light, or object.  [default:"
            " view]",
        ),
    ] = None,
    fps: Annotated[
        float | None, typer.Option(metavar="FPS", help="Of an .mp4: pictures per second.  [default: 25]")
    ] = None,
    radius: Annotated[
        float | None,
        typer.Option(
            metavar="M", help="A sphere of this radius instead, metres, where the result's object is."
        ),
    ] = None,
    mesh: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="A mesh instead of the result's object: PLY, OBJ, STL, GLB, in metres. It shadows itself (what"
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
    mean: Annotated[
        bool,
        typer.Option(
            "--mean", help="Where Kd and Ks vary over the result's object: render with their means instead."
        ),
    ] = False,
    exposure: Annotated[
        float | None,
        typer.Option(
            metavar="EV",
            help="Of PNG and MP4: radiance 1 is white at 0, each EV doubles; left out, the brightest half percent"
            " just clips.",
        ),
    ] = None,
    primaries: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Primaries that the picture is in, and that its file says: srgb, p3, rec2020, or of an .exr acescg."
            " PNG keeps sRGB's curve. Results count as linear sRGB, which they are of photographs with a color.json"
            " (`calibrate color`). Without it, numbers are written as they are, and no file says what they are.",
        ),
    ] = None,
    std: Annotated[
        bool,
        typer.Option(
            "--std",
            help="Also write the standard deviation of each pixel: channels std.R, std.G, std.B of the EXR.",
        ),
    ] = False,
    preview: Annotated[
        bool,
        typer.Option(
            "--preview",
            help="Quickly, by reflection maps (see `prefilter`): the light is filtered once, each pixel is a lookup."
            " One ray per pixel, no shadows, no light from one part of the object to another.",
        ),
    ] = False,
    tolerance: Annotated[
        float | None,
        typer.Option(
            metavar="PERCENT",
            help="Under a map, what the lobe reflects is integrated for few rays, and interpolated for the others to"
            " this RMS error, 0 to 10; what it left is measured and said. 0: an integral for each ray, several times as"
            " slow.  [default: 0.5]",
        ),
    ] = None,
    assume: Assumptions = None,
) -> None:
    """Predict what the object of a result looks like from other sides and under other light.

    Without --light or --source the light is the result's own. Radiance is in the unit of the light. Pixels at the
    outline are covered in part: alpha says how far, and radiance is multiplied by it, as EXR has it. PNG and MP4 are
    that radiance, exposed, clipped and through the sRGB curve, without any other tone mapping.

    --std carries the covariance of Kd, Ks, mu and sigma into the picture by first order. Not in it: doubts of the
    light, of the shape, and of the model itself, which report.html shows under "Where the model falls short".
    """
    from invrender.output.render.options import RenderOptions
    from invrender.output.render.run import run_render

    run_render(
        RenderOptions(
            result=result,
            out=output,
            lighting=lighting,
            light=light,
            panorama=panorama,
            sources=tuple(source or ()),
            rotate_light=rotate_light,
            view=view,
            photo=photo,
            photoset=photoset,
            size=size,
            fov_deg=fov,
            turntable=turntable,
            turn=turn,
            fps=fps,
            radius=radius,
            mesh=mesh,
            mesh_to_world=mesh_to_world,
            mean=mean,
            exposure_ev=exposure,
            primaries=primaries,
            std=std,
            preview=preview,
            tolerance=tolerance,
            assume=tuple(assume or ()),
        )
    )
