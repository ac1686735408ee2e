"""Exposure of a photograph, from the manifest or from EXIF, so that it can be divided out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, Literal

import numpy as np

from capture.files.imagefile import check_exists
from capture.files.imageheader import is_raw
from capture.files.rawfile import raw_exposure

ExposureSource = Literal["equal", "exif", "manual"]
# EXIF tags (CIPA DC-008): ExposureTime, FNumber, PhotographicSensitivity.
_EXIF_TAGS = {"exposure_s": 33434, "f_number": 33437, "iso": 34855}
# ShutterSpeedValue and ApertureValue, which some files hold instead: APEX units, -log2(time) and 2 log2(f-number).
_APEX_TIME, _APEX_APERTURE = 37377, 37378
_EXIF_IFD = 34665


@dataclass(frozen=True)
class ExposureSettings:
    """What the manifest says of one photo's exposure; None where it says nothing."""

    exposure_s: float | None = None
    iso: float | None = None
    f_number: float | None = None

    def completed(self, other: ExposureSettings) -> ExposureSettings:
        """These settings, with what is missing from others."""
        return ExposureSettings(
            self.exposure_s or other.exposure_s, self.iso or other.iso, self.f_number or other.f_number
        )


def relative_exposure(path: Path, source: ExposureSource, settings: ExposureSettings) -> float:
    """Exposure as time [s] x (ISO / 100) / f-number^2; the pixel value is proportional to it.

    `equal` is 1 for every photo. `manual` takes the manifest's numbers, `exif` the file's, overridden by
    the manifest's. ISO and f-number that are given nowhere count as 100 and 1: constant over the set.
    """
    if source == "equal":
        return 1.0
    if source == "exif":
        settings = settings.completed(read_exif_exposure(path))
    if settings.exposure_s is None:
        given = source == "manual"
        where = "the manifest gives no exposure_s" if given else "its EXIF holds no exposure time"
        raise ValueError(
            f"{path}: {where}; write exposure_s = ... (seconds) in this photo's table"
            " (for a bracket, give --times 1/60,1/15,...)"
            " or, if all photos had one exposure, [radiometry] exposure = 'equal'"
        )
    return settings.exposure_s * ((settings.iso or 100) / 100) / (settings.f_number or 1) ** 2


def read_exif_exposure(path: Path) -> ExposureSettings:
    """Exposure time in seconds, ISO and f-number from a file's EXIF; None where a tag is missing or zero."""
    if is_raw(path):
        return ExposureSettings(*map(_positive, raw_exposure(path)))
    from PIL import Image, UnidentifiedImageError

    Image.MAX_IMAGE_PIXELS = None  # only headers are read here: there is no bomb to defuse
    try:
        with Image.open(path) as image:
            exif = image.getexif()
            tags: dict[int, Any] = {**exif, **exif.get_ifd(_EXIF_IFD)}
    except (OSError, UnidentifiedImageError):
        return ExposureSettings()
    values = {key: _positive(tags.get(tag)) for key, tag in _EXIF_TAGS.items()}
    values["exposure_s"] = values["exposure_s"] or _power_of_two(tags.get(_APEX_TIME), -1.0)
    values["f_number"] = values["f_number"] or _power_of_two(tags.get(_APEX_APERTURE), 0.5)
    return ExposureSettings(**values)


def bracket_exposures(paths: Sequence[Path], seconds: Sequence[float] | None = None) -> tuple[float, ...]:
    """Relative exposure of each photograph of a bracket: time [s] x (ISO / 100) / f-number^2.

    seconds : exposure times given by hand, one for each photo (ISO and aperture then count as constant);
        None to read time, ISO and f-number from each file's EXIF.
    ValueError names the photo whose exposure is missing, and says how to give it by hand.
    """
    for path in paths:
        check_exists(path)
    if seconds is None:
        found = [read_exif_exposure(path) for path in paths]
        check_alike(paths, found)
        return tuple(
            relative_exposure(path, "exif", settings) for path, settings in zip(paths, found, strict=True)
        )
    if len(seconds) != len(paths):
        raise ValueError(
            f"{len(seconds)} exposure times for {len(paths)} photos: give one for each, in their order"
        )
    for path, time in zip(paths, seconds, strict=True):
        if not (np.isfinite(time) and time > 0):
            raise ValueError(f"{path}: its exposure time is given as {time} s; it must be > 0")
    return tuple(float(time) for time in seconds)


def check_alike(paths: Sequence[Path], settings: Sequence[ExposureSettings]) -> None:
    """ValueError if ISO or f-number are known of some photographs but not of others: a missing one isn't 100, or 1."""
    for key, name in (("iso", "ISO"), ("f_number", "f-number")):
        known = [getattr(one, key) is not None for one in settings]
        if any(known) and not all(known):
            without, having = paths[known.index(False)], paths[known.index(True)]
            raise ValueError(
                f"{without}: its {name} is not known, but that of {having.name} is; write {key} = ... in this photo's"
                " table (for a bracket of one aperture and ISO, give --times)"
            )


def read_times(text: str) -> tuple[float, ...]:
    """Exposure times in seconds as a user writes them: "1/60, 1/15, 0.25", or the path of a file of such lines."""
    path = Path(text)
    if path.is_file():
        text = path.read_text(encoding="utf-8")
    times = []
    for part in text.replace(",", " ").split():
        try:
            times.append(float(Fraction(part)))
        except (ValueError, ZeroDivisionError) as error:
            raise ValueError(
                f"exposure time {part!r} is not a number of seconds such as 0.25 or 1/60 (and no file of that name)"
            ) from error
    return tuple(times)


def _power_of_two(apex: Any, factor: float) -> float | None:
    try:
        return float(2.0 ** (factor * float(apex)))
    except (TypeError, ValueError, ZeroDivisionError, OverflowError):
        return None


def _positive(value: Any) -> float | None:
    if isinstance(value, tuple):
        value = value[0] if value else None
    try:
        number = float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if number > 0 else None
