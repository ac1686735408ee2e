"""How long the command takes to say what it can do, beside an interpreter that only imports NumPy.

    python -m benchmarks.startup [ROUNDS]

They take turns; the ratio of the medians counts.
"""

from __future__ import annotations

import subprocess
import sys
import time
from statistics import median

_ROUNDS, _GOAL = 9, 3.0
_COMMANDS = {
    "import numpy": [sys.executable, "-c", "import numpy"],
    "lightfactor --help": [sys.executable, "-c", "from lightfactor.cli import main; main()", "--help"],
}


def main(rounds: int) -> None:
    """Print milliseconds and the ratio."""
    times: dict[str, list[float]] = {name: [] for name in _COMMANDS}
    for _ in range(rounds + 1):
        for name, command in _COMMANDS.items():
            begin = time.perf_counter()
            subprocess.run(command, check=True, capture_output=True)
            times[name].append(time.perf_counter() - begin)
    # The first round finds files that aren't in memory yet.
    bare, ours = (median(of[1:]) for of in times.values())
    print(
        f"import numpy {1e3 * bare:.0f}ms, lightfactor --help {1e3 * ours:.0f}ms: {ours / bare:.2f}, goal {_GOAL:g}"
    )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else _ROUNDS)
