"""A task as another process does it: the stage from a file, the item by value, the result into its file."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from capture.parallel import on_one_core
from capture.tasks.contentkey import program_key
from capture.tasks.stage import Stage
from capture.tasks.store import CACHE_VARIABLE, keep, kept, packed

_STAGES = "stages"


@dataclass(frozen=True)
class Shared:
    """A stage as other processes get it: the file that holds it, and the key of the program that it is part of."""

    file: Path
    program: str


@contextmanager
def shared_stage(stage: Stage) -> Iterator[Shared]:
    """A stage written for other processes to read within the block; ValueError where it can't be written."""
    file = stage.store.passing(_STAGES, stage.key)
    try:
        keep(file, packed(stage))
    except OSError as error:
        raise ValueError(
            f"{stage.store.folder}: work can't be shared there ({error.strerror or error}); let {CACHE_VARIABLE} name"
            " a folder with room that all workers see"
        ) from error
    try:
        yield Shared(file, program_key())
    finally:
        file.unlink(missing_ok=True)


def work(shared: Shared, item: Any) -> Path:
    """Do a task on one core; the file of its result.

    ValueError where this process is of another version of the program, or doesn't see the folder of the work.
    """
    with on_one_core():
        return _stage(shared).done(item)


@lru_cache(maxsize=1)
def _stage(shared: Shared) -> Stage:
    if shared.program != program_key():
        raise ValueError("this worker has another version of lightfactor, of Python or of a library")
    found = kept(shared.file)
    if found is None:
        raise ValueError(
            f"{shared.file}: this worker doesn't see it; let {CACHE_VARIABLE} name a folder that all workers see"
        )
    stage: Stage = found[0]
    return stage
