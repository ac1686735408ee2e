"""Noise parameters of a sensor from repeated photographs: reading, pairing, fitting, and what is determined."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from capture.arrays import frozen_array
from capture.bracket.response import Response
from capture.exposure import ExposureSettings, read_exif_exposure
from capture.files.imagefile import check_header, read_file
from capture.files.imageheader import is_raw
from capture.files.rawfile import read_raw
from capture.radiance import CHANNELS
from capture.sensor.noise import SensorNoise
from capture.sensor.photontransfer import TransferFit, fit_transfer, tiles_of
from capture.sensor.repeats import RepeatedFrame, Repeats
from capture.sensor.rounding import decode_with_rounding

if TYPE_CHECKING:
    from capture.decode import Encoding

Floats = NDArray[np.float64]

# A number counts as determined if it is this many of its standard deviations away from zero.
_SIGNIFICANT = 3.0
# 95% of a Gaussian lie below this many deviations above its mean.
_ONE_SIDED = 1.645


@dataclass(frozen=True)
class NoiseEstimate:
    """One number of one channel. value, std : None where undetermined; then reason and remedy say why, and what to do.

    at_most : what it is below with 95% probability; None if nothing is known.
    """

    value: float | None
    std: float | None
    at_most: float | None
    reason: str | None = None
    remedy: str | None = None


@dataclass(frozen=True, eq=False)
class NoiseRecovery:
    """What repeated photographs determine of their sensor.

    read_std, shot : per channel, as in `capture.sensor.noise.NoiseModel`. covariance : (3, 2, 2) of (read_std^2, shot).
    fits : per channel, what the numbers were read off. groups : the photographs that were compared with each other.
    gains : brightness of each of them relative to the first of its group. iso : None where EXIF doesn't state it.
    lossy : a photograph was JPEG-compressed.
    """

    read_std: tuple[NoiseEstimate, ...]
    shot: tuple[NoiseEstimate, ...]
    covariance: Floats
    fits: tuple[TransferFit, ...]
    groups: tuple[tuple[Path, ...], ...]
    gains: tuple[tuple[float, ...], ...]
    iso: float | None
    lossy: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "covariance", frozen_array(self.covariance))

    @property
    def warnings(self) -> list[str]:
        """What the numbers can't be trusted in, in plain words."""
        if not self.lossy:
            return []
        return [
            "JPEG compression takes the finest noise away and adds its own: the numbers are those of pixels in such"
            " files, not the sensor's, and means over many pixels are noisier than they say; photograph in RAW, or save"
            " without loss"
        ]

    @property
    def model(self) -> SensorNoise:
        """The noise model, with the largest value that an undetermined number may have."""
        read_std, shot = (
            np.array([part.at_most if part.value is None else part.value for part in parts], float)
            for parts in (self.read_std, self.shot)
        )
        return SensorNoise(read_std, shot)

    @property
    def full_well(self) -> tuple[NoiseEstimate, ...]:
        """Electrons at the white level, 1 / shot."""
        return tuple(_full_well(shot) for shot in self.shot)

    @property
    def read_electrons(self) -> tuple[NoiseEstimate, ...]:
        """Read noise in electrons, read_std / shot."""
        return tuple(
            _read_electrons(read, shot, covariance)
            for read, shot, covariance in zip(self.read_std, self.shot, self.covariance, strict=True)
        )


def read_frame(path: Path, encoding: Encoding) -> RepeatedFrame:
    """A photograph as its sensor gave it: of camera RAW the photosites of each colour, before demosaicing."""
    if is_raw(path):
        photosites = _photosites(path)
        if photosites is not None:
            return photosites
    image, rounding = decode_with_rounding(path, encoding)
    if not isinstance(encoding, Response):
        return RepeatedFrame(image.radiance, rounding, image.saturated)
    known = [np.flatnonzero(np.isfinite(curve))[0] for curve in encoding.log_exposure]
    return RepeatedFrame(
        image.radiance, rounding, image.saturated, np.exp(encoding.log_exposure[range(3), known])
    )


