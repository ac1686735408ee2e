"""lightfactor calibrate flatfield: the relative illumination over the image from photographs of an even surface."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from capture.commands.options import Encoding, IntegerEncoding, JsonOut, Photos, ResponseFile, encoding_of

if TYPE_CHECKING:
    from capture.sensor.flatrecovery import FlatFieldRecovery

_FIGURE = "-figure.png"


def flatfield(
    images: Photos,
    pixelwise: Annotated[
        bool,
        typer.Option(
            "--map",
            help="A map pixel by pixel, with the dust on the sensor, instead of a radial polynomial; best from"
            " ten or more photographs.",
        ),
    ] = False,
    encoding: IntegerEncoding = Encoding.LINEAR,
    response: ResponseFile = None,
    output: JsonOut = Path("flatfield.json"),
) -> None:
    """Measure vignetting: how much of the light each pixel receives, relative to where the lens gives most.

    Photograph an evenly lit, even surface that fills the picture, out of focus, at the aperture, focal length and
    focus of the photographs to be corrected; expose its brightest part to about half of the white level. Take
    several, turning the camera about its axis in between: one alone can't separate the light's gradient from the lens.

    Writes OUT, OUT's name with -figure.png, and with --map OUT's name with .exr (the illumination, RGB).
    """
    from capture.files.documents import input_hashes, software, write_json
    from capture.files.imagefile import write_exr
    from capture.files.outfolder import result_files
    from capture.sensor.flatfieldfigure import flat_field_figure
    from capture.sensor.flatrecovery import flat_field_document, recover_flat_field
    from capture.terminal import console, leave_cleanly_when_stopped

    leave_cleanly_when_stopped()
    inputs = [*images, *([response] if response else [])]
    map_ending = (".exr",) if pixelwise else ()
    with result_files(output, (_FIGURE, *map_ending), inputs) as folder:
        with console.status(f"Reading {len(images)} photographs"):
            recovery = recover_flat_field(images, encoding_of(encoding, response), as_map=pixelwise)
        map_name = output.stem + ".exr"
        document = flat_field_document(recovery, map_name)
        write_json(folder / output.name, {**document, "inputs": input_hashes(inputs), "software": software()})
        if pixelwise:
            tiles = recovery.tiles
            write_exr(folder / map_name, recovery.flat_field.gain(tiles.width, tiles.height))
        flat_field_figure(recovery).savefig(folder / (output.stem + _FIGURE))
    _report(recovery, output)


def _report(recovery: FlatFieldRecovery, output: Path) -> None:
    import numpy as np
    from rich.markup import escape

    from capture.radiance import CHANNELS
    from capture.sensor.flatfield import FlatFieldMap
    from capture.terminal import console

    tiles, model = recovery.tiles, recovery.fit.model
    corners = np.s_[[0, 0, -1, -1], [0, -1, 0, -1]]
    gain = recovery.flat_field.gain(tiles.width, tiles.height)[corners].mean(axis=0)
    std = recovery.flat_field.std(tiles.width, tiles.height)[corners].mean(axis=0)
    for name, value, its_std in zip(CHANNELS, gain, std, strict=True):
        console.print(f"Illumination in the corners, {name}: {value:.4f} ± {its_std:.1g}")
    radial = recovery.radial
    if recovery.undetermined:
        entry = recovery.undetermined[0]
        console.print(f"Centre: undetermined: {entry['reason']}; {entry['remedy']}")
    elif model.free_centre:
        x_std, y_std = np.sqrt(np.diag(radial.covariance)[:2])
        console.print(
            f"Centre: ({radial.centre[0]:.1f} ± {x_std:.1g}, {radial.centre[1]:.1f} ± {y_std:.1g}) px"
        )
    else:
        console.print("Centre: the image's, which predicts unseen parts as well as a free one")
    kind = "for each channel" if model.per_channel else "shared by the channels"
    console.print(f"Polynomial of {model.order} orders, {kind}; misfit {100 * radial.structured.max():.2g}%")
    if model.gradient:
        steepest = float(np.abs(recovery.fit.gradients).max())
        console.print(f"Gradients of the light of up to {steepest:.1%} per half diagonal are taken out")
    for warning in recovery.warnings:
        console.print(f"{warning}.")
    beside = f"{output.stem}{_FIGURE}"
    if isinstance(recovery.flat_field, FlatFieldMap):
        beside += f" and {output.stem}.exr"
    console.print(f"Wrote {escape(str(output))}, and {escape(beside)} beside it")
