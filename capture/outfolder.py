"""Result folders that are whole or absent: written under a temporary name, then renamed."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from fnmatch import fnmatch
from pathlib import Path


@contextmanager
def result_folder(out: Path, own: Sequence[str]) -> Iterator[Path]:
    """A temporary folder beside `out` that takes its place when the block ends without an error.

    own : patterns of the names that a result of this kind holds, the first being in every one of them. A
        folder `out` that holds anything else is refused (ValueError) before any work is done: replacing it
        would lose what isn't ours.
    """
    _check_replaceable(out, own)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=f".{out.name}-", dir=out.absolute().parent))
    except OSError as error:
        raise ValueError(
            f"{out}: cannot be written ({error.strerror or error}); give another folder"
        ) from error
    try:
        temporary.chmod(0o755)
        yield temporary
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
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


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