def recover_noise(photos: Iterable[Path], encoding: Encoding = "linear") -> NoiseRecovery:
    """Read and shot noise of each channel from repeated photographs of a static scene.

    photos : at least two of each exposure; photographs of one EXIF exposure whose brightness agrees within a tenth
        are compared with each other. All of one ISO. A minority of the scene may move, and the light may drift.
    encoding : of integer files; the numbers are those of the linear signal.
    ValueError names the photograph that has no repetition, another ISO or another size, or what spoils them all.
    """
    repeats: list[Repeats] = []
    members: list[list[Path]] = []
    gains: list[list[float]] = []
    settings: list[ExposureSettings] = []
    lossy = False
    for path in photos:
        frame, exposure = read_frame(path, encoding), read_exif_exposure(path)
        lossy |= check_header(path, read_file(path)).lossy
        _check_alike(path, frame, exposure, members, repeats, settings)
        for index, group in enumerate(repeats):
            if settings[index] == exposure and group.matches(gain := group.gain_of(frame)):
                group.add(frame, gain)
                members[index].append(path)
                gains[index].append(gain)
                break
        else:
            repeats.append(Repeats(frame))
            members.append([path])
            gains.append([1.0])
            settings.append(exposure)
    _check_repeated(members, repeats)
    fits = tuple(_fit(members, repeats, channel) for channel in range(3))
    return NoiseRecovery(
        read_std=tuple(_read_std(fit) for fit in fits),
        shot=tuple(_shot(fit) for fit in fits),
        covariance=np.array([fit.covariance for fit in fits]),
        fits=fits,
        groups=tuple(map(tuple, members)),
        gains=tuple(map(tuple, gains)),
        iso=settings[0].iso,
        lossy=lossy,
    )


def noise_document(recovery: NoiseRecovery) -> dict[str, Any]:
    """The numbers of a noise.json, RGB order; null where undetermined."""
    undetermined = [
        {"parameter": name, "channel": channel, "reason": part.reason, "remedy": part.remedy}
        for name, parts in (("read_std", recovery.read_std), ("shot", recovery.shot))
        for channel, part in zip(CHANNELS, parts, strict=True)
        if part.value is None
    ]
    return {
        "format": 1,
        "unit": "signal relative to the file's white level; variance = read_std^2 + shot * signal",
        "read_std": _columns(recovery.read_std),
        "shot": _columns(recovery.shot),
        "covariance": {
            "names": ["read_std^2", "shot"],
            "values": [_finite_rows(matrix) for matrix in recovery.covariance],
        },
        "full_well_electrons": _columns(recovery.full_well),
        "read_noise_electrons": _columns(recovery.read_electrons),
        "undetermined": undetermined,
        "warnings": recovery.warnings,
        "iso": recovery.iso,
        "moved_share": [fit.moved_share for fit in recovery.fits],
        "groups": [
            [{"photo": path.name, "gain": gain} for path, gain in zip(paths, gains, strict=True)]
            for paths, gains in zip(recovery.groups, recovery.gains, strict=True)
        ],
    }


