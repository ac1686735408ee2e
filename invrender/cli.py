"""The command `lightfactor`. Heavy imports wait until a command runs, so that --help is instant."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated

import typer

from capture.cli import add_commands
from invrender.brdf.command import brdf
from invrender.compare.command import compare
from invrender.export.command import export
from invrender.factor.command import factor
from invrender.lighting.command import light
from invrender.plan.command import plan
from invrender.refine.command import refine
from invrender.render.command import render
from recon.align.command import align
from recon.cli import mirrorball
from recon.hull.command import hull
from recon.register.command import register
from recon.samples.command import samples
from synthetic.cli import synth

DEFAULT_SAMPLES = 60_000

app = typer.Typer(
    name="lightfactor",
    help="Photographs of a real object in; its reflectance, the light on it, and how certain each number is, out.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
    rich_markup_mode=None,
)


def _print_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        typer.echo(f"lightfactor {version('lightfactor')}")
        raise typer.Exit


@app.callback()
def _lightfactor(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_print_version, is_eager=True, help="Show the version and exit."),
    ] = False,
) -> None:
    pass


@app.command(short_help="Photo set in, BRDF with error bars and a report out.")
def process(
    photoset: Annotated[
        Path,
        typer.Argument(
            metavar="SET", help="Folder of a photo set, or its photoset.toml.", show_default=False
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(
            "-o",
            "--out",
            metavar="OUT",
            help="Result folder; an earlier result in it is replaced.",
            show_default=False,
        ),
    ],
    samples: Annotated[
        int,
        typer.Option(
            min=1000,
            help="Pixels of all photographs together that enter the fit, drawn evenly; fewer are faster, with"
            " larger error bars.",
        ),
    ] = DEFAULT_SAMPLES,
) -> None:
    """Recover BRDF and error bars, and the lighting where it is unknown, from a photo set of a sphere or a mesh.

    Writes OUT/result.json (every number with its standard deviation), OUT/report.html (open it in a
    browser), OUT/predicted/ (EXR) and the lighting as used. Kd is in 1/sr, so the albedo is pi Kd; sigma is
    in radians.
    """
    from invrender.run import run_process

    run_process(photoset, out, samples)


@app.command(short_help="The whole job on a synthetic gantry sequence, truth beside estimate.")
def demo(
    out: Annotated[
        Path, typer.Option("-o", "--out", metavar="OUT", help="Folder for the photo set and the result.")
    ] = Path("lightfactor-demo"),
) -> None:
    """Photograph a synthetic teflon sphere on a gantry, process it, and print truth beside estimate.

    The photographs come from brute-force integration of the reflection integral over all light
    directions, with 1% noise: not from the formula that is then fitted.
    """
    from invrender.run import run_demo

    run_demo(out)


app.command(short_help="Photograph a synthetic scene: a photo set with its truth beside it.")(synth)
app.command(
    short_help="Before anyone shoots: what a scene's photographs will determine, and what would help."
)(plan)
app.command(short_help="Read the light off photographs of a mirror (chrome) ball.")(mirrorball)
app.command(short_help="Where photographs were taken from: features, a board, COLMAP, transforms.json.")(
    register
)
app.command(short_help="Where a mesh lies in the photographs: picked points, silhouettes, the cloud.")(align)
app.command(
    short_help="What the photographs say of a mesh: samples, visibility, and a figure to check a set by."
)(samples)
app.command(short_help="Poses by what the photographs show, under known light.")(refine)
app.command(short_help="A mesh of an object that nobody scanned, from its silhouettes.")(hull)
app.command(short_help="Light and BRDF from the same photographs, whatever is known of the light.")(factor)
app.command(short_help="The light on a sphere of known BRDF, as harmonics and as a map.")(light)
app.command(short_help="What a result looks like from other sides and under other light.")(render)
app.command(short_help="Two results side by side, or a result beside the truth.")(compare)
app.command(short_help="A result for other programs: glTF, Mitsuba, MaterialX.")(export)
app.command(short_help="A BRDF without a formula, under known light: harmonics, or a measured table.")(brdf)
add_commands(app)


def main() -> None:
    """Run the command; what is wrong with the input is said in a sentence, without a traceback."""
    try:
        app()
    except BrokenPipeError:
        sys.exit(0)  # whoever reads our output, `head` for one, has seen enough
    except (ValueError, OSError) as error:
        if os.environ.get("LIGHTFACTOR_TRACEBACK"):
            raise
        print(f"lightfactor: error: {error}", file=sys.stderr)  # noqa: T201
        sys.exit(1)
