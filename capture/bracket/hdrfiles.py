"""The photographs of a bracket as files, made ready to be merged one by one."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from capture.bracket.hdr import Load, Merge, merge
from capture.decode import decode
from capture.exposure import bracket_exposures
from capture.files.imagefile import read_file, read_image
from capture.files.imageheader import is_raw
from capture.sensor.noise import SensorNoise, read_noise_model

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from capture.bracket.response import Response
    from capture.radiance import RadianceImage


@dataclass(frozen=True, eq=False)
class Bracket:
    """A bracket ready to be merged. origin : a sentence that says how its files became linear."""

    load: Load
    origin: str
    warnings: tuple[str, ...]


def merge_hdr(
    photos: Iterable[Path | str],
    times: Sequence[float] | None = None,
    response: Path | str | None = None,
    encoding: Literal["linear", "srgb"] | None = None,
    noise: Path | str | None = None,
) -> Merge:
    """Merge a bracket of photographs of one scene into radiance with its variance.

    photos : image files, two or more exposures. times : exposure times in seconds, one per photograph; None reads time,
        ISO and f-number from EXIF. response : a response.json, or encoding, for integer files; with neither the
        response is recovered from them. noise : a noise.json.
    Radiance is the linear signal (1 = white level) over time x ISO / 100 / f-number^2. ValueError says what is wrong
    with the files or their exposures.
    """
    paths = [Path(photo) for photo in photos]
    check_bracket(paths, response is not None, encoding is not None)
    exposures = bracket_exposures(paths, times)
    model = None if noise is None else read_noise_model(Path(noise))
    bracket = open_bracket(paths, exposures, None if response is None else Path(response), encoding, model)
    return merge(bracket.load, exposures, stated=model is not None)


def check_bracket(paths: Sequence[Path], response: bool, encoding: bool) -> None:
    """ValueError where photographs are too few for a bracket, or are said to be encoded in two ways."""
    if response and encoding:
        raise ValueError("--response and --encoding both say what the values stand for: remove one of them")
    if len(paths) < 2:
        for path in paths:
            read_file(path)  # if it doesn't exist, that is the fault
        given = f"{paths[0]}: is one photograph only" if paths else "no photographs are given"
        raise ValueError(f"{given}; a bracket needs two or more exposures")


def open_bracket(
    paths: Sequence[Path],
    exposures: Sequence[float],
    response: Path | None,
    encoding: Literal["linear", "srgb"] | None,
    noise: SensorNoise | None = None,
) -> Bracket:
    """Look at a bracket's files and settle how they become linear.

    response : a response.json, or encoding, for integer files; with neither the response is recovered from them.
    ValueError if the exposures are all equal, or photographs differ in size.
    """
    if max(exposures) < 1.001 * min(exposures):
        raise ValueError(
            f"{paths[0]} and the others: all exposures are equal; a bracket needs photographs with different exposures"
        )
    curve: Response | Literal["linear", "srgb"] = encoding or "linear"
    origin = ""
    warnings: tuple[str, ...] = ()
    if not any(_is_integer(path) for path in paths):
        if response is not None or encoding is not None:
            raise ValueError(
                f"{paths[0]}: is linear already, as are the others; leave --response and --encoding away"
            )
        origin = "The files are linear."
    elif response is not None:
        from capture.bracket.response import read_response

        curve, origin = read_response(response), f"Values became linear by {response}."
    elif encoding is not None:
        origin = f"Values count as {encoding}."
    else:
        from capture.bracket.responserecovery import recover_response

        recovery = recover_response(paths, exposures)
        curve, warnings = recovery.response, recovery.warnings
        origin = (
            f"Values became linear by the response that this bracket shows ({recovery.methods[0].name}, predicts values"
            f" to {recovery.methods[0].residual:.2f}/255); `lightfactor calibrate response` shows it."
        )
    size: list[tuple[int, ...]] = []

    def load(index: int) -> tuple[RadianceImage, NDArray[np.bool_]]:
        path = paths[index]
        image = decode(path, curve, exposures[index], noise=noise)
        size.append(image.saturated.shape)
        if image.saturated.shape != size[0]:
            raise ValueError(
                f"{path}: is {image.saturated.shape[1]}x{image.saturated.shape[0]} pixels, but {paths[0]} is"
                f" {size[0][1]}x{size[0][0]}; a bracket's photographs must be of one size"
            )
        return image, _valid(path, image, curve)

    return Bracket(load, origin, warnings)


def _is_integer(path: Path) -> bool:
    return not is_raw(path) and bool(np.issubdtype(read_image(path)[0].dtype, np.integer))


def _valid(path: Path, image: RadianceImage, curve: Response | str) -> NDArray[np.bool_]:
    """Where each channel is below saturation, (h, w, 3).

    RAW files and JPEG mix their channels (demosaicing, chroma): there one saturated channel spoils all three. In
    other integer files each is saturated by itself.
    """
    whole = np.broadcast_to(~image.saturated[..., None], image.radiance.shape)
    if is_raw(path):
        return whole
    pixels, header = read_image(path)
    if header.lossy or not np.issubdtype(pixels.dtype, np.integer):
        return whole
    levels = 255 if pixels.dtype == np.uint8 else 65535
    brightest = (levels - 1,) * 3 if isinstance(curve, str) else curve.brightest(levels)
    return pixels <= np.array(brightest, pixels.dtype)
