"""Result folders that are whole or absent: written under a temporary name, then renamed."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def result_folder(out: Path, marker: str) -> Iterator[Path]:
    """A temporary folder beside `out` that takes its place when the block ends without an error.

    marker : a file that every result of this kind holds. A folder `out` that exists, is not empty and
        lacks it is somebody else's: it is refused (ValueError), never replaced.
    """
    if out.exists() and not out.is_dir():
        raise ValueError(f"{out}: is a file; give a folder for the results")
    if out.is_dir() and any(out.iterdir()) and not (out / marker).exists():
        raise ValueError(f"{out}: exists and holds something else (no {marker}); give another folder with -o")
    out.parent.mkdir(parents=True, exist_ok=True)
    temporary = Path(tempfile.mkdtemp(prefix=f".{out.name}-", dir=out.parent))
    try:
        temporary.chmod(0o755)
        yield temporary
        if out.exists():
            old = Path(tempfile.mkdtemp(prefix=f".{out.name}-old-", dir=out.parent))
            out.rename(old / out.name)
            temporary.rename(out)
            shutil.rmtree(old)
        else:
            temporary.rename(out)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
