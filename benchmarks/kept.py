"""Measurements that are kept as they are made, one JSON file per chart, so that interruptions lose nothing.

Each file says on what machine, with which versions and settings its numbers came about. Numbers of other settings
aren't mixed with new ones: then the file begins anew.
"""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Iterator, Mapping, MutableMapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from capture.files.documents import software, write_json

# Packages that numbers and times depend on.
_PACKAGES = ("numpy", "scipy", "embreex", "mitsuba")


class Kept(MutableMapping[str, Any]):
    """Entries of a JSON file, written whenever one is added.

    settings : what the numbers depend on besides the program: the seed, sizes, counts.
    """

    def __init__(self, path: Path, settings: Mapping[str, Any]) -> None:
        self.path = path
        self._head = {"machine": machine(), "settings": json.loads(json.dumps(settings))}
        self._entries: dict[str, Any] = {}
        if path.exists():
            document = json.loads(path.read_text(encoding="utf-8"))
            if document["settings"] == self._head["settings"]:
                self._head["machine"], self._entries = document["machine"], document["entries"]

    def __getitem__(self, key: str) -> Any:
        return self._entries[key]

    def __setitem__(self, key: str, value: Any) -> None:
        self._entries[key] = value
        self._write()

    def __delitem__(self, key: str) -> None:
        del self._entries[key]
        self._write()

    def __iter__(self) -> Iterator[str]:
        return iter(self._entries)

    def __len__(self) -> int:
        return len(self._entries)

    @property
    def caption(self) -> str:
        """Machine, versions and settings in one line, for below a figure or table."""
        settings = (f"{name} {value}" for name, value in self._head["settings"].items())
        return ", ".join([machine_words(self._head["machine"]), *settings])

    def _write(self) -> None:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        # Whole or not at all: a killed run leaves the file as it was.
        beside = self.path.with_name(f".{self.path.name}")
        write_json(beside, {**self._head, "entries": self._entries})
        os.replace(beside, self.path)


def machine() -> dict[str, Any]:
    """Where numbers come about: processor, cores, system, versions."""
    versions = software()
    for name in _PACKAGES:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            continue
    return {
        "processor": _processor(),
        "cores": os.cpu_count() or 1,
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "versions": versions,
    }


def machine_words(made: Mapping[str, Any]) -> str:
    """What `machine` says, in one line."""
    parts = [made["processor"], f"{made['cores']} cores", made["system"], f"Python {made['python']}"]
    return ", ".join([*parts, *(f"{name} {number}" for name, number in made["versions"].items())])


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or "unknown processor"
    named = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return named[0] if named else platform.machine()
