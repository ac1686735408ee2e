"""Whole commands: where their time goes, stage by stage, and what it was before.

    python -m benchmarks.whole DIR/whole.png                              this version alone, ten minutes
    python -m benchmarks.whole DIR/whole.png --before CHECKOUT MODULE     beside another version, in turns
    python -m benchmarks.whole DIR/whole.png --only plan-sphere           one of the commands

Sets are synthesised by this version, once for both. MODULE is the command line of the other one, `invrender.cli` once.
Nothing is kept from one run to the next. Times are ratios within one run; leave the machine alone meanwhile.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from benchmarks.commandline import documented_parser
from benchmarks.ink import COLOURS, GREY, save
from benchmarks.kept import Kept
from benchmarks.stagewatch import REST, STAGES
from capture.tasks.store import CACHE_VARIABLE

_ROOT = Path(__file__).parents[1]
_MODULE = "lightfactor.cli"
# For stages beyond the colours that charts share.
_PALE = ("#b3b3b3", "#999933", "#882255", "#44AA99", "#AA4499", "#DDCC77", "#117733")


@dataclass(frozen=True)
class Whole:
    """A command that is measured.

    words : of it, SET standing for the set, OUT for a folder. scene : of the set, with what `synth` is told; none if
    empty. asked : the share of an earlier version's time on the clock that it should take; None where that was asked
    of the processor's.
    """

    name: str
    what: str
    words: str
    scene: str
    asked: float | None


COMMANDS = (
    Whole(
        "sphere-unknown",
        "process: sphere, 60 views, unknown light",
        "process SET -o OUT",
        "rh01-teflon --light nothing",
        18 / 69,
    ),
    Whole(
        "sphere-known",
        "process: sphere, 60 views, map and lamp",
        "process SET -o OUT",
        "rh01-teflon",
        12 / 37,
    ),
    Whole(
        "cat-unknown",
        "process: cat, 3 views, unknown light",
        "process SET -o OUT",
        "rh01-cat --light nothing",
        30 / 113,
    ),
    Whole("doll", "process: painted doll, known light", "process SET -o OUT", "rh01-doll", None),
    Whole(
        "doll-unknown",
        "process: painted doll, unknown light",
        "process SET -o OUT",
        "fail-texture-light",
        1 / 4,
    ),
    Whole("plan-sphere", "plan: sphere, 60 views", "plan rh01-teflon -o OUT", "", 1 / 3),
    Whole("plan-cat", "plan: cat, 3 views", "plan rh01-cat -o OUT", "", 1 / 3),
    Whole("synth", "synth: sphere, 60 views", "synth rh01-teflon -o OUT", "", 1 / 3),
)


@dataclass(frozen=True)
class Taken:
    """What a run took. seconds : by stage, on the clock. processor : seconds of all cores. megabytes : at the peak."""

    seconds: dict[str, float]
    total: float
    processor: float
    megabytes: float


def taken(command: Whole, photoset: Path, module: str, checkout: Path = _ROOT) -> Taken:
    """What a command takes of a version, in a process of its own."""
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        words = [{"SET": str(photoset), "OUT": str(place / "out")}.get(w, w) for w in command.words.split()]
        watch = [sys.executable, "-P", str(_ROOT / "benchmarks" / "stagewatch.py"), str(place / "found.json")]
        environment = os.environ | {"PYTHONPATH": str(checkout), CACHE_VARIABLE: str(place / "cache")}
        done = subprocess.run(
            [*watch, module, *words], cwd=place, env=environment, capture_output=True, text=True
        )
        if done.returncode:
            raise RuntimeError(f"{' '.join(words)} ended with {done.returncode}:\n{done.stderr.strip()}")
        return Taken(**json.loads((place / "found.json").read_text(encoding="utf-8")))


def written_set(command: Whole, place: Path) -> Path:
    """The set that a command takes, synthesised by this version."""
    folder = place / command.name
    if command.scene:
        words = ["synth", *command.scene.split(), "-o", str(folder)]
        program = "from lightfactor.cli import main; main()"
        subprocess.run([sys.executable, "-c", program, *words], check=True, capture_output=True, cwd=_ROOT)
    return folder


def whole_figure(commands: Sequence[Whole], now: Mapping[str, Taken], before: Mapping[str, Taken]) -> Figure:
    """Bars by stage, of this version below the other one, in parts of the other one's time; by the commands' names."""
    figure = Figure(figsize=(11, 1.0 + 0.8 * len(commands)), layout="constrained")
    axes = figure.subplots()
    stages = [*dict.fromkeys(STAGES.values()), REST]
    colours = dict(zip(stages, [*COLOURS, *_PALE, GREY], strict=False))
    drawn: set[str] = set()
    for place, command in enumerate(commands):
        own, other = now[command.name], before.get(command.name)
        unit = (other or own).total
        for offset, each in ((0.2, own), (-0.2, other)):
            left = 0.0
            for stage in stages if each is not None else []:
                share = each.seconds.get(stage, 0.0) / unit
                if share > 0:
                    label = None if stage in drawn else stage
                    axes.barh(place + offset, share, 0.36, left, color=colours[stage], label=label)
                    drawn.add(stage)
                left += share
            if each is not None:
                axes.text(left + 0.01, place + offset, f"{each.total:.0f} s", va="center", fontsize=8)
        if other is not None and command.asked is not None:
            axes.plot([command.asked] * 2, [place, place + 0.4], "k-", lw=2)
    axes.set_yticks(range(len(commands)), [command.what for command in commands])
    axes.invert_yaxis()
    axes.set_xlabel("time in parts of the earlier version's, whose bars are the upper ones; black: asked for")
    figure.legend(fontsize=8, loc="outside right upper")
    axes.grid(axis="x", alpha=0.2)
    axes.set_xlim(right=1.08 * axes.get_xlim()[1])
    return figure


def main(arguments: list[str]) -> None:
    """Measure, print and draw."""
    options = documented_parser("python -m benchmarks.whole", __doc__)
    options.add_argument("figure", type=Path, help="where to draw; measurements are kept beside it, in .json")
    options.add_argument("--before", nargs=2, metavar=("CHECKOUT", "MODULE"), help="another version")
    options.add_argument("--only", choices=[command.name for command in COMMANDS], metavar="NAME")
    chosen = options.parse_args(arguments)
    commands = [command for command in COMMANDS if chosen.only in (None, command.name)]
    kept = Kept(chosen.figure.with_suffix(".json"), {})
    found: dict[str, dict[str, Taken]] = {"before": {}, "now": {}}
    with tempfile.TemporaryDirectory(prefix="lightfactor-whole-") as folder:
        for command in commands:
            photoset = None
            for version, (module, checkout) in _versions(chosen.before).items():
                key = f"{command.name}, {version}"
                if key not in kept and checkout is not None:
                    photoset = photoset or written_set(command, Path(folder))
                    kept[key] = vars(taken(command, photoset, module, checkout))
                if key in kept:
                    found[version][command.name] = Taken(**kept[key])
                    _print(command.what, version, found[version][command.name])
    save(whole_figure(commands, found["now"], found["before"]), chosen.figure, kept.caption)


def _versions(before: Sequence[str] | None) -> dict[str, tuple[str, Path | None]]:
    """Command lines of the versions and their checkouts; None of one that may have been measured earlier only."""
    module, checkout = ("", None) if before is None else (before[1], Path(before[0]).resolve())
    return {"before": (module, checkout), "now": (_MODULE, _ROOT)}


def _print(what: str, version: str, found: Taken) -> None:
    parts = ", ".join(
        f"{stage} {found.seconds[stage]:.1f}"
        for stage in sorted(found.seconds, key=found.seconds.__getitem__, reverse=True)
    )
    print(
        f"{what:42} {version:7} {found.total:6.1f} s, processor {found.processor:6.1f} s,"
        f" {np.round(found.megabytes, -1):5.0f} MB: {parts}",
        flush=True,
    )


if __name__ == "__main__":
    main(sys.argv[1:])
