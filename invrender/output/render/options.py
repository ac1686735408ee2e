"""The options of `render`, and which of them exclude each other."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from capture.primaries import PRIMARIES
from invrender.output.render.files import check_png
from invrender.output.render.frames import TURNS
from invrender.result.saved import nearest

DEFAULT_FPS = 25.0
# Percent, beyond which pictures show the cells.
_MOST_TOLERANCE = 10.0


@dataclass(frozen=True)
class RenderOptions:
    """The options of the command, as given; see its help."""

    result: Path
    out: Path
    lighting: str | None = None
    light: Path | None = None
    panorama: bool = False
    sources: tuple[str, ...] = ()
    rotate_light: float = 0.0
    view: str | None = None
    photo: str | None = None
    photoset: Path | None = None
    size: str | None = None
    fov_deg: float | None = None
    turntable: int | None = None
    turn: str | None = None
    fps: float | None = None
    radius: float | None = None
    mesh: Path | None = None
    mesh_to_world: Path | None = None
    mean: bool = False
    exposure_ev: float | None = None
    primaries: str | None = None
    std: bool = False
    preview: bool = False
    tolerance: float | None = None
    assume: tuple[str, ...] = ()


def check_options(options: RenderOptions) -> None:
    """ValueError where options exclude each other."""
    _check_output(options)
    _check_turntable(options)
    if options.photo and (options.view or options.size or options.fov_deg is not None):
        raise ValueError("--photo is a whole camera: it excludes --view, --size and --fov")
    check_preview(options.preview, options.std)
    check_tolerance(options.tolerance, options.preview, options.std)
    if not abs(options.rotate_light) <= 360:
        raise ValueError(f"--rotate-light is {options.rotate_light:g} degrees; it must be -360 to 360")


def check_preview(preview: bool, std: bool) -> None:
    """ValueError where a preview is to have standard deviations."""
    if preview and std:
        raise ValueError("--preview knows no standard deviations; leave --std or --preview out")


def check_tolerance(percent: float | None, preview: bool, std: bool) -> None:
    """ValueError for a tolerance, in percent, out of range, or where nothing is interpolated."""
    if percent is None:
        return
    if not 0 <= percent <= _MOST_TOLERANCE:
        raise ValueError(
            f"--tolerance is {percent:g}%; it must be 0 (an integral for each ray) to {_MOST_TOLERANCE:g}"
        )
    if preview or std:
        other = "--preview" if preview else "--std"
        raise ValueError(
            f"--tolerance is of what is interpolated, and with {other} nothing is; leave one of them out"
        )


def _check_output(options: RenderOptions) -> None:
    ending = options.out.suffix.lower()
    if options.turntable is None and ending not in (".exr", ".png"):
        raise ValueError(
            f"-o {options.out}: the name must end in .exr or .png; with --turntable in .mp4 or .png, or be a folder's"
        )
    if options.turntable is not None and ending not in ("", ".png", ".mp4"):
        raise ValueError(
            f"-o {options.out}: --turntable writes a video (.mp4), a strip of pictures (.png), or a folder of EXR and"
            f" PNG: give a name without {ending}"
        )
    if options.std and ending in (".png", ".mp4"):
        raise ValueError(f"--std: {ending} has no room for standard deviations; write an .exr")
    if options.primaries is not None:
        _check_primaries(options, options.primaries, ending)
    if options.exposure_ev is not None and ending == ".exr":
        raise ValueError("--exposure is for looking at; an .exr holds the radiance itself: leave it out")
    if options.exposure_ev is not None and not abs(options.exposure_ev) <= 100:
        raise ValueError(f"--exposure is {options.exposure_ev:g} EV; it must be -100 to 100")


def _check_primaries(options: RenderOptions, named: str, ending: str) -> None:
    if named not in PRIMARIES:
        raise ValueError(f"--primaries {named}: {nearest(named, tuple(PRIMARIES))}")
    if ending == ".mp4" and named != "srgb":
        raise ValueError(
            f"--primaries {named}: an .mp4 is written in sRGB's; give a folder, an .exr or a .png"
        )
    if options.std and named != "srgb":
        raise ValueError(
            f"--std is known of sRGB's channels, not of {named}'s, which mix them; leave --primaries or --std out"
        )
    if ending != ".exr":
        # A turntable's folder has both.
        check_png(PRIMARIES[named])


def _check_turntable(options: RenderOptions) -> None:
    if options.turn is not None and options.turn not in TURNS:
        raise ValueError(f"--turn {options.turn}: {nearest(options.turn, TURNS)}")
    if options.turn is not None and options.turntable is None:
        raise ValueError("--turn says what goes round; give --turntable and how many pictures")
    if options.fps is not None and options.out.suffix.lower() != ".mp4":
        raise ValueError("--fps is a video's; write an .mp4, with --turntable")
    if options.fps is not None and not 1 <= options.fps <= 240:
        raise ValueError(f"--fps is {options.fps:g}; it must be 1 to 240")
    if options.turntable is not None and options.photo and options.turn != "light":
        raise ValueError("--photo is a camera that rests: it excludes --turntable, but with --turn light")
