"""lightfactor calibrate response: the response curve of a camera from a bracket of exposures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from capture.commands.options import JsonOut, Photos, Times

if TYPE_CHECKING:
    from capture.bracket.responserecovery import Recovery

_FIGURE = "-figure.png"


def response(
    images: Photos,
    times: Times = None,
    output: JsonOut = Path("response.json"),
) -> None:
    """Recover the response of a camera: which exposure each value of its 8- or 16-bit files stands for.

    Photograph one static scene with dark and bright parts two or more times from a tripod, changing nothing but the
    exposure time, a stop or two from one to the next; the order of the photographs doesn't matter. Two methods are
    tried (Debevec and Malik 1997, Mitsunaga and Nayar 1999), and the one is taken that predicts parts of the
    pictures better which it hasn't seen.

    Writes OUT (per channel the natural logarithm of the exposure at 256 values, 1024 for 16-bit files, with
    standard deviations, and the exposures that the pictures speak for) and OUT's name with -figure.png.
    """
    from capture.bracket.responsefigure import response_figure
    from capture.bracket.responserecovery import recover_response, recovery_document
    from capture.exposure import bracket_exposures, read_times
    from capture.files.documents import input_hashes, software, write_json
    from capture.files.outfolder import result_files
    from capture.terminal import leave_cleanly_when_stopped

    leave_cleanly_when_stopped()
    with result_files(output, (_FIGURE,), images) as folder:
        exposures = bracket_exposures(images, read_times(times) if times else None)
        recovery = recover_response(images, exposures)
        document = {
            **recovery_document(recovery, images),
            "inputs": input_hashes(images),
            "software": software(),
        }
        write_json(folder / output.name, document)
        names = [path.name for path in images]
        response_figure(recovery, names).savefig(folder / (output.stem + _FIGURE))
    _report(recovery, images, output)


def _report(recovery: Recovery, images: list[Path], output: Path) -> None:
    from rich.markup import escape
    from rich.table import Table

    from capture.bracket.responserecovery import believed_steps
    from capture.radiance import CHANNELS
    from capture.terminal import console

    for place, method in enumerate(recovery.methods):
        console.print(
            f"{method.name} ({method.detail}): predicts values to {method.residual:.3f}/255 on average"
            f"{', chosen' if place == 0 else ''}"
        )
    table = Table(box=None, header_style="bold")
    for heading in ("from", "to", "given ratio", "believed ratio"):
        table.add_column(heading, justify="right" if "ratio" in heading else "left")
    for step in believed_steps(recovery):
        table.add_row(
            escape(images[step.first].name),
            escape(images[step.second].name),
            f"{step.given:.4g}",
            f"{step.believed:.4g} ± {step.std:.2g}",
        )
    console.print(table)
    console.print(
        "Ratios and curve are believed up to one common power, which no bracket separates from the curve: the span is"
        f" as given, certain to {recovery.exponent_std:.1%} if exposures are set as exactly as shutters do it or as"
        " these scatter. The standard deviations hold it."
    )
    if recovery.moved > 0.01:
        console.print(
            f"Left out: {recovery.moved:.0%} of the picture, where something moved or is misaligned."
        )
    for index, name in enumerate(CHANNELS):
        low, high = recovery.response.determined(index)
        console.print(
            f"{name}: determined from {255 * low:.1f} to {255 * high:.1f} of 255; {recovery.certainty(index)}"
        )
    for warning in recovery.warnings:
        console.print(f"Warning: {escape(warning)}.")
    console.print(f"Wrote {escape(str(output))} and {escape(output.stem + _FIGURE)} beside it")
