"""Where a colour chart lies in a photograph: found by OpenCV, then drawn to the patches themselves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from capture.chart.chart import GRIDS, Chart
from capture.radiance import Image
from capture.srgb import linear_to_srgb

Floats = NDArray[np.float64]

# OpenCV looks at pictures so large, pixels across.
_LONGEST = 1500
# Share of the brightest pixels that may be white in what is looked at.
_WHITE = 0.995
# Of a patch's cell, the side of the square that patches are read in, and that colour is followed in from its middle.
_READ, _FOLLOWED = 0.4, 1.6
# Codes by which a patch's pixels differ from their neighbours at most, noise included; its area over a cell's.
_EVEN, _AREAS = 3, (0.25, 1.1)
# Shares of a cell that a patch may lie beside the grid; rounds of drawing it to the patches.
_BESIDE, _ROUNDS = 0.12, 3
# Of the colours' variance, what no matrix explains of a chart's.
_ALIKE = 0.3
# Share of the patches that have to be found for the grid to be drawn to them.
_ENOUGH = 0.5


@dataclass(frozen=True, eq=False)
class FoundChart:
    """A chart in a photograph.

    places : (n, 2) of the middles of its patches on the chart, as of `Chart.places`. to_image : (3, 3), pixels from
    places.
    """

    places: Floats
    to_image: Floats

    def patches(self, share: float = _READ) -> Floats:
        """Corners (n, 4, 2) in pixels of the middle of each patch, `share` of its cell's side."""
        corners = share * np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
        places = self.places[:, None] + corners
        found = cv2.perspectiveTransform(places.reshape(1, -1, 2), self.to_image)
        return np.asarray(found, float).reshape(places.shape)


def find_chart(radiance: Image, chart: Chart) -> FoundChart:
    """The chart in a photograph (h, w, 3), linear; ValueError where there is none, or two, or one of another layout."""
    height, width = radiance.shape[:2]
    zoom = min(1.0, _LONGEST / max(height, width))
    level = np.quantile(radiance[::4, ::4], _WHITE, axis=(0, 1))
    codes = 255 * linear_to_srgb(np.clip(radiance / np.maximum(level, 1e-12), 0, 1))
    picture = np.asarray(codes.round()[..., ::-1], np.uint8)
    small = np.asarray(cv2.resize(picture, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_AREA), np.uint8)
    found = _detected(small, chart.layout)
    if not found:
        others = [layout for layout in GRIDS if layout != chart.layout and _detected(small, layout)]
        if others:
            raise ValueError(
                f"no {chart.layout} chart is found, but one laid out like {others[0]}: name that one"
            )
        raise ValueError(
            f"no {chart.layout} chart is found: all of it must be in the picture, with its frame, on 5% of the picture"
            " or more, and neither blurred nor shaded"
        )
    grids = [FoundChart(chart.places, _zoomed(to_image, 1 / zoom)) for to_image in found]
    for _ in range(_ROUNDS):
        grids = [_drawn_to_patches(picture, grid) for grid in grids]
    ways = sorted((_upright(radiance, grid, chart) for grid in grids), key=lambda way: way[0])
    alike = [grid for misfit, grid in ways if misfit < _ALIKE]
    if len(alike) > 1:
        raise ValueError(
            f"{len(alike)} charts are found: leave one of them in the picture, or cut the other off"
        )
    grid = ways[0][1]
    corners = grid.patches()
    if corners.min() < 0 or (corners.max(axis=(0, 1)) > [width, height]).any():
        raise ValueError("the chart reaches beyond the picture: photograph all of it, with its frame")
    return grid


def _detected(picture: NDArray[np.uint8], layout: str) -> list[Floats]:
    """Charts in a picture as `FoundChart.to_image`, either way up."""
    detector: Any = cv2.mcc.CCheckerDetector.create()
    detector.setColorChartType(getattr(cv2.mcc, layout))
    if not detector.process(picture, 2):
        return []
    columns, rows = GRIDS[layout]
    grid = np.array([[column + 0.5, row + 0.5] for row in range(rows) for column in range(columns)])
    found: list[Floats] = []
    taken: list[Floats] = []
    for chart in sorted(detector.getListColorChecker(), key=lambda chart: float(chart.getCost())):
        # OpenCV tells patches row by row of pixels, of some layouts from the bottom.
        middles = np.asarray(chart.getColorCharts(), float).reshape(-1, 4, 2).mean(axis=1)
        across, down = middles[columns - 1] - middles[0], middles[-columns] - middles[0]
        if across[0] * down[1] < across[1] * down[0]:
            middles = middles.reshape(rows, columns, 2)[::-1].reshape(-1, 2)
        size = float(np.linalg.norm(np.ptp(middles, axis=0)))
        if size < 1 or any(np.linalg.norm(middles.mean(axis=0) - own) < size / 4 for own in taken):
            continue
        taken.append(middles.mean(axis=0))
        found.append(np.asarray(cv2.findHomography(grid, middles)[0], float))
    return found


