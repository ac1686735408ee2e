"""Solved sets, kept until their pictures are made: a run that was killed among these doesn't solve anew."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from capture.photoset import PhotoSet
from capture.tasks.contentkey import content_key, program_key
from capture.tasks.store import TaskStore, keep_if_room
from invrender.result.run import Run

_STAGE = "fits"


def fit_place(
    store: TaskStore, photoset: PhotoSet, inputs: Mapping[str, str], settings: Mapping[str, object]
) -> Path:
    """Where a set's solution is kept; inputs, settings : as of `solved_from`."""
    return store.place(_STAGE, content_key(solved_from(photoset, inputs, settings), program_key()))


def solved_from(photoset: PhotoSet, inputs: Mapping[str, str], settings: object) -> tuple[object, ...]:
    """All that a set's solution depends on beside the program: its files, where they lie, and settings.

    inputs : the set's `photoset_hashes`.
    """
    return [str(path.absolute()) for path in photoset.files], inputs, settings


def keep_fit(place: Path, run: Run) -> Run:
    """Keep a solved set, where the disk has room; the set as it will be read."""
    read: Run = keep_if_room(place, run)
    return read
