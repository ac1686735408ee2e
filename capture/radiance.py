"""What a photograph says of the light: linear radiance, its variance, and where the sensor was saturated."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from capture.arrays import frozen_view
from capture.blocks import block_means, blocks

Image = NDArray[np.float32]
Places = NDArray[np.integer]

# Names of the channels, in the order of radiance's last axis.
CHANNELS = ("red", "green", "blue")
# JPEG compression, in TIFF as well, spreads a clipped pixel's loss over its block of 8, two where colour is halved:
# what is within this neighbourhood of it is unknown, too.
LOSSY_REACH = np.ones((9, 9), np.uint8)


class RadianceImage:
    """What the sensor saw, linear.

    radiance : (h, w, 3) float32, relative units; 1 is the white level of an integer file at the exposure that the
        set takes as its unit. RAW files may be slightly negative: noise about black.
    variance : (h, w, 3) float32, of the noise: read noise, shot noise and quantisation. Given as an array, or as a
        function that makes it at first use: many readers never ask, and it is as large as the radiance.
    variance_at : gives the variance (n, 3) of a few pixels, by their rows and columns (n,), without making all of it.
    saturated : (h, w) bool, true where any channel is at the file's white level, or where floats were cut off; in JPEG
        files also within four pixels of there, in RAW files within the reach of demosaicing.
    """

    def __init__(
        self,
        radiance: Image,
        variance: Image | Callable[[], Image],
        saturated: NDArray[np.bool_],
        variance_at: Callable[[Places, Places], Image] | None = None,
    ) -> None:
        self.radiance: Image = frozen_view(radiance, np.float32)
        self.saturated: NDArray[np.bool_] = frozen_view(saturated, np.bool_)
        self._variance = variance
        self._variance_at = variance_at
        if self.radiance.shape[2:] != (3,):
            raise ValueError(f"radiance is {self.radiance.shape}; it must be (h, w, 3)")
        if self.saturated.shape != self.radiance.shape[:2]:
            raise ValueError(f"saturated is {self.saturated.shape}, the image {self.radiance.shape[:2]}")
        if not callable(variance):
            self._check(variance)

    @classmethod
    def black(cls, height: int, width: int) -> RadianceImage:
        """A photograph that nobody has taken, without noise; it takes no memory."""
        nothing = np.broadcast_to(np.float32(0), (height, width, 3))
        return cls(nothing, nothing, np.broadcast_to(np.False_, (height, width)))

    @cached_property
    def variance(self) -> Image:
        variance = self._variance() if callable(self._variance) else self._variance
        self._check(variance)
        view: Image = frozen_view(variance, np.float32)
        return view

    def binned(self, factor: int) -> RadianceImage:
        """Means over `factor` by `factor` pixels, saturated where one of them is; what fills none is cut off.

        Noise counts as independent from pixel to pixel.
        """
        return RadianceImage(
            block_means(self.radiance, factor),
            lambda: block_means(self.variance, factor) / np.float32(factor**2),
            np.asarray(blocks(self.saturated, factor).any(axis=(1, 3))),
        )

    def noiseless(self) -> RadianceImage:
        """The same with variance 0, for who asks for no noise: that of a JPEG's codes takes longer than decoding it."""
        nothing = np.broadcast_to(np.float32(0), self.radiance.shape)
        return RadianceImage(self.radiance, nothing, self.saturated)

    def variance_at(self, rows: Places, columns: Places) -> Image:
        """The variance (n, 3) float32 of pixels by their rows and columns (n,)."""
        if self._variance_at is None or "variance" in self.__dict__:
            return np.asarray(self.variance[rows, columns])
        return self._variance_at(rows, columns)

    def _check(self, variance: Image) -> None:
        if variance.shape != self.radiance.shape:
            raise ValueError(
                f"radiance {self.radiance.shape} and variance {variance.shape} must both be (h, w, 3)"
            )
