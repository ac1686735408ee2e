"""lightfactor hdr: a bracket of exposures to one linear radiance image."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from capture.commands.options import Encoding, Photos, Times

if TYPE_CHECKING:
    from collections.abc import Sequence

    from capture.bracket.hdr import Merge
    from capture.bracket.hdrfiles import Bracket
    from capture.bracket.mapcomparison import Comparison

_FIGURE = "-figure.png"
# Shares of the picture from which on a word of warning is due.
_NOTABLE_MOTION = 0.02
_NOTABLE_SATURATION = 0.001
# Brightness of one photograph over another's, exposures divided out, from which on.
_NOTABLE_FACTOR = 1.15


def hdr(
    images: Photos,
    output: Annotated[
        Path,
        typer.Option(
            "-o",
            "--out",
            metavar="OUT",
            help="EXR file to write; an earlier one is replaced.",
            show_default=False,
        ),
    ],
    response: Annotated[
        Path | None, typer.Option(help="response.json of the camera, by `lightfactor calibrate response`.")
    ] = None,
    encoding: Annotated[
        Encoding | None,
        typer.Option(
            help="What integer files hold, instead of --response. With neither, the response is recovered from this"
            " bracket. RAW, EXR and .hdr are always linear.",
            show_default=False,
        ),
    ] = None,
    noise: Annotated[
        Path | None,
        typer.Option(help="noise.json of the sensor; without it the noise is read off the bracket itself."),
    ] = None,
    times: Times = None,
    compare: Annotated[
        Path | None,
        typer.Option(help="EXR or .hdr of the same scene, to compare with up to one scale per channel."),
    ] = None,
) -> None:
    """Merge a bracket of photographs of one scene into linear radiance.

    Every photograph is weighted by the inverse of its variance, and left out where it is saturated. Radiance is the
    linear signal (1 = white level) divided by time [s] x (ISO / 100) / f-number^2.

    Writes OUT (channels R, G, B; variance.R, .G, .B in their unit squared; saturated, 1 where every photograph is;
    deviating, 1 where they differ by more than noise)
    and OUT's name with -figure.png.
    """
    from capture.bracket.hdr import merge
    from capture.bracket.hdrfigure import hdr_figure
    from capture.bracket.hdrfiles import check_bracket, open_bracket
    from capture.bracket.mapcomparison import compare_maps
    from capture.exposure import bracket_exposures, read_times
    from capture.files.imagefile import write_exr
    from capture.files.outfolder import result_files
    from capture.sensor.noise import read_noise_model
    from capture.terminal import leave_cleanly_when_stopped

    leave_cleanly_when_stopped()
    check_bracket(images, response is not None, encoding is not None)
    if output.suffix.lower() != ".exr":
        raise ValueError(f"{output}: must end in .exr, the format that holds radiance and its variance")
    given = [path for path in (response, noise, compare) if path is not None]
    with result_files(output, (_FIGURE,), [*images, *given]) as folder:
        exposures = bracket_exposures(images, read_times(times) if times else None)
        model = read_noise_model(noise) if noise else None
        bracket = open_bracket(images, exposures, response, encoding.value if encoding else None, model)
        merged = merge(bracket.load, exposures, stated=model is not None)
        comparison = compare_maps(merged, compare) if compare else None
        image = merged.image
        layers = {
            "variance": image.variance,
            "saturated": image.saturated.astype("float32"),
            "deviating": merged.deviating.astype("float32"),
        }
        write_exr(folder / output.name, image.radiance, layers=layers)
        figure = hdr_figure(merged, exposures, [path.name for path in images], comparison)
        figure.savefig(folder / (output.stem + _FIGURE))
    _report(merged, bracket, [path.name for path in images], exposures, comparison, output)


def _report(
    merged: Merge,
    bracket: Bracket,
    names: Sequence[str],
    exposures: Sequence[float],
    comparison: Comparison | None,
    output: Path,
) -> None:
    import numpy as np
    from rich.markup import escape

    from capture.radiance import CHANNELS
    from capture.terminal import console

    console.print(bracket.origin)
    for warning in bracket.warnings:
        console.print(f"Warning: {escape(warning)}.")
    radiance, std = merged.image.radiance, np.sqrt(merged.image.variance)
    shown = (radiance > std) & ~merged.image.saturated[..., None]
    if shown.any():
        relative = std[shown] / radiance[shown]
        console.print(
            f"Radiance certain to {np.median(relative):.2%} in the median, {np.quantile(relative, 0.95):.2%} in all but"
            " 5% of the picture"
            + ("" if shown.mean() > 0.99 else f"; {1 - shown.mean():.0%} is saturated or lost in noise")
        )
    order = np.argsort(exposures)
    for factor, short, long in zip(merged.factors, order[:-1], order[1:], strict=True):
        if max(factor, 1 / factor) > _NOTABLE_FACTOR:
            console.print(
                f"Warning: {escape(names[long])} is {factor:.2f} times as bright as {escape(names[short])}, exposures"
                " divided out, and should be once: check exposure, ISO and aperture of both, and what the files hold"
                " (--encoding, --response)."
            )
    saturated, moved = merged.image.saturated.mean(), merged.deviating.mean()
    if saturated > _NOTABLE_SATURATION:
        console.print(
            f"Warning: {saturated:.2%} of the picture is saturated in every photograph; the radiance there is a lower"
            " bound. Add a shorter exposure."
        )
    if moved > _NOTABLE_MOTION:
        console.print(
            f"Warning: over {moved:.1%} of the picture the photographs differ by more than noise (motion, misalignment,"
            " changed light): white in the figure, which also says how well each photograph agrees."
        )
    contradicted = merged.contradicted.mean()
    if contradicted > _NOTABLE_SATURATION:
        console.print(
            f"Warning: {contradicted:.2%} of the picture is saturated in a photograph but not in a longer exposure"
            " (a border, a moving light); those values were left out."
        )
    if comparison is not None:
        for name, one in zip(CHANNELS, comparison.channels, strict=True):
            console.print(
                f"{name}: {escape(comparison.name)} differs by {one.median:.2%} in the median, {one.quantile90:.1%} at"
                f" the 90% quantile, after a scale of {one.scale:.4g}"
            )
    console.print(f"Wrote {escape(str(output))} and {escape(output.stem + _FIGURE)} beside it")
