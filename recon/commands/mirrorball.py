"""lightfactor mirrorball: the light off photographs of a mirror ball. Only typer is imported up here."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from capture.commands.options import Encoding, IntegerEncoding, ResponseFile, Times

if TYPE_CHECKING:
    from recon.mirrorball.result import Reading


class Exposure(StrEnum):
    """Where the exposure of a photograph comes from."""

    EQUAL = "equal"
    EXIF = "exif"


def mirrorball(
    photos: Annotated[list[Path], typer.Argument(metavar="PHOTO...", help="Photographs of the mirror ball.")],
    mask: Annotated[
        list[Path] | None,
        typer.Option(
            help="Image that is nonzero where the ball is: one for all views, or one for each, in order"
            " (repeat the option). Without it, --ball and --background, the ball must stand out bright from the"
            " background, or nearly all of its outline must show."
        ),
    ] = None,
    ball: Annotated[
        list[str] | None,
        typer.Option(
            metavar="X,Y,R",
            help="Column, row and radius of the ball in pixels, drawn by hand and refined here; one for all"
            " views, or one for each.",
        ),
    ] = None,
    background: Annotated[
        list[Path] | None,
        typer.Option(
            help="Photograph of the same view without the ball, to find the ball by; one for all views, or one"
            " for each."
        ),
    ] = None,
    bracket: Annotated[
        int,
        typer.Option(
            min=1,
            help="Photos that make up one view, differently exposed, in descending or ascending order: the first so"
            " many, then the next. Their exposures come from --times or EXIF.",
        ),
    ] = 1,
    times: Times = None,
    view_angle_deg: Annotated[
        str | None,
        typer.Option(
            metavar="DEGREES",
            help="Where a level camera stood for each view, about the vertical through the ball, counter-clockwise"
            " from above: 0,90 if it then stood to the right of the ball. All views are merged to one lighting.",
        ),
    ] = None,
    poses: Annotated[
        Path | None,
        typer.Option(
            help='JSON file {"world_to_camera": [4x4, ...]} with the camera\'s pose for each view (OpenCV axes),'
            " instead of --view-angle-deg. Rotations give the frame; places, in metres, tell how far near lamps are."
        ),
    ] = None,
    register: Annotated[
        bool,
        typer.Option(
            "--register",
            help="Merge the views by turning them until they show the same room, instead of --view-angle-deg.",
        ),
    ] = False,
    reflectance: Annotated[
        str,
        typer.Option(
            metavar="SHARE",
            help="The mirror's reflectance, or R,G,B: radiance is divided by it. Chrome 0.55 to 0.6, polished steel"
            " 0.6, silvered glass 0.9. At 1 all light is too dark by it.",
        ),
    ] = "1",
    camera_mask_deg: Annotated[
        float,
        typer.Option(
            min=0.0,
            max=90.0,
            help="Half-angle of the cone of directions that shows the camera and is left out of the maps;"
            " 0 leaves nothing out. Compact sources in it are kept.",
        ),
    ] = 10.0,
    camera: Annotated[
        Path | None,
        typer.Option(help="camera.json with the calibrated camera (COLMAP model, params, width, height)."),
    ] = None,
    focal_px: Annotated[
        float | None,
        typer.Option(
            min=1.0,
            help="Focal length in pixels, instead of --camera; no lens distortion."
            " With neither, the ball counts as far away (orthographic).",
        ),
    ] = None,
    encoding: IntegerEncoding = Encoding.LINEAR,
    response: ResponseFile = None,
    exposure: Annotated[
        Exposure,
        typer.Option(
            help="equal: all photos had one exposure. exif: divide each photo's exposure out. Brackets and --times"
            " need no such choice."
        ),
    ] = Exposure.EQUAL,
    height: Annotated[
        int, typer.Option(min=2, max=4096, help="Rows of the lat-long maps; columns are twice as many.")
    ] = 64,
    output: Annotated[
        Path,
        typer.Option(
            "-o", "--out", metavar="OUT", help="Folder for the results; an earlier result is replaced."
        ),
    ] = Path("lighting"),
) -> None:
    """Read the light off photographs of a mirror (chrome) ball.

    Each view gives the directions of compact sources, their irradiance, and a lat-long map of all other
    light. Directions are in the camera's frame, drawn upright: x right, y up, z towards the camera
    (world_to_camera = diag(1, -1, -1, 1)). In the maps, row 0 is +z and column 0 is +x, turning towards +y.

    Views are separate lightings, unless --view-angle-deg, --poses or --register says how the camera stood for
    each: then they are merged to one, in the frame of the first view (of the poses, with --poses), in which neither
    the camera nor what is behind the ball is missing.

    Writes VIEW.exr for each view, lighting.exr if they are merged, lighting.json (everything found), lighting.toml
    (tables to paste into a photoset.toml) and mirrorball.png (a picture to check it by).
    """
    from capture.files.outfolder import result_folder
    from capture.terminal import leave_cleanly_when_stopped
    from recon.mirrorball import photos as views
    from recon.mirrorball import result

    leave_cleanly_when_stopped()
    _one_of({"--camera": camera, "--focal-px": focal_px}, "the camera")
    _one_of(
        {"--view-angle-deg": view_angle_deg, "--poses": poses, "--register": register or None}, "the poses"
    )
    _one_of(
        {"--mask": mask or None, "--ball": ball or None, "--background": background or None},
        "the ball's place",
    )
    _one_of(
        {"--encoding": encoding if encoding is not Encoding.LINEAR else None, "--response": response},
        "what files hold",
    )
    setup = views.Setup(
        camera=camera,
        focal_px=focal_px,
        encoding=encoding.value,
        response=response,
        exposure=exposure.value,
        times=times,
        reflectance=views.read_reflectance(reflectance),
        camera_mask_deg=camera_mask_deg,
    )
    shots = views.group(photos, bracket, mask or [], ball or [], background or [])
    rotations = views.view_poses(len(shots), view_angle_deg, poses)
    with result_folder(output, result.OWN_FILES) as folder:
        reading: Reading = views.read(shots, setup, rotations, register, height)
        given = [path for path in (camera, poses, response) if path is not None]
        result.write(folder, reading, given)
    result.report(reading, output)


def _one_of(options: dict[str, object], what: str) -> None:
    """ValueError if more than one of some options is given. what : they all give, for the message."""
    given = [name for name, value in options.items() if value is not None]
    if len(given) > 1:
        raise ValueError(f"{given[0]} and {given[1]} both give {what}: remove one of them")
