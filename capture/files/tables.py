"""Tables of TOML and JSON files: strict schemas, and errors that name the key, the fault and the nearest valid key."""

from __future__ import annotations

import difflib
import re
import typing
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError


def _channels(value: Any) -> Any:
    """A reflectance as three: one number counts for all channels."""
    channels = value if isinstance(value, tuple) else (value,) * 3
    numbers = [entry for entry in channels if isinstance(entry, int | float) and not isinstance(entry, bool)]
    if len(channels) != 3 or len(numbers) != 3 or not all(0 < number <= 1 for number in numbers):
        raise ValueError("must be one number, or [r, g, b], above 0 and at most 1")
    return tuple(map(float, numbers))


Vector3 = tuple[float, float, float]
Matrix4 = tuple[tuple[float, float, float, float], ...]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Reflectance = Annotated[Vector3, BeforeValidator(_channels)]


class Table(BaseModel):
    # Strict: "320" is not 320 and "no" is not true; a wrong type is an error, never a conversion.
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)


class LenientTable(Table):
    """A part of a file that holds more than what is read back."""

    model_config = ConfigDict(extra="ignore")


AnyTable = TypeVar("AnyTable", bound=Table)


def validated(schema: type[AnyTable], path: Path, data: dict[str, Any]) -> AnyTable:
    """The data of a TOML or JSON file as a table; ValueError names file, key and remedy."""
    try:
        return schema.model_validate(_with_tuples(data))
    except ValidationError as error:
        # A fault that every photo repeats is said once.
        kinds: dict[Any, list[Any]] = {}
        for entry in error.errors():
            place = tuple(part for part in entry["loc"] if not isinstance(part, int))
            kinds.setdefault((entry["type"], place), []).append(entry)
        sentences = [
            _describe(schema, path, data, same[0])
            + (f" (and so in {len(same) - 1} more places)" if same[1:] else "")
            for same in kinds.values()
        ]
        raise ValueError("\n".join(sentences)) from error


def _with_tuples(value: Any) -> Any:
    """The same data with its lists as tuples, which is what a strict schema of frozen tables holds."""
    if isinstance(value, dict):
        return {key: _with_tuples(entry) for key, entry in value.items()}
    return tuple(map(_with_tuples, value)) if isinstance(value, list) else value


def _describe(schema: type[Table], path: Path, data: dict[str, Any], error: Any) -> str:
    loc = _within(data, tuple(error["loc"]))
    if error["type"] == "value_error":
        return f"{path}: {_table_name(data, loc)} {error['msg'].removeprefix('Value error, ')}"
    # The key that the user wrote, and the place within its array, if it has one: centre[2].
    last = max(i for i, part in enumerate(loc) if isinstance(part, str))
    key = str(loc[last])
    place = "".join(f"[{index}]" for index in loc[last + 1 :])
    where = f"{path}: {_table_name(data, loc[:last])}"
    if error["type"] == "extra_forbidden":
        valid = list(_table_at(schema, loc[:last]).model_fields)
        near = difflib.get_close_matches(key, valid, n=1, cutoff=0.5)
        hint = f"did you mean {near[0]!r}?" if near else f"valid keys are {', '.join(sorted(valid))}"
        return f"{where} has an unknown key {key!r}; {hint}"
    if error["type"] == "missing":
        what = f"key {key} is too short: it lacks {place}" if place else f"lacks the key {key!r}"
        return f"{where} {what}"
    value = _at(data, loc)
    message = error["msg"][:1].lower() + error["msg"][1:]
    if isinstance(value, dict) and error["type"] == "tuple_type":
        message = f"write its head with double brackets, [[{key}]]"
    # In the words of TOML, not of the schema's library.
    message = re.sub(r"valid dictionary or instance of \w+", "table", message).replace("tuple", "array")
    return f"{where} key {key}{place} is {_short(value)}: {message}"


def _within(data: dict[str, Any], loc: tuple[Any, ...]) -> tuple[Any, ...]:
    """A place in the data, without the names of alternatives that the schema's library puts between."""
    path: tuple[Any, ...] = ()
    for k, part in enumerate(loc):
        value = _at(data, path)
        steps_into = isinstance(value, dict) if isinstance(part, str) else isinstance(value, list)
        if steps_into and (k == len(loc) - 1 or isinstance(part, int) or part in value):
            path += (part,)
    return path


def _at(data: Any, path: tuple[Any, ...]) -> Any:
    for part in path:
        data = data[part]
    return data


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _dotted(loc: tuple[Any, ...]) -> str:
    return ".".join(str(part) for part in loc)


def _table_name(data: dict[str, Any], loc: tuple[Any, ...]) -> str:
    """`[[photo]] 3 ("007.exr")` for ("photo", 2): tables are counted from 1, with the name a user knows."""
    if not loc:
        return "the top level"
    if len(loc) >= 2 and isinstance(loc[1], int):
        entry = data[loc[0]][loc[1]]
        label = (
            entry.get("file", entry.get("name", entry.get("photo", ""))) if isinstance(entry, dict) else ""
        )
        inner = f" {_dotted(loc[2:])}" if len(loc) > 2 else ""
        return f'[[{loc[0]}]] {loc[1] + 1} ("{label}"){inner}'
    return f"[{_dotted(loc)}]"


def _table_at(schema: type[Table], loc: tuple[Any, ...]) -> type[Table]:
    """The schema of the table at `loc`."""
    for name in loc:
        if isinstance(name, str):
            (schema,) = _tables_in(schema.model_fields[name].annotation)
    return schema


def _tables_in(annotation: Any) -> list[type[Table]]:
    """The tables that an annotation names, such as one in tuple[PhotoTable, ...]."""
    if isinstance(annotation, type) and issubclass(annotation, Table):
        return [annotation]
    return [table for part in typing.get_args(annotation) for table in _tables_in(part)]
