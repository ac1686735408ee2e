"""`lightfactor register SET`: where the photographs of a set were taken from."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from capture.commands.options import Fresh, SetFolder

if TYPE_CHECKING:
    from recon.poses.register.posesfile import Registration

_CLOUD = "-points.ply"
_FIGURE = ".png"


def register(
    photoset: SetFolder,
    board: Annotated[
        str | None,
        typer.Option(
            metavar="BOARD",
            help="A board in the photos, at rest beside the object: charuco:7x5:0.030:0.022 (squares, square and marker"
            " side in metres) or chessboard:9x6:0.025 (inner corners, square side). It becomes the world: origin at"
            " its first corner, x right and y up as printed, z out of its face.",
        ),
    ] = None,
    colmap: Annotated[
        Path | None,
        typer.Option(
            metavar="MODEL", help="Take the poses of a COLMAP model (folder with cameras, images, points3D)."
        ),
    ] = None,
    transforms: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Take the poses of a transforms.json (instant-ngp, nerfstudio, Blender: OpenGL's axes).",
        ),
    ] = None,
    masked: Annotated[
        bool | None,
        typer.Option(
            "--masked/--whole-image",
            help="Where features count: within the masks, for an object that turned before a backdrop at rest; or in"
            " the whole image, where everything in it stood still or moved with the object. Default: within the masks"
            " if every photo has one.",
            show_default=False,
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--out", metavar="OUT", help="The poses.", show_default="SET/poses.json"),
    ] = None,
    fresh: Fresh = False,
) -> None:
    """Find where the photographs of a set were taken from.

    By features (structure from motion) with the manifest's cameras as they are; or by a board that is in all photos;
    or from another program's files. Place and size of the world come from the board, or from photos whose pose the
    manifest gives (gantry_angle_deg, world_to_camera: two or more); otherwise they are relative until `lightfactor
    align` places the mesh.

    Writes OUT, which a manifest beside it reads where its photos have no pose, a cloud of points (OUT-points.ply), and
    a figure to judge it by (OUT.png).
    """
    from rich.markup import escape

    from capture.boards.board import parse_board
    from capture.files.documents import input_hashes, software, write_json
    from capture.files.outfolder import result_files
    from capture.found import POSES_NAME
    from capture.photoset import load_photoset
    from capture.tasks.stage import kept_result
    from capture.tasks.workplace import opened_workplace
    from capture.terminal import console, leave_cleanly_when_stopped, track
    from recon.poses.register.importing import register_by_colmap, register_by_transforms
    from recon.poses.register.posefigure import pose_figure
    from recon.poses.register.posesfile import poses_document, write_cloud
    from recon.poses.register.registration import masks_of, register_by_features

    leave_cleanly_when_stopped()
    given = [
        name
        for name, value in (("--board", board), ("--colmap", colmap), ("--transforms", transforms))
        if value is not None
    ]
    if len(given) > 1:
        raise ValueError(f"{given[0]} and {given[1]} both say where poses come from: give one of them")
    if masked is not None and (colmap or transforms):
        raise ValueError(f"--masked and --whole-image are for features, not for {given[0]}")
    photos = load_photoset(photoset, find_poses=True)
    if masked and not masks_of(photos):
        bare = next(photo.label for photo in photos.photos if photo.mask is None)
        raise ValueError(f"{photos.manifest}: --masked needs a mask for every photo, and {bare} has none")
    parsed = None if board is None else parse_board(board)
    output = photos.folder / POSES_NAME if output is None else output
    if output.suffix.lower() != ".json":
        raise ValueError(f"{output}: must end in .json")
    inputs = [photos.manifest, *photos.calibration_files]
    workplace = opened_workplace(photos.manifest, fresh=fresh)
    with result_files(output, [_CLOUD, _FIGURE], inputs) as folder, workplace:
        if colmap is not None:
            inputs += sorted(path for path in colmap.glob("*") if path.suffix in (".bin", ".txt"))
            found = register_by_colmap(photos, colmap)
        elif transforms is not None:
            inputs.append(transforms)
            found = register_by_transforms(photos, transforms)
        else:
            inputs += [photo.file for photo in photos.photos]
            work = folder / "work"
            work.mkdir()
            within = masks_of(photos) if masked is None else masked
            if within:
                inputs += [photo.mask for photo in photos.photos if photo.mask is not None]
            register_all = partial(register_by_features, photos, work, within, parsed, track)
            found = kept_result("poses", register_all, (photos, within, parsed))
        cloud = output.stem + _CLOUD
        document = poses_document(found, cloud if len(found.points) else None)
        write_json(folder / output.name, document | {"inputs": input_hashes(inputs), "software": software()})
        write_cloud(folder / cloud, found.points, found.colours)
        pose_figure(found).savefig(folder / (output.stem + _FIGURE))
    _report(found, output)
    beside = output.name == POSES_NAME and output.parent.resolve() == photos.folder.resolve()
    if not beside or all(photo.posed for photo in photos.photos):
        console.print(
            f'To use it, write poses = "{escape(output.name)}" at the top of {escape(str(photos.manifest))}.',
            soft_wrap=True,
        )


def _report(found: Registration, output: Path) -> None:
    import numpy as np
    from rich.markup import escape
    from rich.table import Table

    from capture.terminal import console

    unit = "m" if found.metric else "relative"
    table = Table(box=None, header_style="bold")
    for heading in ("photo", "features", "RMS (px)", "± degrees", f"± position ({unit})"):
        table.add_column(heading, justify="left" if heading == "photo" else "right")
    stds = found.stds
    for row, label in enumerate(found.labels):
        table.add_row(
            escape(label),
            "" if found.observations is None else str(found.observations[row]),
            "" if found.rms_px is None else f"{found.rms_px[row]:.2f}",
            "" if stds is None else f"{np.degrees(stds[row, 0]):.3f}",
            "" if stds is None else f"{stds[row, 1]:.2g}",
        )
    console.print(table)
    for name, why in found.unregistered.items():
        console.print(f"No pose: {escape(name)}: {escape(why)}", soft_wrap=True)
    total = len(found.names) + len(found.unregistered)
    words = {
        "board": "the board's frame, in metres",
        "gantry": "the gantry's frame, in metres",
        "poses": "the frame of the manifest's own poses, in metres",
        "free": "a frame of their own, in relative units: `lightfactor align` sets place and size by the mesh",
    }
    console.print(
        f"{len(found.names)} of {total} photos placed, in {words[found.scale_from]}.", soft_wrap=True
    )
    for warning in found.warnings:
        end = "" if warning.endswith((".", "?")) else "."
        console.print(f"Warning: {escape(warning)}{end}", soft_wrap=True)
    files = [output, output.with_name(output.stem + _CLOUD), output.with_name(output.stem + _FIGURE)]
    console.print(f"Wrote {', '.join(escape(str(path)) for path in files)}", soft_wrap=True)