def _upright(radiance: Image, grid: FoundChart, chart: Chart) -> tuple[float, FoundChart]:
    """The grid the way up in which its colours are the chart's, and their misfit, as well as a matrix makes them.

    The misfit is the share of the colours' variance that is left.
    """
    columns, rows = GRIDS[chart.layout]
    turned = np.array([[-1.0, 0.0, columns], [0.0, -1.0, rows], [0.0, 0.0, 1.0]])
    ways = [grid, FoundChart(grid.places, grid.to_image @ turned)]
    height, width = radiance.shape[:2]

    def off(way: FoundChart) -> float:
        x, y = np.clip(way.patches().mean(axis=1).round().astype(int), 0, [width - 1, height - 1]).T
        seen = radiance[y, x].astype(float)
        matrix = np.linalg.lstsq(seen, chart.srgb, rcond=None)[0]
        variance = ((chart.srgb - chart.srgb.mean(axis=0)) ** 2).sum()
        return float(((seen @ matrix - chart.srgb) ** 2).sum() / variance)

    best = min(ways, key=off)
    return off(best), best


def _zoomed(to_image: Floats, zoom: float) -> Floats:
    # Pixel centres lie at + 0.5 in OpenCV's resizing, at integers elsewhere in it.
    shift = (zoom - 1) / 2
    return np.asarray(np.array([[zoom, 0, shift], [0, zoom, shift], [0, 0, 1]]) @ to_image)


def _drawn_to_patches(picture: NDArray[np.uint8], grid: FoundChart) -> FoundChart:
    """The grid through the middles of patches as far as their colour goes; as it was where too few are seen so."""
    cells, inner = grid.patches(_FOLLOWED), grid.patches()
    centres, measured = [], []
    smooth = np.asarray(cv2.medianBlur(picture, 5), np.uint8)
    for cell, own, place in zip(cells, inner, grid.places, strict=True):
        seen = _middle_of_colour(smooth, cell, own)
        if seen is not None:
            centres.append(place)
            measured.append(seen)
    if len(centres) < _ENOUGH * len(cells):
        return grid
    step = np.sqrt(cv2.contourArea(cells[0].astype(np.float32))) / _FOLLOWED
    found, _ = cv2.findHomography(
        np.array(centres), np.array(measured), cv2.RANSAC, ransacReprojThreshold=_BESIDE * step
    )
    return grid if found is None else FoundChart(grid.places, np.asarray(found, float))


def _middle_of_colour(picture: NDArray[np.uint8], cell: Floats, inner: Floats) -> Floats | None:
    """The middle (2,) of what has the colour of a cell's middle; None where that isn't a patch's size."""
    height, width = picture.shape[:2]
    low = np.maximum(np.floor(cell.min(axis=0)).astype(int), 0)
    high = np.minimum(np.ceil(cell.max(axis=0)).astype(int) + 1, [width, height])
    x, y = np.round(inner.mean(axis=0) - low).astype(int).tolist()
    if not (0 <= x < high[0] - low[0] and 0 <= y < high[1] - low[1]):
        return None
    part = np.ascontiguousarray(picture[low[1] : high[1], low[0] : high[0]])
    mask = np.full((part.shape[0] + 2, part.shape[1] + 2), 1, np.uint8)
    inside = np.zeros(part.shape[:2], np.uint8)
    cv2.fillConvexPoly(inside, np.round(cell - low).astype(np.int32), 1)
    mask[1:-1, 1:-1] = 1 - inside
    step = (_EVEN,) * 3
    area, *_ = cv2.floodFill(
        part, mask, (x, y), (0, 0, 0), step, step, 4 | cv2.FLOODFILL_MASK_ONLY | (2 << 8)
    )
    wanted = cv2.contourArea(cell.astype(np.float32)) / _FOLLOWED**2
    if not _AREAS[0] * wanted < area < _AREAS[1] * wanted:
        return None
    # Of the hull: dust doesn't shift it.
    points = cv2.findNonZero((mask[1:-1, 1:-1] == 2).astype(np.uint8))
    moments = cv2.moments(cv2.convexHull(points))
    if not moments["m00"]:
        return None
    return low + np.array([moments["m10"], moments["m01"]]) / moments["m00"]
