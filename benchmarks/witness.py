"""What the commands find on small built-in scenes, kept so that two versions can be compared.

    python -m benchmarks.witness keep OUT.json                    of this checkout, in some minutes
    python -m benchmarks.witness keep OUT.json --program "..."    of another program: the start of its command line
    python -m benchmarks.witness compare BEFORE.json AFTER.json   what is new, gone or differs; status 1 if any is

PYTHONPATH names the checkout of another version:

    PYTHONPATH=../before python -m benchmarks.witness keep before.json \\
        --program "python -c 'from invrender.cli import main; main()'"

Kept are numbers and words of JSON, TOML, XML and glTF files, and mean and RMS of each channel of EXR pictures; other
files by name only. Timings, versions and hashes are left out. What a command prints is kept where it writes no JSON.
"""

from __future__ import annotations

import json
import math
import os
import re
import shlex
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Mapping
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple, TypeGuard
from xml.etree import ElementTree

import numpy as np

from benchmarks.commandline import documented_parser
from benchmarks.smallscene import small_scene
from capture.files.documents import numbers, write_json
from capture.files.imagefile import read_exr_layers, read_pixels

Value = str | int | float | bool | None

_ROOT = Path(__file__).parents[1]
_PROGRAM = shlex.join([sys.executable, "-c", "from lightfactor.cli import main; main()"])
_RUNS = Path(__file__).with_suffix(".toml")
# Timings, versions and hashes.
_PASSING = {"timing_s", "software", "generator", "inputs", "made_from"}


def keep(out: Path, program: str, runs: Mapping[str, Any]) -> None:
    """Run command lines of a program on changed scenes, and write what they find as JSON: path to value, sorted.

    program : the start of its command line. runs : by scene, as in witness.toml. The error of a command is kept like a
    result; RuntimeError where the program doesn't know a scene.
    """
    kept: dict[str, Value] = {}
    with tempfile.TemporaryDirectory() as temporary:
        for name, run in runs.items():
            folder = Path(temporary) / name
            folder.mkdir()
            shown = _run(program, folder, ["synth", name, "--show"])
            if shown.returncode:
                raise RuntimeError(f"{program} synth {name} --show: {shown.stderr.strip()}")
            scene = small_scene(shown.stdout, run["scene"])
            (folder / "scene.toml").write_text(scene, encoding="utf-8")
            for line in run["lines"]:
                kept |= _kept(program, folder, line.split())
    write_json(out, dict(sorted(kept.items())))


def _run(program: str, folder: Path, words: list[str]) -> subprocess.CompletedProcess[str]:
    # From the scene's folder, so that paths are the same wherever that is; tables are printed without breaks.
    environment = {"PYTHONPATH": str(_ROOT), **os.environ, "COLUMNS": "200"}
    command = [*shlex.split(program), *words]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)


def _kept(program: str, folder: Path, words: list[str]) -> dict[str, Value]:
    """What one command line writes, by paths that begin with scene and output."""
    out = words[words.index("-o") + 1]
    begin = time.perf_counter()
    done = _run(program, folder, words)
    seconds = time.perf_counter() - begin
    print(f"{folder.name}: {' '.join(words)}: {seconds:.0f} s, status {done.returncode}", file=sys.stderr)
    name = f"{folder.name}/{out}"
    kept: dict[str, Value] = {f"{name}/status": done.returncode}
    if done.returncode:
        return {**kept, f"{name}/error": done.stderr.strip().rpartition("\n")[2]}
    written = sorted((folder / out).rglob("*")) if (folder / out).is_dir() else [folder / out]
    for path in written:
        if path.is_file():
            kept |= read_file(path, path.relative_to(folder.parent).as_posix())
    if not any(path.suffix == ".json" for path in written):
        kept |= flat(done.stdout.splitlines(), f"{name}/printed")
    return kept


