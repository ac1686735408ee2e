"""Photographs of an even surface, checked and reduced to means over tiles."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from capture.arrays import frozen_array
from capture.blocks import blocks
from capture.radiance import RadianceImage
from capture.sensor.flatfield import LEAST_ILLUMINATION, half_diagonal
from capture.sensor.rounding import decode_with_rounding

if TYPE_CHECKING:
    from capture.decode import Encoding

Floats = NDArray[np.float64]

# Tiles along the longer side.
_ACROSS = 32
_MOST_SATURATED = 1e-3
# Structure within tiles, relative: lenses and lamps make a few percent, texture makes more.
_MOST_TEXTURE = 0.1
_MOST_NOISE = 0.3
# The step between codes relative to the signal.
_COARSEST_STEP = 0.05


@dataclass(frozen=True, eq=False)
class FlatTiles:
    """Means over tiles of flat-field photographs.

    width, height : pixels. signal : (p, t, 3) float64 of photo, tile, channel. relative_std : (p, t, 3) of the mean.
    position : (t, 4, 2) four points in each tile, over which to average a smooth function (Gauss points), from the
        image centre in units of half the diagonal.
    grid : rows and columns of tiles. block : (t,) int, tiles of one neighbourhood.
    """

    width: int
    height: int
    signal: Floats
    relative_std: Floats
    position: Floats
    grid: tuple[int, int]
    block: NDArray[np.intp]

    def __post_init__(self) -> None:
        for name in ("signal", "relative_std", "position"):
            object.__setattr__(self, name, frozen_array(getattr(self, name)))


def read_flat(path: Path, encoding: Encoding) -> RadianceImage:
    """A flat-field photograph, its variance what JPEG compression lost; ValueError if it can't serve as one."""
    image, rounding = decode_with_rounding(path, encoding)
    share = float(image.saturated.mean())
    if share > _MOST_SATURATED:
        raise ValueError(
            f"{path}: {share:.1%} of it is saturated; expose less, so that the brightest part is at about half of"
            " the white level"
        )
    level = np.median(image.radiance[::4, ::4].reshape(-1, 3), axis=0)
    step = np.sqrt(12 * np.median(rounding[::4, ::4].reshape(-1, 3), axis=0))
    if not (level > 0).all() or (step > _COARSEST_STEP * level).any():
        raise ValueError(
            f"{path}: is too dark for a flat field (median {level.min():.2g} of the white level, steps of"
            f" {step.max():.2g}); expose more, so that the brightest part is at about half of the white level"
        )
    return RadianceImage(image.radiance, lambda: np.maximum(image.variance - rounding, 0), image.saturated)


def flat_tiles(photos: Iterable[tuple[Path, RadianceImage]]) -> FlatTiles:
    """Reduce photographs of one size to tiles; ValueError names the photograph that isn't flat, or of another size."""
    reduced: list[tuple[Floats, Floats]] = []
    size, first = (0, 0), Path()
    for path, image in photos:
        if not reduced:
            size, first = image.saturated.shape, path
        if image.saturated.shape != size:
            raise ValueError(
                f"{path}: is {image.saturated.shape[1]}x{image.saturated.shape[0]} pixels, but {first.name} is"
                f" {size[1]}x{size[0]}; photographs of one camera and setting are needed"
            )
        height, width = size
        side = max(max(width, height) // _ACROSS, 4)
        down, across = height // side, width // side
        if min(down, across) < 6:
            raise ValueError(f"{path}: is {width}x{height} pixels; a flat field needs at least 24x24")
        reduced.append(_reduce(path, image, side, down, across))
    if not reduced:
        raise ValueError("no photographs; give at least one of an evenly lit surface")
    # A border narrower than a tile is left out, evenly on both sides.
    left, top = (width - across * side) / 2, (height - down * side) / 2
    gauss = side / 2 * (1 + np.array([-1, 1]) / np.sqrt(3))
    x = left // 1 + np.arange(across)[:, None] * side + gauss - width / 2
    y = top // 1 + np.arange(down)[:, None] * side + gauss - height / 2
    position = np.empty((down, across, 2, 2, 2))
    position[..., 0] = x[None, :, None, :]
    position[..., 1] = y[:, None, :, None]
    rows, columns = np.indices((down, across)) // 4
    return FlatTiles(
        width=width,
        height=height,
        signal=np.array([signal for signal, _ in reduced]),
        relative_std=np.array([std for _, std in reduced]),
        position=position.reshape(-1, 4, 2) / half_diagonal(width, height),
        grid=(down, across),
        block=(rows * (across // 4 + 1) + columns).ravel(),
    )


def _reduce(path: Path, image: RadianceImage, side: int, down: int, across: int) -> tuple[Floats, Floats]:
    """Mean of each tile without its outliers (dead pixels, dust), and its relative standard deviation; (t, 3) each."""
    height, width = image.saturated.shape
    top, left = (height - down * side) // 2, (width - across * side) // 2
    cut = image.radiance[top : top + down * side, left : left + across * side]
    tiles = blocks(cut, side).swapaxes(1, 2)
    kept = np.ones(tiles.shape, bool)
    for _ in range(3):
        count = kept.sum(axis=(2, 3))
        mean = np.where(kept, tiles, 0).sum(axis=(2, 3), dtype=float) / count
        deviation = tiles - mean[:, :, None, None].astype(np.float32)
        spread = np.sqrt(np.where(kept, deviation**2, 0).sum(axis=(2, 3), dtype=float) / count)
        kept = np.abs(deviation) <= 4 * spread[:, :, None, None] + 1e-12
    # Neighbours differ by noise alone, where the whole tile may slope.
    pairs = kept[:, :, :, 1:] & kept[:, :, :, :-1]
    difference = np.where(pairs, tiles[:, :, :, 1:] - tiles[:, :, :, :-1], 0)
    noise = (difference**2).sum(axis=(2, 3), dtype=float) / (2 * np.maximum(pairs.sum(axis=(2, 3)), 1))
    if (
        not (mean > 0).all()
        or float((mean.min(axis=(0, 1)) / mean.max(axis=(0, 1))).min()) < LEAST_ILLUMINATION
    ):
        raise ValueError(
            f"{path}: its darkest part has less than {LEAST_ILLUMINATION:.0%} of the light of the brightest; light"
            " the surface evenly and fill the whole picture with it, or crop what the lens leaves dark"
        )
    grain = float(np.median(np.sqrt(noise) / mean))
    if grain > _MOST_NOISE:
        raise ValueError(
            f"{path}: pixels differ from their neighbours by {grain:.0%}; it is too dark or its surface is"
            " textured. Photograph an even surface out of focus, exposed to about half of the white level"
        )
    texture = float(np.median(np.sqrt(np.maximum(spread**2 - noise, 0)) / mean))
    if texture > _MOST_TEXTURE:
        raise ValueError(
            f"{path}: brightness varies by {texture:.0%} within small parts of it; photograph an even surface, out"
            " of focus"
        )
    # Rounding has no mercy for a noiseless photograph: 1e-6 is float32's.
    relative = np.sqrt(np.maximum(noise / count, 0)) / mean + 1e-6
    return mean.reshape(-1, 3), relative.reshape(-1, 3)
