"""A turntable's pictures, as files: a folder of EXR and PNG, a strip of them in one PNG, or a video."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from capture.files.documents import input_hashes, software, write_json
from capture.primaries import Primaries
from capture.terminal import track
from invrender.output.render.files import (
    automatic_exposure,
    before_black,
    encoded,
    read_picture,
    write_picture,
    write_png,
    write_rgba,
)
from invrender.output.render.frames import TurntableFrame
from invrender.output.render.picture import Picture
from invrender.output.render.video import write_video

# The first is in every turntable's folder.
TURNTABLE_FILES = ("views.json", "*.exr", "*.png")
_STRIP_COLUMNS = 8
_MOST_STRIP_PIXELS = 100_000_000


def write_frames(
    folder: Path,
    frames: Mapping[str, TurntableFrame],
    take: Callable[[TurntableFrame], Picture],
    primaries: Primaries | None = None,
) -> float:
    """Write NAME.exr of each frame, and return the exposure in EV at which the brightest of them just clips.

    primaries : as of `write_picture`.
    """
    exposures = []
    for name, frame in track(list(frames.items()), "Rendering"):
        picture = take(frame)
        write_picture(folder / f"{name}.exr", picture, primaries)
        exposures.append(automatic_exposure(picture))
    # Of frames in the dark it is 0, which would hold the others down.
    lit = [exposure for exposure in exposures if exposure is not None]
    return min(lit, default=0.0)


def develop(
    folder: Path,
    names: Sequence[str],
    out: Path,
    exposure_ev: float,
    fps: float,
    primaries: Primaries | None = None,
) -> None:
    """Make of the EXR files of a folder what one looks at: PNG beside them; or out.mp4, or a strip out.png, there.

    primaries : as of `write_png`.
    """
    pictures = (read_picture(folder / f"{name}.exr") for name in track(list(names), "Encoding"))
    match out.suffix.lower():
        case ".mp4":
            write_video(folder / out.name, (before_black(each, exposure_ev) for each in pictures), fps)
        case ".png":
            _write_strip(folder / out.name, pictures, len(names), exposure_ev, primaries)
        case _:
            for name, picture in zip(names, pictures, strict=True):
                write_png(folder / f"{name}.png", picture, exposure_ev, primaries)


def check_strip(out: Path, frames: Mapping[str, TurntableFrame]) -> None:
    """ValueError where all frames of a turntable are too much for one picture."""
    camera = next(iter(frames.values())).camera
    if len(frames) * camera.width * camera.height > _MOST_STRIP_PIXELS:
        raise ValueError(
            f"-o {out}: {len(frames)} pictures of {camera.width}x{camera.height} are too many for one; take fewer, a"
            " smaller --size, or give a folder or an .mp4"
        )


def write_views(
    folder: Path,
    frames: Mapping[str, TurntableFrame],
    lighting: str,
    inputs: Sequence[Path],
    notes: Sequence[str],
) -> None:
    """Write views.json: what each frame of a folder was seen by."""
    document = {
        "format": 1,
        "lighting": lighting,
        "views": [
            {
                "file": f"{name}.exr",
                "model": frame.camera.model,
                "params": frame.camera.params.tolist(),
                "width": frame.camera.width,
                "height": frame.camera.height,
                "world_to_camera": frame.camera.world_to_camera.tolist(),
                "light_turn_deg": frame.light_turn % 360,
            }
            for name, frame in frames.items()
        ],
        "notes": list(notes),
        "inputs": input_hashes(inputs),
        "software": software(),
    }
    write_json(folder / "views.json", document)


def _write_strip(
    path: Path, pictures: Iterator[Picture], count: int, exposure_ev: float, primaries: Primaries | None
) -> None:
    """Pictures side by side, with alpha, in as few rows of up to eight as hold them."""
    columns = -(-count // -(-count // _STRIP_COLUMNS))
    strip: np.ndarray | None = None
    for k, picture in enumerate(pictures):
        height, width = picture.coverage.shape
        if strip is None:
            strip = np.zeros((-(-count // columns) * height, columns * width, 4), np.uint8)
        row, column = divmod(k, columns)
        place = np.s_[row * height : (row + 1) * height, column * width : (column + 1) * width]
        strip[place] = encoded(picture, exposure_ev)
    assert strip is not None
    write_rgba(path, strip, primaries)
