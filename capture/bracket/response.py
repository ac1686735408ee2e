"""The camera response: which exposure each code of a file stands for, with standard deviations; response.json."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from capture.arrays import frozen_array
from capture.files.documents import read_json
from capture.files.tables import Table
from capture.radiance import CHANNELS

Floats = NDArray[np.float64]
_WHAT = "a response.json holds format and channels (log_exposure, log_std, clip), as `calibrate response` writes it"


@dataclass(frozen=True, eq=False)
class Response:
    """Log exposure against value, one curve per channel, at the values k / (n - 1).

    log_exposure : (3, n) float64, natural logarithm of the exposure relative to the white level; strictly
        increasing where known, NaN where the bracket left it undetermined. The scale of each channel is free: it
        is set so that the value nearest to 128/255 that is determined has the exposure that sRGB gives it.
    log_std : (3, n) float64, its standard deviation; NaN at the same values.
    clip : (3, 2) float64, the values at which the channel clips; outside 0 to 1 where it doesn't.
    """

    log_exposure: Floats
    log_std: Floats
    clip: Floats

    def __post_init__(self) -> None:
        for name in ("log_exposure", "log_std", "clip"):
            object.__setattr__(self, name, frozen_array(getattr(self, name)))
        shape = self.log_exposure.shape
        if len(shape) != 2 or shape[0] != 3 or shape[1] < 2 or self.log_std.shape != shape:
            raise ValueError(f"log_exposure {shape} and log_std {self.log_std.shape} must both be (3, n)")
        for name, curve, std in zip(CHANNELS, self.log_exposure, self.log_std, strict=True):
            known = np.isfinite(curve)
            if not np.array_equal(known, np.isfinite(std)) or (std[known] < 0).any():
                raise ValueError(f"{name}: log_std must be a number >= 0 just where log_exposure is one")
            if known.sum() < 2:
                raise ValueError(
                    f"{name}: the curve has {known.sum()} determined knots; it needs two or more"
                )
            falls = np.flatnonzero(np.diff(curve[known]) <= 0)
            if falls.size:
                value = np.linspace(0, 1, shape[1])[known][falls[0]]
                raise ValueError(
                    f"{name}: the curve does not increase at value {value:.4f}; it cannot be applied"
                )

    @property
    def values(self) -> Floats:
        """(n,) the values, 0 to 1, at which the curves are given."""
        return np.linspace(0, 1, self.log_exposure.shape[1])

    def exact(self) -> Response:
        """The same curve, taken to be known without error."""
        return replace(self, log_std=np.where(np.isfinite(self.log_std), 0.0, np.nan))

    def determined(self, channel: int) -> tuple[float, float]:
        """The least and the largest value at which a channel's curve is known."""
        known = self.values[np.isfinite(self.log_exposure[channel])]
        return float(known[0]), float(known[-1])

    def table(self, levels: int) -> Floats:
        """Relative exposure of every code 0 to `levels`, (3, levels + 1).

        Below the determined range it falls in proportion to the value above black, above it it stays (`brightest`
        says where), and it crosses gaps on a straight line.
        """
        return self._tables(levels)[0]

    def variance_table(self, levels: int) -> Floats:
        """Variance (3, levels + 1) of the exposures of `table`, from the curve alone: noise and quantisation come on
        top. Where the curve is undetermined it is that of anything between its nearest determined neighbours, or
        darkness."""
        return self._tables(levels)[1]

    def brightest(self, levels: int) -> NDArray[np.intp]:
        """(3,) the brightest code of each channel whose exposure is known; those above count as saturated."""
        tops = [self.determined(channel)[1] for channel in range(3)]
        return np.minimum(np.floor(np.array(tops) * levels + 1e-6).astype(np.intp), levels - 1)

    def _tables(self, levels: int) -> tuple[Floats, Floats]:
        values = np.arange(levels + 1) / levels
        exposure, variance = np.empty((3, levels + 1)), np.empty((3, levels + 1))
        for channel in range(3):
            known = np.flatnonzero(np.isfinite(self.log_exposure[channel]))
            knots, log_curve = self.values[known], self.log_exposure[channel, known]
            curve, std = np.exp(log_curve), self.log_std[channel, known]
            # Between neighbouring knots the logarithm is straight.
            exposure[channel] = np.exp(np.interp(values, knots, log_curve))
            variance[channel] = (exposure[channel] * np.interp(values, knots, std)) ** 2
            black = max(float(self.clip[channel, 0]), 0.0)
            dark = values < knots[0] - 1e-9
            exposure[channel, dark] = curve[0] * np.clip((values[dark] - black) / (knots[0] - black), 0, 1)
            variance[channel, dark] = curve[0] ** 2 / 12
            for left in np.flatnonzero(np.diff(known) > 1):
                ends = slice(left, left + 2)
                across = (values > knots[left]) & (values < knots[left + 1])
                exposure[channel, across] = np.interp(values[across], knots[ends], curve[ends])
                variance[channel, across] = np.ptp(curve[ends]) ** 2 / 12
        return exposure, variance

    def linear(self, codes: NDArray[np.unsignedinteger]) -> NDArray[np.float32]:
        """Relative exposure (h, w, 3) float32 of 8- or 16-bit codes (h, w, 3)."""
        exposure = self.table(int(np.iinfo(codes.dtype).max)).astype(np.float32)
        return np.stack([exposure[channel][codes[..., channel]] for channel in range(3)], axis=-1)


class _ResponseFile(Table):
    format: Literal[1]
    channels: dict[str, dict[str, Any]]


def response_channels(response: Response) -> dict[str, object]:
    """The channels of a response as response.json holds them; null where undetermined."""

    def numbers(array: Floats) -> list[float | None]:
        return [float(f"{number:.7g}") if np.isfinite(number) else None for number in array]

    return {
        name: {
            "log_exposure": numbers(response.log_exposure[index]),
            "log_std": numbers(response.log_std[index]),
            "determined": list(response.determined(index)),
            "clip": [value if 0 <= value <= 1 else None for value in response.clip[index].tolist()],
        }
        for index, name in enumerate(CHANNELS)
    }


def read_response(path: Path) -> Response:
    """Read a response.json. ValueError names the file and what is wrong with it."""
    raw = read_json(path, _ResponseFile, ("format", "channels"), _WHAT)
    curves, stds, clips = [], [], []
    for name in CHANNELS:
        channel = raw.channels.get(name)
        if channel is None:
            raise ValueError(f"{path}: lacks the channel {name!r}; {_WHAT}")
        try:
            curves.append(np.array(channel["log_exposure"], float))
            stds.append(np.array(channel["log_std"], float))
            low, high = channel["clip"]
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"{path}: channel {name!r} cannot be read ({error}); {_WHAT}") from error
        clips.append((-1.0 if low is None else float(low), 2.0 if high is None else float(high)))
    try:
        return Response(np.array(curves), np.array(stds), np.array(clips))
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
