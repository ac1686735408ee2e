"""One page over all sets of a batch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from capture.files.imagefile import read_pixels
from invrender.output.pages import page_template
from invrender.output.report.pictures import image_url, tone_mapped, white_level
from invrender.result.saved import SavedQuantity, SavedResult
from invrender.result.shown import quantity_lines
from lightfactor.batch.running import Outcome

PAGE_NAME = "index.html"
_THUMBNAIL = 96
# Columns of numbers: the page's names, and the parameters.
_NUMBERS = {"Kd": "kd", "Ks": "ks", "mu": "mu", "sigma (rad)": "sigma"}


@dataclass(frozen=True)
class _Cell:
    """A number in a row, or one for each channel: texts, what it is sorted by, and its status."""

    texts: tuple[str, ...]
    value: float | None
    status: str = ""


@dataclass(frozen=True)
class _Row:
    outcome: Outcome
    picture: str
    model: str
    errors: tuple[_Cell, ...]
    numbers: tuple[_Cell, ...]


def write_page(folder: Path, outcomes: Sequence[Outcome], table: Sequence[Mapping[str, Any]]) -> None:
    """Write the page over outcomes, whose results lie beside it; table : a row of numbers for each."""
    template = page_template("lightfactor.batch", "page.html.jinja")
    rows = [_row(*of) for of in zip(outcomes, table, strict=True)]
    counts = {
        status: sum(each.status == status for each in outcomes) for status in ("done", "kept", "failed")
    }
    text = template.render(rows=rows, numbers=list(_NUMBERS), counts=counts, count=len(rows))
    (folder / PAGE_NAME).write_text(text, encoding="utf-8")


def _row(outcome: Outcome, numbers: Mapping[str, Any]) -> _Row:
    result = outcome.result
    if result is None:
        return _Row(outcome, "", "", (), ())
    errors = tuple(_percent(numbers[f"error_{kind}"]) for kind in ("fitted", "unseen", "held_out"))
    cells = [_cell(result, name) for name in _NUMBERS.values()]
    return _Row(outcome, _thumbnail(result.folder), numbers["model"], errors, tuple(cells))


def _cell(result: SavedResult, name: str) -> _Cell:
    quantity: SavedQuantity | None = getattr(result.content.brdf, name)
    if quantity is None or quantity.value is None:
        return _Cell(("-",), None, "" if quantity is None else quantity.status)
    texts = [text for _, text in quantity_lines(name, quantity, result.is_absolute)]
    # One number of all channels is said once.
    return _Cell(tuple(dict.fromkeys(texts)), float(np.mean(quantity.value)), quantity.status)


def _percent(share: float | None) -> _Cell:
    return _Cell(("" if share is None else f"{share:.2%}",), share)


def _thumbnail(folder: Path) -> str:
    """The first predicted photograph, about the object, as a data URL."""
    radiance = read_pixels(sorted((folder / "predicted").glob("*.exr"))[0]).astype(np.float32)
    rows, columns = (np.flatnonzero(radiance.any(axis=(2, axis))) for axis in (1, 0))
    if len(rows):
        radiance = radiance[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    scale = min(_THUMBNAIL / max(radiance.shape[:2]), 1.0)
    small: NDArray[np.float32] = np.asarray(
        cv2.resize(radiance, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.float32
    )
    return image_url(tone_mapped(small, white_level(small)), jpeg=True)
