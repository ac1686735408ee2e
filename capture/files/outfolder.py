"""Results that are whole or absent: folders and files written under a temporary name, then renamed."""

from __future__ import annotations

import os
import secrets
import shutil
import threading
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from fnmatch import fnmatch
from pathlib import Path

# Folders under their temporary names, with what is so if they are thrown away; and whether one is taking its place
# just now.
_unfinished: dict[Path, str] = {}
_placing = threading.Lock()
_NOTHING = "nothing was written, an earlier result is untouched"


@contextmanager
def result_folder(out: Path, own: Sequence[str]) -> Iterator[Path]:
    """A temporary folder beside `out` that takes its place when the block ends without an error.

    own : patterns of the names that a result of this kind holds, the first being in every one of them. A
        folder `out` that holds anything else is refused (ValueError) before any work is done: replacing it
        would lose what isn't ours.
    """
    _check_replaceable(out, own)
    with _temporary_folder(out) as temporary:
        yield temporary
        with _placing:
            _place(temporary, out)


@contextmanager
def added_files(out: Path, what: str) -> Iterator[Path]:
    """A temporary folder whose content joins the finished result in the folder `out` when the block ends.

    what : is added, in words, for the message that it isn't there. An error leaves the result as it is; where it is one
    of the input or the disk (ValueError, OSError) it then says so, as ValueError. What is there already under a name is
    replaced, in the order of the names.
    """
    left = f"{out} holds the finished result but for {what}"
    with _temporary_folder(out, left) as temporary:
        try:
            yield temporary
            with _placing:
                for path in sorted(temporary.iterdir()):
                    os.replace(path, out / path.name)
        except (ValueError, OSError) as error:
            raise ValueError(f"{left}: {error}") from error


@contextmanager
def result_files(out: Path, beside: Sequence[str] = (), inputs: Iterable[Path] = ()) -> Iterator[Path]:
    """A temporary folder for a result of one file, `out`, and others `beside` it, named by their endings.

    Write `folder / out.name` and, for each ending such as "-figure.png", `folder / (out.stem + ending)`; they
    take their places when the block ends without an error, `out` last. inputs : files that must not be replaced.
    """
    names = [*(out.stem + ending for ending in beside), out.name]
    taken = {path.resolve() for path in inputs}
    for name in names:
        place = out.with_name(name)
        if place.is_dir():
            raise ValueError(f"{place}: is a folder; give the name of a file for the result")
        if place.resolve() in taken:
            raise ValueError(f"{place}: is one of the inputs and would be lost; give another name")
    with _temporary_folder(out) as temporary:
        yield temporary
        with _placing:
            for name in names:
                os.replace(temporary / name, out.with_name(name))


def discard_unfinished() -> str | None:
    """Remove the folders that are being written, as a program that is about to be stopped must: what is left, in words.

    None, and nothing removed, while a finished one is taking its place: that is over in a moment.
    """
    if not _placing.acquire(blocking=False):
        return None
    for folder in list(_unfinished):
        shutil.rmtree(folder, ignore_errors=True)
    return next(iter(_unfinished.values()), _NOTHING)


@contextmanager
def _temporary_folder(out: Path, without: str = _NOTHING) -> Iterator[Path]:
    """A folder beside `out` for the time of the block. without : what is so if it is thrown away, in words."""
    temporary = out.absolute().with_name(f".{out.name}-{secrets.token_hex(4)}")
    _unfinished[temporary] = without
    try:
        try:
            temporary.mkdir(parents=True)
        except OSError as error:
            raise ValueError(
                f"{out}: cannot be written ({error.strerror or error}); give another place"
            ) from error
        yield temporary
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
        _unfinished.pop(temporary, None)


def _place(temporary: Path, out: Path) -> None:
    old = temporary.with_name(f"{temporary.name}-old")
    if out.exists():
        out.rename(old)
    try:
        temporary.rename(out)
    except OSError:
        if old.exists():
            old.rename(out)
        raise
    shutil.rmtree(old, ignore_errors=True)


def _check_replaceable(out: Path, own: Sequence[str]) -> None:
    if not out.exists():
        return
    if not out.is_dir():
        raise ValueError(f"{out}: is a file; give the name of a folder for the results")
    names = sorted(path.name for path in out.iterdir())
    foreign = [name for name in names if not any(fnmatch(name, pattern) for pattern in own)]
    if names and own[0] not in names:
        foreign = foreign or names
    if foreign:
        raise ValueError(
            f"{out}: holds {foreign[0]!r}, which is no result of this command and would be lost;"
            " give another folder, or move it away"
        )
