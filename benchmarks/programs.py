"""The other benchmarks, each a program of its own: run in turn, what they print kept beside their figures."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

_ROOT = Path(__file__).parents[1]
# Arguments of each, and of its coarse version; None where it has none. DIR is the folder of the charts.
_COARSE_SPHERES = "--part table --light unknown --views 3 --materials teflon --rungs exact --samples 1500"
_PROGRAMS: dict[str, tuple[str, str | None]] = {
    "spheres": (
        "--folder DIR/spheres --figures DIR",
        f"--folder DIR/spheres --figures DIR {_COARSE_SPHERES}",
    ),
    "statistics": ("", None),
    "harmonics": ("", None),
    "rays": ("DIR/rays.png", None),
    "synth": ("DIR/synth.png", None),
    "decode": ("", None),
    "stream": ("", None),
    "mitsuba": ("DIR/mitsuba.png", None),
}


def run_program(name: str, out: Path, quick: bool) -> None:
    """Write NAME.txt, all that the program prints, and its figures; nothing where it has no coarse version."""
    arguments = _PROGRAMS[name][quick]
    if arguments is None:
        print("  has no coarse version")
        return
    out.mkdir(parents=True, exist_ok=True)
    words = [word.replace("DIR", str(out.resolve())) for word in arguments.split()]
    command = [sys.executable, "-m", f"benchmarks.{name}", *words]
    done = subprocess.run(command, cwd=_ROOT, capture_output=True, text=True)
    if done.returncode:
        last = (done.stderr.strip() or "no message").splitlines()[-1]
        print(f"  failed and is left out: {last}")
        return
    (out / f"{name}.txt").write_text(done.stdout, encoding="utf-8")


PROGRAMS: dict[str, Callable[[Path, bool], None]] = {name: partial(run_program, name) for name in _PROGRAMS}
