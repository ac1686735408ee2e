"""Schemas of files: faults are named where the user wrote them."""

from pathlib import Path

import pytest

from capture.files.tables import Table, validated


class _Quantity(Table):
    value: tuple[float, ...] | float | None = None


class _Result(Table):
    kd: _Quantity


def test_a_fault_within_one_of_two_allowed_forms_is_named_by_its_place() -> None:
    with pytest.raises(
        ValueError, match=r"r\.json: \[kd\] key value\[1\] is 'x': input should be a valid number"
    ):
        validated(_Result, Path("r.json"), {"kd": {"value": [1.0, "x"]}})
