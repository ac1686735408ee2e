"""Keys of results: hashes of all that they depend on, by what it holds, the same in every process."""

from __future__ import annotations

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
_LIBRARIES = ("numpy", "scipy", "opencv-contrib-python-headless", "OpenEXR", "rawpy", "embreex")


def content_key(*values: object) -> str:
    """A hash of values, 64 hexadecimal digits, another one as soon as anything in them differs.

    A path stands for the content of its file; a dataclass for its class and the fields that it is made from. TypeError
    for what has no such content: open files, functions within functions.
    """
    return hashlib.sha256(_digest(values)).hexdigest()


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


def _digest(value: object) -> bytes:
    """What stands for a value in hashes: its kind, and its bytes or the digests of its parts."""
    kind = f"{type(value).__module__}.{type(value).__qualname__}"
    digest = hashlib.sha256(kind.encode())
    for part in _parts(value, kind):
        # Each part by its length, so that no two values run together to the same bytes.
        digest.update(len(part).to_bytes(8, "big"))
        digest.update(part)
    return digest.digest()


def _parts(value: object, kind: str) -> Sequence[bytes | memoryview]:
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
            # Two dimensions more than any array lacks make even a single number one of bytes.
            return [shape, np.ascontiguousarray(array).reshape(-1).view(np.uint8).data]
        case type() | FunctionType() | BuiltinFunctionType() if "<" not in value.__qualname__:
            return [f"{value.__module__}.{value.__qualname__}".encode()]
        case partial():
            return [_digest(part) for part in (value.func, value.args, value.keywords)]
        case BaseModel():
            return [_digest({name: getattr(value, name) for name in type(value).model_fields})]
        case _ if is_dataclass(value):
            return [
                _digest({entry.name: getattr(value, entry.name) for entry in fields(value) if entry.init})
            ]
        case Mapping():
            # In their order: sums go by it.
            return [_digest(part) for pair in value.items() for part in pair]
        case Set():
            return sorted(_digest(part) for part in value)
        case Sequence():
            return [_digest(part) for part in value]
    raise TypeError(f"a {kind} has no content that a key could be made of")
