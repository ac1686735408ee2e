"""lightfactor calibrate gantry: the arc of a gantry from photographs of a board."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from capture.commands.options import Photos

if TYPE_CHECKING:
    from collections.abc import Iterable

    import numpy as np
    from numpy.typing import NDArray

    from capture.arc.gantrycalibration import GantryCalibration


def gantry(
    photos: Photos,
    board: Annotated[
        str,
        typer.Option(
            help="The board that stands still: charuco:7x5:0.030:0.022 (squares, square and marker side in metres)"
            " or chessboard:9x6:0.025 (inner corners, square side in metres).",
            show_default=False,
        ),
    ],
    camera: Annotated[
        Path,
        typer.Option(
            help="camera.json of the camera, from 'lightfactor calibrate camera'.", show_default=False
        ),
    ],
    angles_deg: Annotated[
        str | None,
        typer.Option(
            metavar="DEGREES",
            help="Angles as the gantry shows them, one per photo in their order: 0,3,6. They set the arc's zero and"
            " sense; how far the gantry is from them is reported. Without it the first photo is at zero.",
        ),
    ] = None,
    output: Annotated[
        Path, typer.Option("-o", "--out", metavar="OUT", help="The calibration; an earlier one is replaced.")
    ] = Path("gantry.json"),
) -> None:
    """Find the arc that a camera travels along, from photographs of a board that stands still.

    Put the board where objects will stand, let the gantry take its positions (three or more, the wider the better),
    and photograph the board from each. Or let the board turn on a turntable before a fixed camera. The world of the
    result is the board's frame: origin at its first corner, x right and y up as printed, z out of its face.

    Writes OUT (name it in a photoset.toml: [gantry] file = "gantry.json") and a figure beside it.
    """
    import numpy as np

    from capture.arc.arcfigure import arc_figure
    from capture.arc.gantrycalibration import calibrate_gantry, gantry_document
    from capture.files.documents import input_hashes, software, write_json
    from capture.files.outfolder import result_files
    from capture.manifest import CameraTable
    from capture.photoset import build_camera
    from capture.terminal import leave_cleanly_when_stopped, track

    leave_cleanly_when_stopped()
    if output.suffix.lower() != ".json":
        raise ValueError(f"{output}: must end in .json")
    lens = build_camera(camera, (CameraTable(file=camera.name),), np.eye(4), "--camera")
    angles = None if angles_deg is None else [float(np.radians(angle)) for angle in _numbers(angles_deg)]
    inputs = [*photos, camera]
    with result_files(output, ["-figure.png"], inputs) as folder:
        found = calibrate_gantry(photos, board, lens, angles, *_errors_of(camera), track)
        document = gantry_document(found) | {"board": board}
        write_json(folder / output.name, document | {"inputs": input_hashes(inputs), "software": software()})
        arc_figure(found).savefig(folder / f"{output.stem}-figure.png")
    _report(found, output)


def _errors_of(camera: Path) -> tuple[NDArray[np.float64] | None, float | None]:
    """Covariance of the parameters and RMS in pixels that a camera.json states, None where it doesn't."""
    import json

    import numpy as np

    data = json.loads(camera.read_text(encoding="utf-8"))
    try:
        covariance = np.array(data["covariance"], float).reshape((len(data["params"]),) * 2)
        return covariance, float(data["rms_px"]["fitted"])
    except (KeyError, TypeError, ValueError):  # written by hand, or by another program
        return None, None


def _numbers(text: str) -> list[float]:
    try:
        return [float(part) for part in text.replace(",", " ").split()]
    except ValueError as error:
        raise ValueError(f"--angles-deg {text!r} is not a list of numbers such as 0,3,6") from error


def _report(found: GantryCalibration, output: Path) -> None:
    import numpy as np
    from rich.markup import escape
    from rich.table import Table

    from capture.terminal import console

    for sentence in found.left_out:
        console.print(f"Left out: {escape(sentence)}")
    fit = found.fit
    arc = fit.arc
    table = Table(box=None, show_header=False)
    step = "unequal: angles are in the file" if arc.step is None else f"{np.degrees(arc.step):.4f} deg"
    rows = [
        ("radius", f"{arc.radius * 1000:.2f} mm", f"{fit.radius_std * 1000:.2f} mm"),
        ("centre", _vector(arc.centre * 1000, 2) + " mm", _vector(fit.centre_std * 1000, 2) + " mm"),
        ("axis", _vector(arc.axis, 5), f"{np.degrees(fit.axis_std):.3f} deg"),
        ("start", _vector(arc.start, 5), f"{np.degrees(fit.start_std):.3f} deg"),
        ("step", step, "" if fit.step_std is None else f"{np.degrees(fit.step_std):.4f} deg"),
    ]
    for name, value, std in rows:
        table.add_row(name, value, f"± {std}" if std else "")
    console.print(table)
    on_arc, free = (np.sqrt(np.mean(rms**2)) for rms in (fit.rms_px, fit.free_rms_px))
    console.print(
        f"{len(found.names)} photos: corners lie {on_arc:.3f} px (RMS) from where the arc puts them;"
    )
    console.print(f"with a free pose for each photo they would lie {free:.3f} px off.")
    if found.deviation is not None:
        off = np.degrees(found.deviation)
        worst = int(np.argmax(np.abs(off)))
        console.print(
            f"The gantry's angles are {np.sqrt(np.mean(off**2)):.3f} degrees (RMS) off,"
            f" {escape(found.names[worst])} most: {off[worst]:+.3f}."
        )
    for warning in found.warnings:
        console.print(f"Warning: {escape(warning)}.")
    console.print(f"Wrote {escape(str(output))} and {escape(output.stem)}-figure.png")


def _vector(values: Iterable[float], digits: int) -> str:
    return " ".join(f"{value:.{digits}f}" for value in values)
