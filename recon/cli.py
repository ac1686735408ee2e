"""Commands of this package. Only typer is imported up here, so that `--help` is instant."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from collections.abc import Sequence

    from capture.camera import Camera
    from recon.ballfigure import Panel
    from recon.mirrorball import BallLighting

_FRAME = "x right, y up, z towards the camera"
# Share of all directions that may be saturated, sources apart, before it is worth a word.
_NOTABLE_CLIPPING = 0.001
_OWN_FILES = ("lighting.json", "lighting.toml", "mirrorball.png")


class Encoding(StrEnum):
    """How an integer file's values stand for light."""

    LINEAR = "linear"
    SRGB = "srgb"


class Exposure(StrEnum):
    """Where the exposure of a photograph comes from."""

    EQUAL = "equal"
    EXIF = "exif"


def mirrorball(
    photos: Annotated[list[Path], typer.Argument(metavar="PHOTO...", help="Photographs of the mirror ball.")],
    mask: Annotated[
        list[Path] | None,
        typer.Option(
            help="Image that is nonzero where the ball is: one for all photos, or one for each, in order"
            " (repeat the option). Without it the ball must stand out bright from the background."
        ),
    ] = None,
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
    encoding: Annotated[
        Encoding, typer.Option(help="What integer files hold; EXR, .hdr and float files are always linear.")
    ] = Encoding.LINEAR,
    exposure: Annotated[
        Exposure,
        typer.Option(help="equal: all photos had one exposure. exif: divide each photo's exposure out."),
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

    Each photo gives the directions of compact sources, their irradiance, and a lat-long map of all other
    light. Directions are in the camera's frame, drawn upright: x right, y up, z towards the camera
    (world_to_camera = diag(1, -1, -1, 1)). In the maps, row 0 is +z and column 0 is +x, turning towards +y.

    Writes PHOTO.exr for each photo, lighting.json (everything found), lighting.toml (tables to paste into a
    photoset.toml) and mirrorball.png (a picture to check it by).
    """
    from capture.outfolder import result_folder
    from capture.terminal import leave_cleanly_when_stopped, track

    leave_cleanly_when_stopped()
    if camera is not None and focal_px is not None:
        raise ValueError("--camera and --focal-px both give the camera: remove one of them")
    masks = _masks(photos, mask or [])
    stems = [photo.stem for photo in photos]
    for stem in stems:
        if stems.count(stem) > 1:
            raise ValueError(f"two photos are named {stem!r}, and so would their maps be: rename one of them")
    with result_folder(output, (*_OWN_FILES, "*.exr")) as folder:
        balls, cameras, panels = [], [], []
        for photo, its_mask in track(zip(photos, masks, strict=True), "Reading mirror balls"):
            ball, its_camera, drawn = _read(photo, its_mask, camera, focal_px, encoding, exposure, height)
            balls.append(ball)
            cameras.append(its_camera)
            panels.append(drawn)
        inputs = {*photos, *(path for path in masks if path is not None), *([camera] if camera else [])}
        _write(folder, photos, balls, cameras, panels, sorted(inputs))
    _report(balls, output)


def _masks(photos: Sequence[Path], masks: Sequence[Path]) -> list[Path | None]:
    """A mask for each photo."""
    if len(masks) not in (0, 1, len(photos)):
        raise ValueError(
            f"{len(masks)} masks for {len(photos)} photos: give one for all of them, or one for each"
        )
    if not masks:
        return [None] * len(photos)
    return [*masks] if len(masks) == len(photos) else [masks[0]] * len(photos)


def _read(
    photo: Path,
    mask: Path | None,
    camera_file: Path | None,
    focal_px: float | None,
    encoding: Encoding,
    exposure: Exposure,
    height: int,
) -> tuple[BallLighting, Camera, Panel]:
    import numpy as np

    from capture.camera import ORTHOGRAPHIC, Camera
    from capture.decode import check_size, decode, read_mask
    from capture.exposure import read_exif_exposure, relative_exposure
    from capture.manifest import CameraTable
    from capture.photoset import build_camera
    from recon.ballfigure import panel
    from recon.mirrorball import ball_lighting

    relative = 1.0
    if exposure is Exposure.EXIF:
        settings = read_exif_exposure(photo)
        if settings.exposure_s is None:
            raise ValueError(
                f"{photo}: its EXIF holds no exposure time; if all photos had one, use --exposure equal"
            )
        relative = relative_exposure(photo, "manual", settings)
    image = decode(photo, encoding.value, relative)
    rows, columns = size = image.saturated.shape
    upright = np.diag([1.0, -1.0, -1.0, 1.0])
    if camera_file is not None:
        camera = build_camera(camera_file, (CameraTable(file=camera_file.name),), upright, "--camera")
        check_size(photo, image.radiance, (camera.height, camera.width))
    elif focal_px is not None:
        params = np.array([focal_px, focal_px, columns / 2, rows / 2])
        camera = Camera("PINHOLE", params, columns, rows, upright)
    else:
        camera = Camera(ORTHOGRAPHIC, np.array([]), columns, rows, upright)
    ball = ball_lighting(image, read_mask(mask, size) if mask else None, camera, photo.name, height)
    return ball, camera, panel(ball, image, camera)


def _write(
    folder: Path,
    photos: Sequence[Path],
    balls: Sequence[BallLighting],
    cameras: Sequence[Camera],
    panels: Sequence[Panel],
    inputs: Sequence[Path],
) -> None:
    from capture.documents import write_json
    from capture.imagefile import write_exr
    from recon.ballfigure import MAX_PANELS, ball_figure

    for photo, ball in zip(photos, balls, strict=True):
        write_exr(folder / f"{photo.stem}.exr", ball.radiance_map)
    result = _result(photos, balls, cameras, inputs)
    write_json(folder / "lighting.json", result)
    (folder / "lighting.toml").write_text(_snippet(photos, balls), encoding="utf-8")
    ball_figure(panels[:MAX_PANELS], _FRAME).savefig(folder / "mirrorball.png")


def _result(
    photos: Sequence[Path], balls: Sequence[BallLighting], cameras: Sequence[Camera], inputs: Sequence[Path]
) -> dict[str, object]:
    from capture.documents import file_hash, software

    brightest = _brightest(balls)
    entries = []
    for photo, ball, camera in zip(photos, balls, cameras, strict=True):
        sources = [
            {
                "direction": source.direction.tolist(),
                "direction_std_deg": source.direction_std_deg,
                "angular_radius_deg": source.angular_radius_deg,
                "irradiance": source.irradiance.tolist(),
                "relative_irradiance": float(source.irradiance.mean()) / brightest,
                "clipped": source.clipped,
            }
            for source in ball.sources
        ]
        entries.append(
            {
                "photo": str(photo),
                "map": f"{photo.stem}.exr",
                "sources": sources,
                "uncovered_share": ball.uncovered_share,
                "clipped_share": ball.clipped_share,
                "ball_centre_px": camera.project(ball.sphere.centre[None])[0].tolist(),
                "ball_radius_px": ball.sphere.pixel_radius(camera),
                "outline_rms_px": ball.sphere.residual_px[0],
                "camera": {"model": camera.model, "params": camera.params.tolist()},
            }
        )
    return {
        "format": 1,
        "frame": _FRAME,
        "unit": "irradiance in the photographs' relative radiance times steradians",
        "photos": entries,
        "inputs": {str(path): file_hash(path) for path in inputs},
        "software": software(),
    }


def _snippet(photos: Sequence[Path], balls: Sequence[BallLighting]) -> str:
    """The balls' lightings as tables of a photoset.toml."""
    import json

    from recon.mirrorball import lighting_of_ball

    def vector(values: Sequence[float], digits: int) -> str:
        return "[" + ", ".join(f"{value:.{digits}g}" for value in values) + "]"

    lines = [
        "# Light read off mirror balls: paste these tables into a photoset.toml.",
        f"# World: {_FRAME}; if the photo set's is another, turn the directions and the maps.",
        "# Maps are named relative to the photoset.toml: copy them beside it, or write their path.",
    ]
    for photo, ball in zip(photos, balls, strict=True):
        lighting = lighting_of_ball(ball, None)
        # JSON's quoting of a string is TOML's as well.
        lines += ["", "[[lighting]]", f"name = {json.dumps(photo.stem)}"]
        if lighting.recovers:
            lines.append("# A highlight is clipped, so that its brightness is recovered in the fit.")
            lines.append(f"recover = {json.dumps(list(lighting.recovers))}")
        if lighting.radiance_map is not None:
            if ball.clipped_share > _NOTABLE_CLIPPING:
                lines.append(f"# Caution: {_clipping(ball)}.")
            lines.append(f"map = {json.dumps(photo.stem + '.exr')}")
        if ball.sources:
            lines.append("directional = [")
            for source in ball.sources:
                known = (
                    ""
                    if lighting.recover_irradiance
                    else f", irradiance = {vector(source.irradiance.tolist(), 5)}"
                )
                lines.append(f"    {{ direction = {vector(source.direction.tolist(), 6)}{known} }},")
            lines.append("]")
    return "\n".join(lines) + "\n"


def _report(balls: Sequence[BallLighting], output: Path) -> None:
    from rich.markup import escape
    from rich.table import Table

    from capture.terminal import console

    brightest = _brightest(balls)
    table = Table(box=None, header_style="bold")
    table.add_column("photo")
    table.add_column("source direction", justify="right")
    for heading in ("± deg", "irradiance", "clipped"):
        table.add_column(heading, justify="right")
    for ball in balls:
        if not ball.sources:
            table.add_row(escape(ball.name), "none: all light is in the map", "", "", "")
        for number, source in enumerate(ball.sources):
            table.add_row(
                escape(ball.name) if number == 0 else "",
                " ".join(f"{value:7.4f}" for value in source.direction),
                f"{source.direction_std_deg:.2f}",
                f"{'≥ ' if source.clipped else ''}{source.irradiance.mean() / brightest:.3f}",
                "yes" if source.clipped else "no",
            )
    console.print(table)
    console.print(f"Directions: {_FRAME}. Irradiance: relative to the brightest source of all photos.")
    if any(source.clipped for ball in balls for source in ball.sources):
        console.print(
            "A clipped source's irradiance is a lower bound. To measure it, expose the ball less,"
            " or have it recovered from the object's photographs, as lighting.toml does."
        )
    for ball in balls:
        if ball.clipped_share > _NOTABLE_CLIPPING:
            console.print(f"{escape(ball.name)}: {_clipping(ball)}; photograph the ball with less exposure.")
    console.print(f"Wrote {escape(str(output))}/: a map (.exr) per photo, {', '.join(_OWN_FILES)}")


def _clipping(ball: BallLighting) -> str:
    return f"the map is saturated over {ball.clipped_share:.1%} of all directions and too dark there"


def _brightest(balls: Sequence[BallLighting]) -> float:
    """The largest mean irradiance of any source; 1 where there is none."""
    return max((float(source.irradiance.mean()) for ball in balls for source in ball.sources), default=1.0)
