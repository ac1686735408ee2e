"""`lightfactor calibrate camera`: photographs of a board to a camera.json."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from capture.commands.options import Photos

if TYPE_CHECKING:
    from collections.abc import Sequence

    from capture.lens.intrinsics import CameraCalibration


def camera(
    photos: Photos,
    board: Annotated[
        str,
        typer.Option(
            metavar="BOARD",
            help="chessboard:9x6:0.025 (columns x rows of inner corners, square side in metres), or"
            " charuco:7x5:0.030:0.022:DICT_5X5_100 (columns x rows of squares, square and marker side in metres,"
            " dictionary).",
            show_default=False,
        ),
    ],
    output: Annotated[
        Path, typer.Option("-o", "--out", metavar="OUT", help="The JSON file to write.")
    ] = Path("camera.json"),
) -> None:
    """Calibrate a camera from photographs of a chessboard or charuco board.

    Take 10 to 20 photos with one focus and zoom: the board sharp and flat, tilted by 30 degrees or more in different
    directions, and in every corner of the picture; it may reach out of the picture. Writes the camera with its
    uncertainty, to be named in a photoset.toml as [camera] file = "camera.json", and beside it OUT-figure.png to check
    it by. Pixels count from the picture's corner: the centre of the first one is (0.5, 0.5).
    """
    from capture.boards.board import parse_board
    from capture.files.documents import write_json
    from capture.files.outfolder import result_files
    from capture.lens.intrinsics import calibrate_camera
    from capture.lens.intrinsicsfigure import intrinsics_figure
    from capture.terminal import leave_cleanly_when_stopped, track

    leave_cleanly_when_stopped()
    if output.suffix.lower() != ".json":
        raise ValueError(f"{output}: the camera is written as JSON; give a name that ends in .json")
    parsed = parse_board(board)
    with result_files(output, ("-figure.png",), photos) as folder:
        calibration = calibrate_camera(photos, parsed, lambda paths: track(paths, "Looking for the board"))
        write_json(folder / output.name, camera_document(calibration, photos))
        intrinsics_figure(calibration).savefig(folder / f"{output.stem}-figure.png")
    _report(calibration, output)


def camera_document(calibration: CameraCalibration, photos: Sequence[Path]) -> dict[str, Any]:
    """What a camera.json holds."""
    from capture.files.documents import input_hashes, software
    from capture.lens.lensladder import best_candidate

    best = best_candidate(calibration.ladder)
    ladder = []
    for candidate in calibration.ladder:
        excess = None if candidate.squares is None else candidate.excess(best)
        ladder.append(
            {
                "name": candidate.lens.name,
                "model": candidate.lens.model,
                "fitted_parameters": len(candidate.lens.fitted),
                "rms_px": None if candidate.fit is None else candidate.fit.rms,
                "held_out_rms_px": candidate.held_out_rms,
                "excess_px2": None if excess is None else excess[0],
                "excess_standard_error_px2": None if excess is None else excess[1],
                "fault": candidate.fault,
                "chosen": candidate.chosen,
            }
        )
    views = [
        {
            "photo": view.name,
            "corners": len(view.points),
            "rms_px": view.rms,
            "held_out_rms_px": view.held_out_rms,
            "dropped": view.dropped,
            "corners_dropped": view.corners_dropped,
        }
        for view in calibration.views
    ]
    return {
        "format": 1,
        "model": calibration.model,
        "params": calibration.params.tolist(),
        "param_names": list(calibration.param_names),
        "width": calibration.width,
        "height": calibration.height,
        "std": calibration.std.tolist(),
        "covariance": calibration.covariance.tolist(),
        "statistical_covariance": calibration.statistical_covariance.tolist(),
        "window_shifts": calibration.window_shifts.tolist(),
        "rms_px": {"fitted": calibration.rms, "held_out": calibration.held_out_rms},
        "coverage": {
            "hull_share": calibration.hull_share,
            "reach": calibration.reach,
            "tilt_spread_deg": calibration.spread_deg,
        },
        "board": calibration.board.spec,
        "views": views,
        "ladder": ladder,
        "warnings": list(calibration.warnings),
        "inputs": input_hashes(photos),
        "software": software(),
    }


def _ladder_table(calibration: CameraCalibration) -> Any:
    from rich.table import Table

    table = Table(box=None, header_style="bold")
    for heading in ("lens model", "fitted (px)", "held out (px)", ""):
        table.add_column(heading, justify="right" if "px" in heading else "left", no_wrap=True)
    for candidate in calibration.ladder:
        fitted = "" if candidate.fit is None else f"{candidate.fit.rms:.3f}"
        held_out = "" if candidate.held_out_rms is None else f"{candidate.held_out_rms:.3f}"
        table.add_row(
            candidate.lens.name, fitted, held_out, "chosen" if candidate.chosen else candidate.fault or ""
        )
    return table


def _report(calibration: CameraCalibration, output: Path) -> None:
    from rich.markup import escape
    from rich.table import Table

    from capture.terminal import console

    table = Table(box=None, header_style="bold")
    for heading in ("parameter", "value", "± std", "other corner windows"):
        table.add_column(heading, justify="left" if heading == "parameter" else "right")
    rows = zip(
        calibration.param_names,
        calibration.params,
        calibration.std,
        calibration.window_shifts.T,
        strict=True,
    )
    for name, value, std, shifts in rows:
        pixels = name.startswith(("f", "c"))
        if std == 0:
            table.add_row(name, "0", "not fitted", "")
            continue
        form = ".2f" if pixels else ".5f"
        unit = " (px)" if pixels else ""
        moved = " ".join(f"{shift:+{form}}" for shift in shifts)
        table.add_row(f"{name}{unit}", f"{value:{form}}", f"{std:{form}}", moved)
    console.print(table)
    console.print(_ladder_table(calibration))
    console.print(
        f"RMS {calibration.rms:.3f} px"
        f" fitted, {calibration.held_out_rms:.3f} px on photos left out; {len(calibration.used)} of"
        f" {len(calibration.views)} photos, {sum(len(view.points) for view in calibration.used)} corners.",
        soft_wrap=True,
    )
    for warning in calibration.warnings:
        end = "" if warning.endswith(("?", ".")) else "."
        console.print(f"Note: {escape(warning)}{end}", soft_wrap=True)
    figure = output.with_name(f"{output.stem}-figure.png")
    console.print(f"Wrote {escape(str(output))} and {escape(str(figure))}", soft_wrap=True)
