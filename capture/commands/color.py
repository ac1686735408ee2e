"""lightfactor calibrate color: linear sRGB of a camera's colours from photographs of a colour chart."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from capture.commands.options import Encoding, IntegerEncoding, JsonOut, Photos, ResponseFile, encoding_of

if TYPE_CHECKING:
    from capture.chart.colorrecovery import ColorRecovery

_FIGURE = "-figure.png"


def color(
    images: Photos,
    chart: Annotated[
        str,
        typer.Option(
            metavar="CHART",
            help="MCC24, the ColorChecker Classic made since November 2014; MCC24-2005, made before; SG140, the Digital"
            " SG; or FILE.csv, your own chart laid out like one of these: a line of headings, then a line per patch in"
            " the chart's order, with name, L, a, b (CIE, D50), or name and reflectances under headings in nm.",
        ),
    ] = "MCC24",
    encoding: IntegerEncoding = Encoding.LINEAR,
    response: ResponseFile = None,
    flat_field: Annotated[
        Path | None,
        typer.Option(help="flatfield.json of the lens, from 'lightfactor calibrate flatfield'."),
    ] = None,
    output: JsonOut = Path("color.json"),
) -> None:
    """Measure a camera's colours: the matrix from its linear RGB to linear sRGB (and to XYZ), with a covariance.

    Photograph a chart, upright, in the light of the photographs to be corrected and in the middle of the picture;
    RAW, its white not cut off. One photograph will do; more average over light and place. Write color = "color.json"
    into a set's [radiometry] to use it: white is balanced for the chart's light then, and error bars hold the matrix's.

    Writes OUT (matrix, residuals as CIEDE2000, glare, linearity) and OUT's name with -figure.png.
    """
    from capture.chart.colorfigure import color_figure
    from capture.chart.colorrecovery import color_document, recover_color
    from capture.files.documents import input_hashes, software, write_json
    from capture.files.outfolder import result_files
    from capture.sensor.flatfield import read_flat_field
    from capture.terminal import leave_cleanly_when_stopped, track

    leave_cleanly_when_stopped()
    given = [path for path in (response, flat_field) if path is not None]
    own = [Path(chart)] if chart.lower().endswith(".csv") else []
    inputs = [*images, *given, *own]
    with result_files(output, (_FIGURE,), inputs) as folder:
        recovery = recover_color(
            track(images, "Finding the chart"),
            chart,
            encoding_of(encoding, response),
            None if flat_field is None else read_flat_field(flat_field),
        )
        document = {**color_document(recovery), "inputs": input_hashes(inputs), "software": software()}
        write_json(folder / output.name, document)
        color_figure(recovery).savefig(folder / (output.stem + _FIGURE))
    _report(recovery, output)


def _report(recovery: ColorRecovery, output: Path) -> None:
    import numpy as np
    from rich.markup import escape
    from rich.table import Table

    from capture.radiance import CHANNELS
    from capture.terminal import console

    fit, off = recovery.fit, recovery.delta_e
    std = np.sqrt(np.diag(fit.covariance)).reshape(3, 3)
    table = Table(title="Linear sRGB of camera RGB", title_justify="left", box=None, header_style="bold")
    table.add_column("")
    for name in CHANNELS:
        table.add_column(f"x {name}", justify="right")
    for name, row, its_std in zip(CHANNELS, fit.matrix, std, strict=True):
        table.add_row(
            name, *(f"{value:.3f} ± {error:.3f}" for value, error in zip(row, its_std, strict=True))
        )
    console.print(table)
    worst = np.unravel_index(int(off.argmax()), off.shape)
    console.print(
        f"Patches differ from {escape(recovery.named)} by {off.mean():.2f} in the mean (CIEDE2000; 1 is just visible),"
        f" by {off.max():.2f} at most ({recovery.chart.names[worst[1]]}).",
        soft_wrap=True,
    )
    console.print(
        f"The camera's numbers to the power of {fit.exponent:.3f} ± {fit.exponent_std:.3f} would be linear.",
        soft_wrap=True,
    )
    for photo, glare, its_std in zip(recovery.photos, fit.glare, fit.glare_std, strict=True):
        console.print(
            f"{escape(photo.path.name)}: glare {glare.mean():.2%} ± {its_std.mean():.2%} of white.",
            soft_wrap=True,
        )
    for warning in recovery.warnings:
        console.print(f"Warning: {escape(warning)}.", style="yellow", soft_wrap=True)
    console.print(f"Wrote {escape(str(output))} and {escape(output.stem + _FIGURE)} beside it")
