"""Changes to a set's manifest that leave all else in it as its author wrote it."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path

from capture.files.outfolder import result_files

_PHOTO = re.compile(r"^\s*\[\[\s*photo\s*\]\]")
# Not the rows of an array that goes over several lines.
_TABLE = re.compile(r"^\s*\[\[?\s*[A-Za-z_\"']")
# The value of a key on one line; what follows it, such as a comment, stays.
_VALUE = r"""("(?:[^"\\]|\\.)*"|'[^']*'|true|false)"""


def write_key(manifest: Path, number: int, key: str, value: str | bool | None) -> None:
    """Set a key of a photograph, by the photograph's number, or remove the key; all other bytes of the file stay.

    value : None removes the key. ValueError where the manifest's photographs aren't [[photo]] tables, one below the
    other, or the key is written in a way that isn't understood; nothing is written then.
    """
    text = manifest.read_bytes().decode("utf-8")
    before = tomllib.loads(text)
    lines = text.splitlines(keepends=True)
    starts = [k for k, line in enumerate(lines) if _PHOTO.match(line)]
    if len(starts) != len(before.get("photo", [])):
        raise ValueError(
            f"{manifest}: its photographs aren't written as [[photo]] tables; write {key} there by hand"
        )
    start = starts[number]
    end = next((k for k in range(start + 1, len(lines)) if _TABLE.match(lines[k])), len(lines))
    table = _with_key(lines[start:end], key, value)
    changed = "".join([*lines[:start], *table, *lines[end:]])
    # Whatever stood there, nothing but this may have changed.
    expected = before | {"photo": [dict(photo) for photo in before["photo"]]}
    expected["photo"][number].pop(key, None)
    if value is not None:
        expected["photo"][number][key] = value
    if _read(changed) != expected:
        raise ValueError(
            f"{manifest}: {key} of photograph {number + 1} is written in a way that can't be changed here;"
            " write it there by hand"
        )
    with result_files(manifest) as folder:
        (folder / manifest.name).write_bytes(changed.encode("utf-8"))


def _with_key(table: list[str], key: str, value: str | bool | None) -> list[str]:
    """A table's lines, its header first, with a key set or removed."""
    line = re.compile(rf"^(\s*{key}\s*=\s*){_VALUE}")
    if value is None:
        return [each for each in table if not line.match(each)]
    written = json.dumps(value, ensure_ascii=False)
    for k, each in enumerate(table):
        if found := line.match(each):
            return [*table[:k], found[1] + written + each[found.end() :], *table[k + 1 :]]
    ending = "\r\n" if table[0].endswith("\r\n") else "\n"
    return [table[0], f"{key} = {written}{ending}", *table[1:]]


def _read(text: str) -> object:
    """What a manifest's text says; None where it is no TOML."""
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return None