def read_file(path: Path, name: str) -> dict[str, Value]:
    """What is kept of one file, by paths that begin with a name."""
    match path.suffix:
        case ".json":
            return flat(json.loads(path.read_text(encoding="utf-8")), name)
        case ".toml":
            return flat(tomllib.loads(path.read_text(encoding="utf-8")), name)
        case ".glb":
            # A header of twelve bytes, then the first chunk: its length, its type, JSON.
            data = path.read_bytes()
            return flat(json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")]), name)
        case ".xml" | ".mtlx":
            return flat(_element(ElementTree.parse(path).getroot()), name)
        case ".exr":
            return _channels(path, name)
    return {name: "a file"}


def flat(value: object, path: str) -> dict[str, Value]:
    """Values of nested mappings and lists by their paths; items of a list that have names of their own go by these."""
    if isinstance(value, Mapping):
        parts = {str(key): item for key, item in value.items() if key not in _PASSING}
    elif isinstance(value, list):
        names = [item.get("name") if isinstance(item, Mapping) else None for item in value]
        named = None not in names and len(set(names)) == len(names)
        parts = {str(names[i]) if named else f"{i:03}": item for i, item in enumerate(value)}
    else:
        assert value is None or isinstance(value, Value)
        return {path: value}
    return {key: kept for part, item in parts.items() for key, kept in flat(item, f"{path}/{part}").items()}


def _element(element: ElementTree.Element) -> dict[str, object]:
    """An XML element as nested mappings: its attributes, numbers as such, and its children by their order."""
    children = {f"{child.tag} {i:03}": _element(child) for i, child in enumerate(element)}
    return {**{key: _numbers(text) for key, text in element.attrib.items()}, **children}


def _numbers(text: str) -> object:
    """The numbers that a text lists, or the text."""
    try:
        return [float(word) for word in re.split(r"[,\s]+", text.strip())]
    except ValueError:
        return text


def _channels(path: Path, name: str) -> dict[str, Value]:
    """Mean and RMS of each channel of an EXR."""
    kept: dict[str, Value] = {}
    for layer, pixels in {"RGB": read_pixels(path), **read_exr_layers(path)}.items():
        values = np.asarray(pixels, float).reshape(*pixels.shape[:2], -1)
        mean, rms = values.mean(axis=(0, 1)), np.sqrt((values**2).mean(axis=(0, 1)))
        kept |= flat({"mean": numbers(mean), "rms": numbers(rms)}, f"{name}/{layer}")
    return kept


class Difference(NamedTuple):
    """A value that two kept files don't share.

    size : relative, infinite unless both are numbers. words : its path and how it differs.
    """

    run: str
    size: float
    words: str


def differences(before: Mapping[str, Value], after: Mapping[str, Value], relative: float) -> list[Difference]:
    """All differences, by run (scene and output), the largest of each first.

    relative : numbers differ if they do by more than this share of the largest in their list, or of themselves.
    """
    largest: dict[str, float] = {}
    for path, value in [*before.items(), *after.items()]:
        if _is_number(value):
            largest[_group(path)] = max(abs(value), largest.get(_group(path), 0.0))
    found = []
    for path in {*before, *after}:
        one, other = before.get(path), after.get(path)
        size, how = math.inf, f"{one!r} -> {other!r}"
        if path not in after:
            how = f"gone, was {one!r}"
        elif path not in before:
            how = f"new, {other!r}"
        elif one == other:
            continue
        elif _is_number(one) and _is_number(other):
            size = abs(other - one) / largest[_group(path)]
            how = f"{size:.1e}, {how}"
        if size > relative:
            found.append(Difference("/".join(path.split("/")[:2]), size, f"{path}: {how}"))
    return sorted(found, key=lambda item: (item.run, -item.size, item.words))


def _is_number(value: Value) -> TypeGuard[int | float]:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _group(path: str) -> str:
    """The list that a value lies in; its own path where it is in none."""
    return re.sub(r"/\d{3,}$", "", path)


def compare(before: Path, after: Path, relative: float) -> bool:
    """Print the differences of two kept files; whether there are any."""
    one, other = (json.loads(path.read_text(encoding="utf-8")) for path in (before, after))
    found = differences(one, other, relative)
    for run, group in groupby(found, lambda item: item.run):
        lines = [item.words for item in group]
        print(f"{run}: {len(lines)} differ", *lines, sep="\n  ")
    print(f"{len(found)} of {len({*one, *other})} values differ by more than {relative:g}")
    return bool(found)


def main(arguments: list[str] | None = None) -> None:
    """Keep or compare, as asked."""
    options = documented_parser("python -m benchmarks.witness", __doc__)
    actions = options.add_subparsers(dest="action", required=True)
    keeping = actions.add_parser("keep", help="run the commands and keep what they find")
    keeping.add_argument("out", type=Path, metavar="OUT.json")
    keeping.add_argument("--program", default=_PROGRAM, help="another program: the start of its command line")
    comparing = actions.add_parser("compare", help="what two kept files differ in")
    comparing.add_argument("before", type=Path, metavar="BEFORE.json")
    comparing.add_argument("after", type=Path, metavar="AFTER.json")
    comparing.add_argument("--relative", type=float, default=1e-6, help="differences to ignore (1e-6)")
    chosen = options.parse_args(arguments)
    if chosen.action == "keep":
        keep(chosen.out, chosen.program, tomllib.loads(_RUNS.read_text(encoding="utf-8")))
    else:
        sys.exit(int(compare(chosen.before, chosen.after, chosen.relative)))


if __name__ == "__main__":
    main()
