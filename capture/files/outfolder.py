"""Results that are whole or absent: folders and files written under a temporary name, then renamed.

Whoever writes holds a lock on the folder under its temporary name, which the system frees when the process ends,
however it ends. So the next run knows what belongs to nobody any more, and removes it.
"""

from __future__ import annotations

import errno
import glob
import os
import re
import secrets
import shutil
import threading
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from fnmatch import fnmatch
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows: nothing is locked there, and leftovers stay.
    fcntl = None  # type: ignore[assignment]

# Folders under their temporary names, with what is so if they are thrown away; and whether one is taking its place
# just now.
_unfinished: dict[Path, str] = {}
_placing = threading.Lock()
# What a folder that is being replaced is called for a moment, after the temporary name of the one that replaces it.
_OLD = "-old"
_NOTHING = "nothing was written, an earlier result is untouched"


@contextmanager
def claimed(out: Path, stopped: str = _NOTHING) -> Iterator[None]:
    """Keep the place of a result to this process until the block ends, in which it is written in several steps.

    stopped : what is so between two steps if the process is stopped, in words. ValueError where another process is
    writing there.
    """
    with _temporary_folder(out, stopped):
        yield


@contextmanager
def result_folder(out: Path, own: Sequence[str]) -> Iterator[Path]:
    """A temporary folder beside `out` that takes its place when the block ends without an error.

    own : patterns of the names that a result of this kind holds, the first being in every one of them. A
        folder `out` that holds anything else is refused (ValueError) before any work is done: replacing it
        would lose what isn't ours. So is one in which another process is writing.
    """
    with _temporary_folder(out) as temporary:
        _check_replaceable(out, own)
        try:
            yield temporary
            with _placing:
                _place(temporary, out)
        except OSError as error:
            if error.errno not in (errno.ENOSPC, errno.EDQUOT):
                raise
            raise ValueError(
                f"{out}: cannot be written ({error.strerror}); {_NOTHING}; make room, or give another place"
            ) from error


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
    # Of a file the last who writes it wins.
    with _temporary_folder(out, alone=False) as temporary:
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
    # The innermost step knows best.
    return next(reversed(_unfinished.values()), _NOTHING)


@contextmanager
def _temporary_folder(out: Path, without: str = _NOTHING, alone: bool = True) -> Iterator[Path]:
    """A folder beside `out` for the time of the block. without : what is so if it is thrown away, in words.

    alone : whether no other process may be writing there.
    """
    temporary, lock = _begun(out, without)
    try:
        if _settle(temporary, out) and alone:
            raise ValueError(
                f"{out}: another run is writing there; wait until it ends, or give another place"
            )
        yield temporary
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
        _unfinished.pop(temporary, None)
        if lock is not None:
            os.close(lock)


def _begun(out: Path, without: str) -> tuple[Path, int | None]:
    """A new folder beside `out`, and the lock on it; None where the file system has no locks."""
    while True:
        # Named by the time, so that of two processes each knows which came first.
        name = f".{out.name}-{time.time_ns():016x}{secrets.token_hex(4)}"
        temporary = out.absolute().with_name(name)
        _unfinished[temporary] = without
        try:
            temporary.mkdir(parents=True)
        except OSError as error:
            _unfinished.pop(temporary)
            raise ValueError(
                f"{out}: cannot be written ({error.strerror or error}); give another place"
            ) from error
        try:
            lock = _lock(temporary)
            temporary.stat()
            return temporary, lock
        except (BlockingIOError, FileNotFoundError):
            # Before it was locked, another process took it for a leftover.
            _unfinished.pop(temporary)
        except OSError:
            return temporary, None


def _lock(folder: Path) -> int:
    """The file descriptor of a lock on a folder; BlockingIOError where another process holds it."""
    if fcntl is None:
        raise OSError("this system locks no folders")
    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(handle)
        raise
    return handle


def _settle(temporary: Path, out: Path) -> bool:
    """Put in its place, or remove, what processes that were killed left of `out`; whether one that lives was first."""
    place = out.absolute()
    ours = re.compile(rf"\.{re.escape(out.name)}-(?:[0-9a-f]{{8}}|[0-9a-f]{{24}})")
    earlier = False
    for path in sorted(place.parent.glob(f".{glob.escape(out.name)}-*")):
        name = path.name.removesuffix(_OLD)
        whole = path.with_name(name)
        if not ours.fullmatch(name) or whole in _unfinished:
            continue
        try:
            lock = _lock(whole) if whole.exists() else None
        except BlockingIOError:
            earlier |= name < temporary.name
            continue
        except OSError:
            continue
        old = path.with_name(name + _OLD)
        if old.exists() and not place.exists():
            # Killed while the new one was taking the old one's place: it is whole, if it is still there.
            (whole if whole.exists() else old).rename(place)
        for rest in (whole, old):
            shutil.rmtree(rest, ignore_errors=True)
        if lock is not None:
            os.close(lock)
    return earlier


def _place(temporary: Path, out: Path) -> None:
    old = temporary.with_name(temporary.name + _OLD)
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
