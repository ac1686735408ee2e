"""Solved sets, kept until their pictures are made: a run that was killed among these doesn't solve anew."""

from __future__ import annotations

import hashlib
import json
import os
import pickle
import sys
import time
from collections.abc import Mapping
from contextlib import suppress
from functools import cache
from importlib.metadata import version
from pathlib import Path

import cloudpickle

import capture
import invrender
import recon
from capture.files.outfolder import result_files
from capture.photoset import PhotoSet
from invrender.result.run import Run

# Names the folder in place of the user's cache.
CACHE_VARIABLE = "LIGHTFACTOR_CACHE"
_KEPT_S = 30 * 24 * 3600.0


def unfinished_key(photoset: PhotoSet, inputs: Mapping[str, str], settings: Mapping[str, object]) -> str:
    """What a solution depends on, as a hash: the set's files and where they lie, the settings, the program's code.

    inputs : the set's `photoset_hashes`.
    """
    parts = [
        [str(path.absolute()) for path in photoset.files],
        dict(inputs),
        dict(settings),
        _code_hash(),
        sys.version,
        [version(name) for name in ("numpy", "scipy", "cloudpickle")],
    ]
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def keep_run(key: str, run: Run) -> None:
    """Keep a solved set under its key, where the folder can be written; what was kept a month ago is removed.

    Textures aren't kept: what they are solved from may be gigabytes.
    """
    if run.textures is not None:
        return
    folder = _folder()
    with suppress(OSError, ValueError):
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        for path in folder.glob("*.run"):
            if time.time() - path.stat().st_mtime > _KEPT_S:
                path.unlink(missing_ok=True)
        with result_files(_file(key)) as place, (place / _file(key).name).open("wb") as stream:
            cloudpickle.dump(run, stream)


def kept_run(key: str) -> Run | None:
    """The solved set of a key; None where none is kept, or its file is damaged."""
    try:
        with _file(key).open("rb") as stream:
            found = pickle.load(stream)
    except Exception:  # a damaged file raises whatever it leads the reader into
        return None
    return found if isinstance(found, Run) else None


def forget_run(key: str) -> None:
    """Remove what is kept under a key."""
    with suppress(OSError):
        _file(key).unlink(missing_ok=True)


def _file(key: str) -> Path:
    return _folder() / f"{key}.run"


def _folder() -> Path:
    """The user's own: unpickling a file runs what is in it."""
    if named := os.environ.get(CACHE_VARIABLE):
        return Path(named)
    caches = os.environ.get("XDG_CACHE_HOME")
    return (Path(caches) if caches else Path.home() / ".cache") / "lightfactor"


@cache
def _code_hash() -> str:
    """sha256 of the program's source files."""
    digest = hashlib.sha256()
    for package in (capture, recon, invrender):
        for folder in package.__path__:
            for path in sorted(Path(folder).rglob("*.py")):
                digest.update(path.read_bytes())
    return digest.hexdigest()
