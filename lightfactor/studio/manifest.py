"""Changes to a set's manifest that leave all else in it as its author wrote it."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from capture.files.outfolder import result_files
from capture.photoset import UNNAMED

# What a manifest may hold several of, and what its messages call them.
Kind = Literal["photo", "lighting"]
_CALLED: Mapping[Kind, str] = {"photo": "photograph", "lighting": "lighting"}
# Not the rows of an array that goes over several lines.
_TABLE = re.compile(r"^\s*\[\[?\s*[A-Za-z_\"']")
# The value of a key on one line; what follows it, such as a comment, stays.
_VALUE = r"""("(?:[^"\\]|\\.)*"|'[^']*'|true|false|\[[^#]*\])"""
_UNNAMED_LIGHT = f'\n[[lighting]]\nname = "{UNNAMED}"\nunknown = true\n'


def write_key(manifest: Path, kind: Kind, number: int, key: str, value: object) -> None:
    """Set a key of one of a manifest's tables, by its number, or remove the key; all other bytes of the file stay.

    value : text, a truth value, a number, or lists and tables of these; None removes the key. A manifest without
    lightings gets the table of its unknown one. ValueError where the tables aren't written as [[photo]] or
    [[lighting]], one below the other, or the key in a way that isn't understood; nothing is written then.
    """
    text = manifest.read_bytes().decode("utf-8")
    if kind == "lighting" and kind not in tomllib.loads(text):
        text = text.rstrip("\r\n") + "\n" + _UNNAMED_LIGHT
    before, lines = tomllib.loads(text), text.splitlines(keepends=True)
    header = re.compile(rf"^\s*\[\[\s*{kind}\s*\]\]")
    starts = [k for k, line in enumerate(lines) if header.match(line)]
    if len(starts) != len(before.get(kind, [])):
        raise ValueError(
            f"{manifest}: its {_CALLED[kind]}s aren't written as [[{kind}]] tables; write {key} there by hand"
        )
    start = starts[number]
    end = next((k for k in range(start + 1, len(lines)) if _TABLE.match(lines[k])), len(lines))
    table = _with_key(lines[start:end], key, value)
    changed = "".join([*lines[:start], *table, *lines[end:]])
    # Whatever stood there, nothing but this may have changed.
    expected = before | {kind: [dict(each) for each in before[kind]]}
    expected[kind][number].pop(key, None)
    if value is not None:
        expected[kind][number][key] = value
    if _read(changed) != expected:
        raise ValueError(
            f"{manifest}: {key} of {_CALLED[kind]} {number + 1} is written in a way that can't be changed here;"
            " write it there by hand"
        )
    with result_files(manifest) as folder:
        (folder / manifest.name).write_bytes(changed.encode("utf-8"))


def _with_key(table: list[str], key: str, value: object) -> list[str]:
    """A table's lines, its header first, with a key set or removed."""
    line = re.compile(rf"^(\s*{key}\s*=\s*){_VALUE}")
    if value is None:
        return [each for each in table if not line.match(each)]
    written = _written(value)
    for k, each in enumerate(table):
        if found := line.match(each):
            return [*table[:k], found[1] + written + each[found.end() :], *table[k + 1 :]]
    ending = "\r\n" if table[0].endswith("\r\n") else "\n"
    return [table[0], f"{key} = {written}{ending}", *table[1:]]


def _written(value: object) -> str:
    """A value as TOML has it, on one line."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key} = {_written(each)}" for key, each in value.items()) + " }"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return "[" + ", ".join(map(_written, value)) + "]"
    return json.dumps(value, ensure_ascii=False)


def _read(text: str) -> Any:
    """What a manifest's text says; None where it is no TOML."""
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return None
