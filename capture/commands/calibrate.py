"""lightfactor calibrate: its commands, each in a module of its own; only typer is imported up here."""

from __future__ import annotations

import typer

from capture.commands.camera import camera
from capture.commands.color import color
from capture.commands.flatfield import flatfield
from capture.commands.gantry import gantry
from capture.commands.noise import noise
from capture.commands.response import response

calibrate = typer.Typer(
    help="Calibrate a camera, a sensor or a gantry from photographs of boards, brackets, white walls and charts.",
    no_args_is_help=True,
    rich_markup_mode=None,
)
calibrate.command(
    short_help="Focal length, principal point and lens distortion, from photographs of a board."
)(camera)
calibrate.command(short_help="What the file's numbers stand for: the response curve, from a bracket.")(
    response
)
calibrate.command(short_help="Read and shot noise of the sensor, from repeated photographs.")(noise)
calibrate.command(short_help="Vignetting, from photographs of an even surface.")(flatfield)
calibrate.command(short_help="Linear sRGB of the camera's colours, from photographs of a colour chart.")(
    color
)
calibrate.command(short_help="The arc that a camera travels along, from photographs of a board.")(gantry)
