"""lightfactor calibrate noise: read and shot noise of a sensor from repeated photographs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from capture.commands.options import Encoding, IntegerEncoding, JsonOut, Photos, ResponseFile, encoding_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from capture.sensor.noiserecovery import NoiseEstimate, NoiseRecovery

_FIGURE = "-figure.png"


def noise(
    images: Photos,
    encoding: IntegerEncoding = Encoding.LINEAR,
    response: ResponseFile = None,
    output: JsonOut = Path("noise.json"),
) -> None:
    """Measure a sensor's noise: variance = read_std^2 + shot x signal, RGB, signal 1 being the white level.

    Photograph a static scene with dark and bright parts twice or more, without touching camera or light; pairs at
    several exposure times are welcome. All photographs need one ISO. Photographs of equal exposure (EXIF) and
    brightness are compared with each other; what moves in a minority of the picture doesn't matter.

    Writes OUT (numbers with standard deviations; read noise and full well in electrons) and OUT's name with
    -figure.png (variance against signal).
    """
    from capture.files.documents import input_hashes, software, write_json
    from capture.files.outfolder import result_files
    from capture.sensor.noisefigure import noise_figure
    from capture.sensor.noiserecovery import noise_document, recover_noise
    from capture.terminal import leave_cleanly_when_stopped, track

    leave_cleanly_when_stopped()
    inputs = [*images, *([response] if response else [])]
    with result_files(output, (_FIGURE,), inputs) as folder:
        recovery = recover_noise(track(images, "Comparing photographs"), encoding_of(encoding, response))
        document = {**noise_document(recovery), "inputs": input_hashes(inputs), "software": software()}
        write_json(folder / output.name, document)
        noise_figure(recovery).savefig(folder / (output.stem + _FIGURE))
    _report(recovery, output)


def _report(recovery: NoiseRecovery, output: Path) -> None:
    from rich.markup import escape
    from rich.table import Table

    from capture.radiance import CHANNELS
    from capture.terminal import console

    rows: list[tuple[str, Sequence[NoiseEstimate]]] = [
        ("read noise", recovery.read_std),
        ("read noise (e-)", recovery.read_electrons),
        ("shot noise", recovery.shot),
        ("white level (e-)", recovery.full_well),
    ]
    table = Table(box=None, header_style="bold")
    table.add_column("")
    for channel in CHANNELS:
        table.add_column(channel, justify="right")
    for name, parts in rows:
        table.add_row(name, *(_written(part) for part in parts))
    console.print(table)
    console.print(
        "Read noise: standard deviation in the dark; shot noise: variance per signal; the white level is 1."
    )
    said = set()
    for name, parts in rows[::2]:
        for part in parts:
            if part.value is None and (name, part.remedy) not in said:
                said.add((name, part.remedy))
                console.print(f"{name} is undetermined: {part.reason}; {part.remedy}.")
    moved = max(fit.moved_share for fit in recovery.fits)
    if moved > 0.01:
        console.print(f"{moved:.1%} of the scene changed by more than noise and was left out.")
    for warning in recovery.warnings:
        console.print(f"{warning}.")
    console.print(f"Wrote {escape(str(output))} and {escape(output.stem + _FIGURE)} beside it")


def _written(part: NoiseEstimate) -> str:
    if part.value is None or part.std is None:
        return "undetermined" if part.at_most is None else f"undetermined (< {part.at_most:.2g})"
    return f"{part.value:.4g} ± {part.std:.2g}"
