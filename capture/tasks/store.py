"""Results of tasks on disk, in the user's cache: a folder for each photo set, in it one for each stage of the work.

What is kept is whole or absent: it is written under a name of its own and then renamed.
"""

from __future__ import annotations

import os
import pickle
import secrets
import shutil
import socket
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cloudpickle

from capture.tasks.contentkey import content_key

# Names the folder in place of the user's cache.
CACHE_VARIABLE = "LIGHTFACTOR_CACHE"
# After so long, and beyond so many bytes in all, what was used least recently is removed.
KEPT_S, KEPT_BYTES = 30 * 24 * 3600.0, 2_000_000_000
_KEPT, _PART = ".kept", ".part"
# Holds the path of the set that a folder is of.
_NAMED = "set.txt"
_PART_S = 24 * 3600.0


@dataclass(frozen=True)
class Kept:
    """What is kept of one stage of a set: how many results, bytes, and when one was last used, seconds since 1970."""

    source: str
    stage: str
    count: int
    size: int
    used: float


@dataclass(frozen=True)
class TaskStore:
    """Where results of a photo set's tasks are kept."""

    folder: Path

    @classmethod
    def of(cls, source: Path) -> TaskStore:
        """The place for a set's results, by the path of its manifest; no folder is made until something is kept."""
        place = str(source.absolute())
        return cls(cache_folder() / f"{source.absolute().parent.name}-{content_key(place)[:12]}")

    def prepare(self, source: Path) -> None:
        """Make the folder, readable by its user alone: reading a kept result runs what is in it. OSError if it can't.

        Parts are removed that processes which were killed left.
        """
        self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        (self.folder / _NAMED).write_text(f"{source.absolute()}\n", encoding="utf-8")
        for part in self.folder.glob(f"*/*{_PART}"):
            if _is_orphan(part):
                part.unlink(missing_ok=True)

    def place(self, stage: str, key: str) -> Path:
        """The file of a result."""
        return self.folder / stage / f"{key}{_KEPT}"

    def passing(self, stage: str, key: str) -> Path:
        """A file of this process's own, to be removed by it; the next run does if the process is killed."""
        return _owned(self.place(stage, key))

    def forget(self, stage: str) -> None:
        """Remove all that is kept of a stage."""
        shutil.rmtree(self.folder / stage, ignore_errors=True)


def packed(result: Any) -> bytes:
    """A result as it is kept."""
    return bytes(cloudpickle.dumps(result, protocol=pickle.HIGHEST_PROTOCOL))


def keep(file: Path, content: bytes) -> None:
    """Write a packed result; OSError where it can't be."""
    file.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    part = _owned(file)
    try:
        part.write_bytes(content)
        os.replace(part, file)
    finally:
        part.unlink(missing_ok=True)


def keep_if_room(file: Path, result: Any) -> Any:
    """Keep a result where the disk has room; the result as it will be read.

    Arrays lie otherwise in memory then than those that were computed, and sums over them may differ in the last digit.
    """
    content = packed(result)
    with suppress(OSError):
        keep(file, content)
    return pickle.loads(content)


def kept(file: Path) -> tuple[Any] | None:
    """The result in a file, alone in a tuple; None where there is none, or it is damaged."""
    try:
        with file.open("rb") as stream:
            result = pickle.load(stream)
        os.utime(file)
    except Exception:  # a damaged file raises whatever it leads the reader into
        return None
    return (result,)


def cache_folder() -> Path:
    """The folder of all that is kept: what `CACHE_VARIABLE` names, or lightfactor's in the user's cache."""
    if named := os.environ.get(CACHE_VARIABLE):
        return Path(named).absolute()
    caches = os.environ.get("XDG_CACHE_HOME")
    return (Path(caches) if caches else Path.home() / ".cache") / "lightfactor"


def listed(older_s: float = 0.0, source: Path | None = None) -> list[Kept]:
    """What is kept, by set and stage.

    older_s : only what was last used so long ago, seconds. source : a set's manifest, for that set only.
    """
    stages: dict[tuple[str, str], list[os.stat_result]] = {}
    for named, path, stat in _files(source):
        if time.time() - stat.st_mtime >= older_s:
            stages.setdefault((named, path.parent.name), []).append(stat)
    return [
        Kept(*place, len(stats), sum(stat.st_size for stat in stats), max(stat.st_mtime for stat in stats))
        for place, stats in sorted(stages.items())
    ]


def prune(
    older_s: float = KEPT_S, most_bytes: int | None = KEPT_BYTES, source: Path | None = None
) -> tuple[int, int]:
    """Remove what was last used so long ago, seconds, and beyond so many bytes what was used least recently.

    most_bytes : None for any number. source : as of `listed`. Returns how many results were removed, and their bytes.
    """
    left, removed = 0, []
    for _, path, stat in sorted(_files(source), key=lambda file: -file[2].st_mtime):
        is_much = most_bytes is not None and left + stat.st_size > most_bytes
        if is_much or time.time() - stat.st_mtime >= older_s:
            with suppress(OSError):
                path.unlink()
                removed.append((path.parent.parent, stat.st_size))
        else:
            left += stat.st_size
    for folder in {folder for folder, _ in removed}:
        _remove_if_empty(folder)
    return len(removed), sum(size for _, size in removed)


def _files(source: Path | None) -> Iterator[tuple[str, Path, os.stat_result]]:
    """What is kept of a set, or of all: the set's manifest, the file, and what the system says of it."""
    own = None if source is None else str(source.absolute())
    for name in sorted(cache_folder().glob(f"*/{_NAMED}")):
        with suppress(OSError, UnicodeDecodeError):
            named = name.read_text(encoding="utf-8").rstrip("\n")
            if own not in (None, named):
                continue
            for path in name.parent.glob("*/*"):
                # What another process is writing is its own.
                if path.suffix != _PART or _is_orphan(path):
                    with suppress(OSError):
                        yield named, path, path.stat()


def _remove_if_empty(folder: Path) -> None:
    if not any(folder.glob("*/*")):
        shutil.rmtree(folder, ignore_errors=True)


def _owned(file: Path) -> Path:
    """A name beside a file that says whose it is: the machine's and the process's."""
    return file.with_suffix(f".{socket.gethostname()}.{os.getpid()}.{secrets.token_hex(4)}{_PART}")


def _is_orphan(part: Path) -> bool:
    """Whether nobody writes a part any more: its process has ended; of another machine's, after a day."""
    try:
        *_, host, process, _, _ = part.name.rsplit(".", 4)
        # Windows has no signal that only asks.
        if host == socket.gethostname() and os.name == "posix":
            os.kill(int(process), 0)
        return time.time() - part.stat().st_mtime > _PART_S
    except ProcessLookupError:
        return True
    except (OSError, ValueError):
        return False
