"""A polynomial texture map: pictures that viewers of museums relight, as RTI domes give them.

    L(u, v) = a_1 u^2 + a_2 v^2 + a_3 u v + a_4 u + a_5 v + a_6

u and v are the lamp's direction to the right and up; a pixel shows L times its colour [Malzbender, Gelb, Wolters,
"Polynomial texture maps", 2001, eq. 2]. Files are HP's PTM 1.2, LRGB: six bytes of coefficients for each pixel, then
three of its colour, rows from the bottom; a coefficient is (byte - bias) scale. L and colours are in sRGB's codes, 255
for white: viewers show them as they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from capture.srgb import linear_to_srgb
from invrender.photometric_stereo.stack import PixelStack

Floats = NDArray[np.float64]
# Photographs that six coefficients take, and the share of all samples that isn't cut off at white.
FEWEST_PHOTOS, _BELOW_WHITE = 6, 0.995


@dataclass(frozen=True, eq=False)
class PolynomialTexture:
    """Coefficients (p, 6) of L, 0 to 255, and colours (p, 3), 0 to 1, of pixels."""

    coefficients: Floats
    colours: Floats

    def shown(self, lamp: Floats) -> Floats:
        """sRGB codes (p, 3), 0 to 255, under a lamp in a unit direction (3,)."""
        level = self.coefficients @ _terms(lamp[None])[0]
        return np.asarray(np.clip(level[:, None] * self.colours, 0, 255))


def polynomial_texture(stack: PixelStack) -> PolynomialTexture:
    """The polynomials nearest to photographs under lamps of equal strength; ValueError with fewer than six."""
    if stack.photos < FEWEST_PHOTOS:
        raise ValueError(
            f"a polynomial texture map takes {FEWEST_PHOTOS} photographs; there are {stack.photos}"
        )
    white = float(np.quantile(stack.reflected, _BELOW_WHITE))
    codes = linear_to_srgb(np.clip(stack.reflected / max(white, 1e-300), 0, 1).astype(float))
    colours = codes.mean(axis=1)
    colours = colours / np.maximum(colours.max(axis=1, keepdims=True), 1e-12)
    levels = np.einsum("pjc,pc->pj", codes, colours) / np.maximum((colours**2).sum(axis=1), 1e-12)[:, None]
    design = _terms(stack.lamps.mean(axis=0))
    return PolynomialTexture(255 * levels @ np.linalg.pinv(design).T, colours)


def write_ptm(path: Path, found: PolynomialTexture, inside: NDArray[np.bool_]) -> None:
    """Write a .ptm; inside : (h, w), the pixels, in the texture's order; the others are black."""
    low, high = found.coefficients.min(axis=0), found.coefficients.max(axis=0)
    scales = np.maximum(high - low, 1e-6) / 255
    biases = np.round(-low / scales).astype(int)
    bytes_of = np.empty((*inside.shape, 6), np.uint8)
    # Of nothing, whose colour is black anyway.
    bytes_of[:] = np.clip(biases, 0, 255)
    bytes_of[inside] = np.clip(np.round(found.coefficients / scales + biases), 0, 255)
    colours = np.zeros((*inside.shape, 3), np.uint8)
    colours[inside] = np.round(255 * found.colours)
    height, width = inside.shape
    header = "\n".join(
        [
            "PTM_1.2",
            "PTM_FORMAT_LRGB",
            str(width),
            str(height),
            " ".join(f"{scale:.9g}" for scale in scales),
            " ".join(map(str, biases)),
            "",
        ]
    )
    path.write_bytes(header.encode("ascii") + bytes_of[::-1].tobytes() + colours[::-1].tobytes())


def _terms(lamps: Floats) -> Floats:
    """The polynomial's terms (j, 6) of directions (j, 3)."""
    u, v = lamps[:, 0], lamps[:, 1]
    return np.stack([u**2, v**2, u * v, u, v, np.ones_like(u)], axis=1)
