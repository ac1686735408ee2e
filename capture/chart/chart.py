"""What the patches of a colour chart reflect: charts that are known, and a file of one's own."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from capture.arrays import frozen_array
from capture.chart.colorspaces import lab_d50_to_srgb, srgb_to_lab
from capture.files.imagefile import read_file
from capture.reflectance.spectra import reflectance_to_srgb

Floats = NDArray[np.float64]

# Columns and rows of patches, by layout.
GRIDS = {"MCC24": (6, 4), "SG140": (14, 10)}
# Patches whose a* and b* are below this are grey.
_GREY = 4.0
# CIE L*a*b* (D50, 2 degrees) of the ColorChecker Classic, by its maker: as made since November 2014, and before.
# fmt: off
_SINCE_2014 = {
    "dark skin": (37.54, 14.37, 14.92), "light skin": (64.66, 19.27, 17.50), "blue sky": (49.32, -3.82, -22.54),
    "foliage": (43.46, -12.74, 22.72), "blue flower": (54.94, 9.61, -24.79), "bluish green": (70.48, -32.26, -0.37),
    "orange": (62.73, 35.83, 56.50), "purplish blue": (39.43, 10.75, -45.17), "moderate red": (50.57, 48.64, 16.67),
    "purple": (30.10, 22.54, -20.87), "yellow green": (71.77, -24.13, 58.19), "orange yellow": (71.51, 18.24, 67.37),
    "blue": (28.37, 15.42, -49.80), "green": (54.38, -39.72, 32.27), "red": (42.43, 51.05, 28.62),
    "yellow": (81.80, 2.67, 80.41), "magenta": (50.63, 51.28, -14.12), "cyan": (49.57, -29.71, -28.32),
    "white": (95.19, -1.03, 2.93), "neutral 8": (81.29, -0.57, 0.44), "neutral 6.5": (66.89, -0.75, -0.06),
    "neutral 5": (50.76, -0.13, 0.14), "neutral 3.5": (35.63, -0.46, -0.48), "black": (20.64, 0.07, -0.46),
}
_BEFORE_2014 = np.array([
    (37.986, 13.555, 14.059), (65.711, 18.130, 17.810), (49.927, -4.880, -21.925), (43.139, -13.095, 21.905),
    (55.112, 8.844, -25.399), (70.719, -33.397, -0.199), (62.661, 36.067, 57.096), (40.020, 10.410, -45.964),
    (51.124, 48.239, 16.248), (30.325, 22.976, -21.587), (72.532, -23.709, 57.255), (71.941, 19.363, 67.857),
    (28.778, 14.179, -50.297), (55.261, -38.342, 31.370), (42.101, 53.378, 28.190), (81.733, 4.039, 79.819),
    (51.935, 49.986, -14.574), (51.038, -28.631, -28.638), (96.539, -0.425, 1.186), (81.257, -0.638, -0.335),
    (66.766, -0.734, -0.504), (50.867, -0.153, -0.270), (35.656, -0.421, -1.231), (20.461, -0.079, -0.973),
])
# fmt: on
CHARTS = ("MCC24", "MCC24-2005", "SG140")
_SPECTRAL_NM = (400.0, 700.0)


@dataclass(frozen=True, eq=False)
class Chart:
    """A chart's patches, in the order of their numbers.

    layout : "MCC24" or "SG140". names : of the patches. srgb : (n, 3) float64, linear sRGB that they show in daylight
    (D65) that shows a perfect white as 1.
    """

    layout: str
    names: tuple[str, ...]
    srgb: Floats

    def __post_init__(self) -> None:
        object.__setattr__(self, "srgb", frozen_array(self.srgb))

    @cached_property
    def places(self) -> Floats:
        """Where patches have their middles (n, 2): column and row, each from its border, in cells."""
        columns, rows = GRIDS[self.layout]
        if self.layout == "SG140":
            # Numbered down the columns.
            return np.array([[x + 0.5, y + 0.5] for x in range(columns) for y in range(rows)])
        return np.array([[x + 0.5, y + 0.5] for y in range(rows) for x in range(columns)])

    @cached_property
    def greys(self) -> NDArray[np.int64]:
        """Which patches are grey."""
        lab = srgb_to_lab(self.srgb)
        return np.flatnonzero(np.abs(lab[:, 1:]).max(axis=1) < _GREY)


def read_chart(named: str) -> Chart:
    """A chart by its name in `CHARTS`, or from a CSV of what its patches are; ValueError for others.

    MCC24 is the ColorChecker Classic as made since November 2014, MCC24-2005 as made before, SG140 the Digital SG.
    The file has a line per patch, in the order of the chart's own numbers: name, L, a, b (CIE, D50, 2 degrees), or a
    name and reflectances (0 to 1) in columns that are named by their wavelengths in nm. 24 lines are a chart laid out
    like the ColorChecker Classic, 140 one like the ColorChecker Digital SG.
    """
    if (name := named.upper()) in CHARTS:
        return _sg140() if name == "SG140" else _classic(name)
    path = Path(named)
    if path.suffix.lower() != ".csv":
        raise ValueError(
            f"{named!r} is no chart that is known: give {', '.join(CHARTS)}, or a .csv of your own chart"
        )
    return _from_csv(path)


def _classic(name: str) -> Chart:
    lab = np.array(list(_SINCE_2014.values())) if name == "MCC24" else _BEFORE_2014
    return Chart("MCC24", tuple(_SINCE_2014), lab_d50_to_srgb(lab))


def _sg140() -> Chart:
    """The chart as OpenCV knows it, which tells its linear sRGB to whoever fits a matrix."""
    import cv2

    even = np.full((140, 1, 3), 0.5)
    model = cv2.ccm.ColorCorrectionModel(even, cv2.ccm.COLORCHECKER_DIGITAL_SG)
    model.setLinearization(cv2.ccm.LINEARIZATION_IDENTITY)
    model.compute()
    srgb = np.asarray(model.getRefLinearRGB(), float).reshape(-1, 3)
    names = tuple(f"{column}{row}" for column in "ABCDEFGHIJKLMN" for row in range(1, 11))
    return Chart("SG140", names, srgb)


def _from_csv(path: Path) -> Chart:
    rows = list(
        csv.DictReader(bytes(read_file(path).data).decode("utf-8-sig").splitlines(), skipinitialspace=True)
    )
    layouts = {24: "MCC24", 140: "SG140"}
    if len(rows) not in layouts:
        raise ValueError(
            f"{path}: has {len(rows)} patches; 24 (laid out like the ColorChecker Classic) or 140 (like the Digital SG)"
            " are needed, one line for each below a line of headings"
        )
    header = [name for name in rows[0] if name]
    names = tuple(str(row[header[0]]) for row in rows)
    lowered = {name.strip().lower().rstrip("*"): name for name in header}
    if {"l", "a", "b"} <= lowered.keys():
        lab = _numbers(path, rows, [lowered[key] for key in "lab"])
        return Chart(layouts[len(rows)], names, lab_d50_to_srgb(lab))
    bands = {float(name): name for name in header[1:] if _is_number(name)}
    nm = sorted(own for own in bands if _SPECTRAL_NM[0] <= own <= _SPECTRAL_NM[1])
    if len(nm) < 2:
        raise ValueError(
            f"{path}: its headings are {', '.join(header)}; give columns L, a and b, or one for each wavelength in nm,"
            " 400 to 700"
        )
    reflectance = _numbers(path, rows, [bands[own] for own in nm])
    if reflectance.min() < 0 or reflectance.max() > 1.2:
        raise ValueError(
            f"{path}: reflectances go from {reflectance.min():g} to {reflectance.max():g}; 1 is a perfect white, so"
            " divide percentages by 100"
        )
    try:
        return Chart(layouts[len(rows)], names, reflectance_to_srgb(nm, reflectance))
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _numbers(path: Path, rows: Sequence[Mapping[str, str]], columns: Sequence[str]) -> Floats:
    found = np.empty((len(rows), len(columns)))
    for k, row in enumerate(rows):
        for j, column in enumerate(columns):
            if not _is_number(row[column]):
                raise ValueError(f"{path}: line {k + 2}, column {column}: {row[column]!r} is no number")
            found[k, j] = float(row[column])
    return found


def _is_number(text: str | None) -> bool:
    try:
        return np.isfinite(float(text or ""))
    except ValueError:
        return False
