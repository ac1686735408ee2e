"""The numbers of a batch as a table: a row for each set, for spreadsheets and other programs."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from capture.radiance import CHANNELS
from invrender.result.saved import SavedQuantity, SavedResult
from lightfactor.batch.running import Outcome

TABLE_NAME, PARQUET_NAME = "results.csv", "results.parquet"
_PER_CHANNEL, _SINGLE = ("kd", "ks"), ("mu", "sigma")
# Of every set, whether it has a result or not.
_OF_ALL = ("name", "set", "status", "error", "seconds")


def table_rows(outcomes: Sequence[Outcome]) -> list[dict[str, Any]]:
    """A row for each set, all with the same columns; None where there is no number."""
    rows = [_of_set(outcome) | _of_result(outcome.result) for outcome in outcomes]
    columns = dict.fromkeys(name for row in rows for name in row)
    return [{name: row.get(name) for name in columns} for row in rows]


def _of_set(outcome: Outcome) -> dict[str, Any]:
    values = outcome.asked.name, str(outcome.asked.manifest.parent), outcome.status, outcome.error
    return dict(zip(_OF_ALL, (*values, round(outcome.seconds, 1)), strict=True))


def _of_result(result: SavedResult | None) -> dict[str, Any]:
    if result is None:
        return {}
    content = result.content
    row: dict[str, Any] = {
        "model": next((model.name for model in content.models if model.chosen), content.brdf.model),
        "scale": "absolute" if result.is_absolute else "relative",
        "photos": len(content.photos),
        "error_fitted": content.fit.fitted,
        "error_unseen": content.fit.unseen,
        "error_held_out": content.fit.held_out,
    }
    for name in (*_PER_CHANNEL, *_SINGLE):
        row |= _numbers(name, getattr(content.brdf, name))
    return row


def _numbers(name: str, quantity: SavedQuantity | None) -> dict[str, Any]:
    """A parameter's values, standard deviations and status, by column."""
    labels = [f"{name}_{channel[0]}" for channel in CHANNELS] if name in _PER_CHANNEL else [name]
    found: dict[str, Any] = {}
    for k, label in enumerate(labels):
        for ending, of in (("", quantity and quantity.value), ("_std", quantity and quantity.std)):
            found[label + ending] = of[k] if isinstance(of, tuple) else of
    return found | {f"{name}_status": "not needed" if quantity is None else quantity.status}


def write_tables(folder: Path, rows: Sequence[dict[str, Any]]) -> str:
    """Write results.csv, and results.parquet where pyarrow is installed; what lacks for that, in words, or ""."""
    with (folder / TABLE_NAME).open("w", encoding="utf-8", newline="") as stream:
        writer = csv.DictWriter(stream, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        return f"{PARQUET_NAME} was not written: it needs pyarrow, of `pip install 'lightfactor[parquet]'`"
    pyarrow.parquet.write_table(pyarrow.Table.from_pylist(list(rows)), folder / PARQUET_NAME)
    return ""
