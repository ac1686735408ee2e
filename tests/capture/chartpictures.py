"""Photographs of colour charts, drawn: a frame, patches in rows, turned and tilted, unevenly lit, with noise."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# What the frame and the table under the chart reflect.
_FRAME, _TABLE = 0.04, 0.45
# Pixels of a patch's cell in the drawing, and the part of it that is colour.
_CELL, _COLOURED = 80, 0.82


@dataclass(frozen=True)
class Shot:
    """How a chart is photographed. slope : of the light, per picture width, to the right and down. glare : of white."""

    turn_deg: float = 0.0
    tilt: float = 0.0
    size: float = 0.7
    slope: tuple[float, float] = (0.0, 0.0)
    noise: float = 0.0
    glare: float = 0.0
    shift: tuple[float, float] = (0.0, 0.0)


def flat_chart(reflectance: Floats, columns: int, down: bool = False) -> NDArray[np.float32]:
    """A chart (h, w, 3) seen from straight above, patches (n, 3) row by row, or down the columns."""
    rows = len(reflectance) // columns
    drawn = np.full(((rows + 1) * _CELL, (columns + 1) * _CELL, 3), _FRAME, np.float32)
    edge = round((1 - _COLOURED) / 2 * _CELL)
    for k, colour in enumerate(reflectance):
        column, row = divmod(k, rows) if down else divmod(k, columns)[::-1]
        y, x = (np.array([row, column]) * _CELL + _CELL // 2).tolist()
        drawn[y + edge : y + _CELL - edge, x + edge : x + _CELL - edge] = colour
    return drawn


def photographed(
    chart: NDArray[np.float32], camera: Floats, shot: Shot, rng: np.random.Generator, width: int = 600
) -> NDArray[np.float32]:
    """A photograph (h, w, 3), linear camera RGB by a matrix (3, 3) of linear sRGB; a perfect white shows 0.8."""
    height = width * 2 // 3
    h, w = chart.shape[:2]
    scale = shot.size * min(width / w, height / h)
    angle = np.radians(shot.turn_deg)
    turn = scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    move = np.eye(3)
    move[:2, :2] = turn
    move[:2, 2] = np.array([width, height]) * (0.5 + np.array(shot.shift)) - turn @ [w / 2, h / 2]
    perspective = np.eye(3)
    perspective[2, 0] = shot.tilt / width
    centred = np.array([[1, 0, -width / 2], [0, 1, -height / 2], [0, 0, 1]])
    warp = np.linalg.inv(centred) @ perspective @ centred @ move
    # Drawn three times as large, then averaged, as pixels average.
    fine = np.diag([3.0, 3.0, 1.0]) @ warp
    seen = cv2.warpPerspective(chart, fine, (3 * width, 3 * height), borderValue=(_TABLE,) * 3)
    seen = cv2.resize(seen, (width, height), interpolation=cv2.INTER_AREA)
    x, y = np.meshgrid(np.arange(width) / width - 0.5, np.arange(height) / width - 1 / 3)
    light = 1 + shot.slope[0] * x + shot.slope[1] * y
    linear = 0.8 * (light[..., None] * seen + shot.glare) @ camera.T
    return np.asarray(linear + shot.noise * rng.standard_normal(linear.shape), np.float32)
