"""JSON files that we write and read: results and calibrations, each with what it was made from.

Every one carries `format`, the hashes of its inputs and the version of the software, and holds finite numbers or
null only.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from capture.files.tables import AnyTable, validated

# Hashes of files that were read, by what tells that they are still the same.
_hashes: dict[tuple[int, ...], str] = {}


def file_hash(path: Path) -> str:
    """sha256 of a file, as results name their inputs; a file that hasn't changed is read once."""
    found = path.stat()
    same = (found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns, found.st_ctime_ns)
    if same not in _hashes:
        _hashes[same] = _hash_of(path)
    return _hashes[same]


def _hash_of(path: Path) -> str:
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return f"sha256:{digest.hexdigest()}"


def input_hashes(paths: Iterable[Path]) -> dict[str, str]:
    """Hashes of files by their names, by their paths where two share a name."""
    hashes: dict[str, str] = {}
    for path in dict.fromkeys(paths):
        hashes[path.name if path.name not in hashes else str(path)] = file_hash(path)
    return hashes


def numbers(values: ArrayLike) -> Any:
    """Nested lists of plain floats; a value that is not finite becomes null."""
    array = np.asarray(values, float)
    if array.ndim == 0:
        return float(array) if np.isfinite(array) else None
    return [numbers(item) for item in array]


def software() -> dict[str, str]:
    """The version of what wrote a file."""
    return {"lightfactor": version("lightfactor")}


def write_json(path: Path, document: Mapping[str, Any]) -> None:
    """Write JSON that refuses NaN and infinity."""
    path.write_text(json.dumps(document, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def read_json(
    path: Path, schema: type[AnyTable], keys: Iterable[str], what: str, optional: Iterable[str] = ()
) -> AnyTable:
    """The named keys of a JSON file as a table of the schema; other keys are ignored.

    optional : keys that may be missing. what : the kind of file for messages, e.g. "a camera.json holds model, params,
    width, height". ValueError names the file, what is wrong with it, and what it should hold.
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror or error})") from error
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: is not valid JSON: {error}; {what}") from error
    if not isinstance(data, dict):
        raise ValueError(f"{path}: is not a JSON object; {what}")
    missing = [key for key in keys if key not in data]
    if missing:
        raise ValueError(f"{path}: lacks the key {missing[0]!r}; {what}")
    return validated(schema, path, {key: data[key] for key in (*keys, *optional) if key in data})
