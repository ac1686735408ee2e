"""Keys of results: hashes of all that they depend on, by what it holds, the same in every process."""

from __future__ import annotations

import copyreg
import hashlib
import sys
from collections.abc import Mapping, Sequence, Set
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache, partial
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from types import BuiltinFunctionType, FunctionType

import numpy as np
from pydantic import BaseModel

from capture.files.documents import file_hash

# The program's packages whose code results depend on, and the libraries that compute them.
_PACKAGES = ("capture", "recon", "invrender", "synthetic")
_LIBRARIES = ("numpy", "scipy", "opencv-contrib-python-headless", "OpenEXR", "rawpy", "embreex", "pycolmap")


def content_key(*values: object) -> str:
    """A hash of values, 64 hexadecimal digits, another one as soon as anything in them differs.

    A path stands for the content of its file; a dataclass for its class and the fields that it is made from; another
    object for what it would be pickled as. TypeError for what has no such content: locks, functions within functions.
    """
    return hashlib.sha256(_digest(values, ())).hexdigest()


@cache
def program_key() -> str:
    """A hash of the program's source, and the versions of Python and of the libraries that compute."""
    sources = [file for package in _PACKAGES for file in _sources(package)]
    code = [hashlib.sha256(file.read_bytes()).hexdigest() for file in sources]
    return content_key(code, sys.version, [version(name) for name in _LIBRARIES])


def _sources(package: str) -> list[Path]:
    found = find_spec(package)
    folders = (found.submodule_search_locations if found is not None else None) or []
    return [file for folder in folders for file in sorted(Path(folder).rglob("*.py"))]


def _digest(value: object, within: tuple[int, ...]) -> bytes:
    """What stands for a value in hashes: its kind, and its bytes or the digests of its parts.

    within : the objects that it is part of, by their numbers in memory.
    """
    kind = f"{type(value).__module__}.{type(value).__qualname__}"
    digest = hashlib.sha256(kind.encode())
    if id(value) in within:
        # An object that holds itself: where it begins.
        return hashlib.sha256(f"{kind} {within.index(id(value))}".encode()).digest()
    content = _content(value)
    parts = (
        [_digest(part, (*within, id(value))) for part in _parts(value, kind)] if content is None else content
    )
    for part in parts:
        # Each part by its length, so that no two values run together to the same bytes.
        digest.update(len(part).to_bytes(8, "big"))
        digest.update(part)
    return digest.digest()


def _content(value: object) -> Sequence[bytes | memoryview] | None:
    """The bytes of a value that has no parts; None of others."""
    match value:
        case Enum():
            return [value.name.encode()]
        case None | bool() | int() | float() | complex() | str():
            return [repr(value).encode()]
        case bytes():
            return [value]
        case Path():
            return [file_hash(value).encode()]
        case np.ndarray() | np.generic() if value.dtype != object:
            array = np.asarray(value)
            shape = f"{array.dtype.str} {array.shape}".encode()
            return [shape, np.ascontiguousarray(array).reshape(-1).view(np.uint8).data]
        case type() | FunctionType() | BuiltinFunctionType() if "<" not in value.__qualname__:
            return [f"{value.__module__}.{value.__qualname__}".encode()]
        case Set():
            return sorted(_digest(part, ()) for part in value)
    return None


def _parts(value: object, kind: str) -> Sequence[object]:
    match value:
        case partial():
            return [value.func, value.args, value.keywords]
        case BaseModel():
            return [getattr(value, name) for name in type(value).model_fields]
        case _ if is_dataclass(value):
            return [
                part
                for entry in fields(value)
                if entry.init
                for part in (entry.name, getattr(value, entry.name))
            ]
        case Mapping():
            # In their order: sums go by it.
            return [part for pair in value.items() for part in pair]
        case Sequence() if not isinstance(value, np.ndarray):
            return value
    try:
        reduced = (
            copyreg.dispatch_table[type(value)](value) if type(value) in copyreg.dispatch_table else None
        )
        found = value.__reduce_ex__(4) if reduced is None else reduced
    except TypeError as error:
        raise TypeError(f"a {kind} has no content that a key could be made of ({error})") from error
    if isinstance(found, str) or isinstance(value, FunctionType | np.ndarray):
        raise TypeError(f"a {kind} has no content that a key could be made of")
    return found[:3]