def _photosites(path: Path) -> RepeatedFrame | None:
    """Red, green and blue photosites of a Bayer mosaic, (h/2, w/2, 3); None for any other sensor."""
    import rawpy

    image = read_raw(path)  # first: it says what is wrong with a damaged file
    with rawpy.imread(str(path)) as raw:
        if raw.raw_type != rawpy.RawType.Flat or raw.raw_pattern is None or raw.raw_pattern.shape != (2, 2):
            return None
        names = [chr(raw.color_desc[raw.raw_color(*cell)]) for cell in np.ndindex(2, 2)]
    if not set("RGB") <= set(names):
        return None
    rows, columns = (size // 2 * 2 for size in image.mosaic.shape)
    offsets = [divmod(names.index(colour), 2) for colour in "RGB"]
    signal = np.stack([image.mosaic[row:rows:2, column:columns:2] for row, column in offsets], axis=-1)
    if image.saturated.shape == image.mosaic.shape:
        cells = image.saturated[:rows, :columns].reshape(rows // 2, 2, columns // 2, 2)
        saturated = np.asarray(cells.any(axis=(1, 3)))
    else:  # pixels that aren't square were made so
        saturated = np.asarray((signal >= 1).any(axis=2))
    return RepeatedFrame(signal, np.full(signal.shape, image.step**2 / 12, np.float32), saturated)


def _check_alike(
    path: Path,
    frame: RepeatedFrame,
    exposure: ExposureSettings,
    members: Sequence[Sequence[Path]],
    repeats: Sequence[Repeats],
    settings: Sequence[ExposureSettings],
) -> None:
    if not repeats:
        return
    first = members[0][0]
    if frame.signal.shape != repeats[0].mean.shape:
        sizes = [f"{shape[1]}x{shape[0]}" for shape in (frame.signal.shape, repeats[0].mean.shape)]
        raise ValueError(
            f"{path}: is {sizes[0]} pixels, but {first.name} is {sizes[1]}; photographs of one camera and setting"
            " are needed"
        )
    if exposure.iso != settings[0].iso:
        raise ValueError(
            f"{path}: ISO is {exposure.iso}, but {first.name} has {settings[0].iso}; noise belongs to one ISO:"
            " calibrate each on its own"
        )


def _check_repeated(members: Sequence[Sequence[Path]], repeats: Sequence[Repeats]) -> None:
    if not members:
        raise ValueError("no photographs; give at least two of a static scene at one exposure")
    for paths, group in zip(members, repeats, strict=True):
        if len(paths) == 1:
            raise ValueError(
                f"{paths[0]}: no second photograph has its exposure (EXIF, and brightness within a tenth);"
                " repeat it without touching the camera or the light, or leave it out"
            )
        if not group.squares.any():
            raise ValueError(
                f"{paths[1]}: equals {paths[0].name} pixel by pixel; give photographs taken one after the other,"
                " not copies of one (or the noise is smaller than the steps of the file: use RAW or 16 bits)"
            )


def _fit(members: Sequence[Sequence[Path]], repeats: Sequence[Repeats], channel: int) -> TransferFit:
    try:
        return fit_transfer([tiles_of(group, channel) for group in repeats])
    except ValueError as error:
        raise ValueError(f"{members[0][0].parent}: {CHANNELS[channel]}: {error}") from error


def _read_std(fit: TransferFit) -> NoiseEstimate:
    std = float(np.sqrt(fit.covariance[0, 0]))
    dark = float(np.quantile(fit.tiles.signal, 0.01))
    step = float(np.sqrt(12 * np.median(fit.tiles.quantisation)))
    if not np.isfinite(std):
        return _hidden(step)
    at_most = float(np.sqrt(max(fit.offset + _ONE_SIDED * std, 0)))
    if fit.offset > _SIGNIFICANT * std:
        return NoiseEstimate(float(np.sqrt(fit.offset)), std / (2 * float(np.sqrt(fit.offset))), at_most)
    if at_most < step / 2:
        reason = f"it is hidden by the steps of the file, {step:.2g} wide"
        remedy = "photograph in RAW or 16 bits"
    else:
        reason = f"the darkest parts that aren't clipped are at {dark:.2g} of the white level, where shot noise rules"
        remedy = "photograph a scene with darker parts as well, or add a pair with a shorter exposure time"
    return NoiseEstimate(None, None, at_most, reason, remedy)


def _shot(fit: TransferFit) -> NoiseEstimate:
    std = float(np.sqrt(fit.covariance[1, 1]))
    if not np.isfinite(std):
        return _hidden(float(np.sqrt(12 * np.median(fit.tiles.quantisation))))
    at_most = max(fit.slope + _ONE_SIDED * std, 0.0)
    if fit.slope > _SIGNIFICANT * std:
        return NoiseEstimate(fit.slope, std, at_most)
    low, high = np.quantile(fit.tiles.signal, (0.01, 0.99))
    return NoiseEstimate(
        None,
        None,
        at_most,
        f"the noise doesn't rise with the signal from {low:.2g} to {high:.2g} of the white level",
        "photograph a scene with dark and bright parts, or add a pair with another exposure time",
    )


def _hidden(step: float) -> NoiseEstimate:
    # Noise of less than a fifth of a step, so that its variance is below this.
    return NoiseEstimate(
        None,
        None,
        step / 5,
        f"the noise is below a fifth of the file's steps, which are {step:.2g} wide",
        "photograph in RAW or 16 bits",
    )


def _full_well(shot: NoiseEstimate) -> NoiseEstimate:
    if shot.value is None or shot.std is None:
        return NoiseEstimate(None, None, None, shot.reason, shot.remedy)
    lowest = max(shot.value - _ONE_SIDED * shot.std, 1e-3 * shot.value)
    return NoiseEstimate(1 / shot.value, shot.std / shot.value**2, 1 / lowest)


def _read_electrons(read: NoiseEstimate, shot: NoiseEstimate, covariance: Floats) -> NoiseEstimate:
    if read.value is None or shot.value is None:
        failed = read if read.value is None else shot
        return NoiseEstimate(None, None, None, failed.reason, failed.remedy)
    slopes = np.array([1 / (2 * read.value * shot.value), -read.value / shot.value**2])
    std = float(np.sqrt(slopes @ covariance @ slopes))
    value = read.value / shot.value
    return NoiseEstimate(value, std, value + _ONE_SIDED * std)


def _columns(parts: Sequence[NoiseEstimate]) -> dict[str, list[float | None]]:
    return {
        "value": [part.value for part in parts],
        "std": [part.std for part in parts],
        "at_most": [part.at_most for part in parts],
    }


def _finite_rows(matrix: Floats) -> list[list[float]] | None:
    return matrix.tolist() if np.isfinite(matrix).all() else None
