"""What a process took of memory at most: python -m benchmarks.memory COMMAND OF LIGHTFACTOR ...

Runs the command, and prints its peak as the last line, in megabytes. On Linux it is asked of the process itself: what
the system tells of children counts the parent's memory too.
"""

from __future__ import annotations

import atexit
import resource
import sys
from pathlib import Path

# Of Linux: what a process took at most, and where to have that forgotten.
_STATUS, _FORGET = Path("/proc/self/status"), Path("/proc/self/clear_refs")


def peak_megabytes() -> float:
    """The most that this process has taken, since `forget_peak` where the system can forget."""
    if _STATUS.exists():
        lines = _STATUS.read_text(encoding="utf-8").splitlines()
        return next(float(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 2**10
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (2**20 if sys.platform == "darwin" else 2**10)


def forget_peak() -> None:
    """Let the peak begin anew, on Linux."""
    if _FORGET.exists():
        _FORGET.write_text("5", encoding="utf-8")


if __name__ == "__main__":
    from lightfactor.cli import main

    atexit.register(lambda: print(f"{peak_megabytes():.0f}"))
    main()
