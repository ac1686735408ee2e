"""The other benchmarks, each a program of its own: run in turn, what they print kept beside their figures."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

from benchmarks.kept import machine, machine_words
from benchmarks.peer import NO_LLVM, has_mitsuba

_ROOT = Path(__file__).parents[1]
# Arguments of each, and of its coarse version. DIR is the folder of the charts.
_COARSE_SPHERES = "--part table --light unknown --views 3 --materials teflon --rungs exact --samples 800"
_PROGRAMS: dict[str, tuple[str, str]] = {
    "spheres": (
        # Coverage and timing take half an hour: python -m benchmarks.spheres.
        "--folder DIR/spheres --figures DIR --part table fig12",
        f"--folder DIR/spheres --figures DIR {_COARSE_SPHERES}",
    ),
    "statistics": ("", "4"),
    "harmonics": ("", "1"),
    "rays": ("DIR/rays.png", "DIR/rays.png 0.002 --once"),
    "synth": ("DIR/synth.png", "DIR/synth.png rh01-steel"),
    "decode": ("", "2"),
    "stream": ("", "1"),
    # At full size, which is 1, a quarter of an hour.
    "texture": ("0.15", "0.03"),
    "many": ("DIR/many.png", "DIR/many.png 4 1000"),
    "whole": ("DIR/whole.png", "DIR/whole.png --only plan-sphere"),
    "startup": ("", "1"),
    "mitsuba": ("DIR/mitsuba.png", "DIR/mitsuba.png rh01-steel"),
}


def run_program(name: str, out: Path, quick: bool) -> None:
    """Write NAME.txt, all that the program prints, and its figures; RuntimeError with its last words where it fails."""
    if name == "mitsuba" and not has_mitsuba():
        print(f"  {NO_LLVM}")
        return
    arguments = _PROGRAMS[name][quick]
    out.mkdir(parents=True, exist_ok=True)
    words = [word.replace("DIR", str(out.resolve())) for word in arguments.split()]
    command = [sys.executable, "-m", f"benchmarks.{name}", *words]
    done = subprocess.run(command, cwd=_ROOT, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(
            f"python -m benchmarks.{name} ended with {done.returncode}:\n{done.stderr.strip()}"
        )
    # Charts lie beside what is printed, wherever that is.
    printed = done.stdout.replace(f"{out.resolve()}{os.sep}", "")
    (out / f"{name}.txt").write_text(
        f"{printed}\nMeasured on {machine_words(machine())}.\n", encoding="utf-8"
    )


PROGRAMS: dict[str, Callable[[Path, bool], None]] = {name: partial(run_program, name) for name in _PROGRAMS}
