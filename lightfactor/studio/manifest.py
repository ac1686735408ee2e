"""Changes to a set's manifest that leave all else in it as its author wrote it."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

from capture.files.outfolder import result_files

_PHOTO = re.compile(r"^\s*\[\[\s*photo\s*\]\]")
# Not the rows of an array that goes over several lines.
_TABLE = re.compile(r"^\s*\[\[?\s*[A-Za-z_\"']")
_HELD_OUT = re.compile(r"^\s*held_out\s*=")


def hold_out(manifest: Path, number: int, held_out: bool) -> None:
    """Say of a photograph, by its number, that it is held out, or that it is not.

    ValueError where the manifest's photographs aren't [[photo]] tables, one below the other.
    """
    lines = manifest.read_text(encoding="utf-8").splitlines(keepends=True)
    starts = [k for k, line in enumerate(lines) if _PHOTO.match(line)]
    before = tomllib.loads("".join(lines))
    if len(starts) != len(before.get("photo", [])):
        raise ValueError(
            f"{manifest}: its photographs aren't written as [[photo]] tables; write held_out there by hand"
        )
    start = starts[number]
    end = next((k for k in range(start + 1, len(lines)) if _TABLE.match(lines[k])), len(lines))
    kept = [line for line in lines[start + 1 : end] if not _HELD_OUT.match(line)]
    more = ["held_out = true\n"] if held_out else []
    changed = "".join([*lines[: start + 1], *more, *kept, *lines[end:]])
    # Whatever stood there, nothing but this may have changed.
    expected = before | {"photo": [dict(photo) for photo in before["photo"]]}
    expected["photo"][number].pop("held_out", None)
    if held_out:
        expected["photo"][number]["held_out"] = True
    if tomllib.loads(changed) != expected:
        raise ValueError(
            f"{manifest}: held_out of photograph {number + 1} is written in a way that can't be changed here"
        )
    with result_files(manifest) as folder:
        (folder / manifest.name).write_text(changed, encoding="utf-8")
