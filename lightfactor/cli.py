"""The command `lightfactor`. Heavy imports wait until a command runs, so that --help is instant."""

from __future__ import annotations

import functools
import os
import sys
import threading
from collections.abc import Callable
from typing import Annotated

import typer

from capture.commands.board import board
from capture.commands.cache import cache
from capture.commands.calibrate import calibrate
from capture.commands.hdr import hdr
from invrender.commands.brdf import brdf
from invrender.commands.compare import compare
from invrender.commands.demo import demo
from invrender.commands.export import export
from invrender.commands.factor import factor
from invrender.commands.gradients import gradients
from invrender.commands.light import light
from invrender.commands.plan import plan
from invrender.commands.prefilter import prefilter
from invrender.commands.process import process
from invrender.commands.refine import refine
from invrender.commands.render import render
from lightfactor.commands.batch import batch
from lightfactor.commands.studio import studio
from recon.commands.align import align
from recon.commands.hull import hull
from recon.commands.integrate import integrate
from recon.commands.mirrorball import mirrorball
from recon.commands.register import register
from recon.commands.samples import samples
from synthetic.commands.synth import synth

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


app.command(short_help="Photo set in, BRDF with error bars and a report out.")(process)
app.command(short_help="Many photo sets in, all results and one page over them out.")(batch)
app.command(short_help="The whole job on a synthetic gantry sequence, truth beside estimate.")(demo)
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
app.command(short_help="A mesh of a surface whose normals are known, as photometric stereo finds them.")(
    integrate
)
app.command(short_help="Light and BRDF from the same photographs, whatever is known of the light.")(factor)
app.command(short_help="The light on a sphere of known BRDF, as harmonics and as a map.")(light)
app.command(short_help="What a result looks like from other sides and under other light.")(render)
app.command(short_help="Reflection maps of a BRDF under a map of light, with what they can be off by.")(
    prefilter
)
app.command(short_help="What makes the gradients of a result's photographs, and where light counts as near.")(
    gradients
)
app.command(short_help="Look at a capture, fit, judge and relight it in the browser.")(studio)
app.command(short_help="Two results side by side, or a result beside the truth.")(compare)
app.command(short_help="A result for other programs: glTF, Mitsuba, MaterialX.")(export)
app.command(
    short_help="A BRDF without a formula, under known light; or the lobe that explains a measured BRDF."
)(brdf)
app.command(short_help="Merge a bracket of exposures into one radiance image.")(hdr)
app.add_typer(calibrate, name="calibrate", short_help="Calibrate cameras, sensors and gantries.")
app.command(short_help="A calibration board to print, true to scale.")(board)
app.command(short_help="What runs have kept of photo sets, listed or removed.")(cache)


@functools.cache
def _command() -> Callable[[], object]:
    """The program with all commands' options, which take time to put together."""
    return typer.main.get_command(app)


def main() -> None:
    """Run the command; what is wrong with the input is said in a sentence, without a traceback."""
    try:
        _command()()
    except BrokenPipeError:
        sys.exit(0)  # whoever reads our output, `head` for one, has seen enough
    except (ValueError, OSError) as error:
        if os.environ.get("LIGHTFACTOR_TRACEBACK"):
            raise
        print(f"lightfactor: error: {error}", file=sys.stderr)  # noqa: T201
        sys.exit(1)


def main_bound() -> None:
    """Run the command until whoever holds the other end of standard input is gone."""
    threading.Thread(target=_end_with_input, daemon=True).start()
    main()


def _end_with_input() -> None:
    # Not by `sys.stdin`, which waits for its reader when the program ends.
    while os.read(0, 1):
        pass
    # What isn't finished the next run clears away.
    os._exit(1)
