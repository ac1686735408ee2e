"""Which sets a batch is asked for: folders, patterns, and CSV files with options of their own."""

from __future__ import annotations

import csv
import glob
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from capture.photoset import MANIFEST_NAME
from invrender.process.pipeline import DEFAULT_SAMPLES

# Columns of a CSV file of sets; all but the first may be left out, or empty.
_COLUMNS = ("set", "name", "samples", "published")
_TRUTHS = {"": False, "false": False, "no": False, "0": False, "true": True, "yes": True, "1": True}
_LEAST_SAMPLES = 1000


@dataclass(frozen=True)
class AskedSet:
    """A photo set to be processed. manifest : its photoset.toml. name : of its result's folder."""

    manifest: Path
    name: str
    samples: int = DEFAULT_SAMPLES
    published: bool = False

    @property
    def settings(self) -> dict[str, object]:
        """What the result depends on beside the set, as result.json has it."""
        return {"samples": self.samples, "published": self.published}


def asked_sets(given: Sequence[str], samples: int = DEFAULT_SAMPLES) -> list[AskedSet]:
    """The sets that folders, manifests, patterns and CSV files name, in their order.

    A folder without a manifest stands for the sets in it. samples : of those whose CSV file says nothing of it.
    ValueError for what names no set, for sets that are named twice, and for CSV files with faults.
    """
    found: list[tuple[AskedSet, str]] = []
    for text in given:
        if text.lower().endswith(".csv"):
            found += _listed(Path(text), samples)
        else:
            found += [(AskedSet(manifest, "", samples), text) for manifest in _named(text)]
    seen: dict[Path, str] = {}
    for asked, text in found:
        place = asked.manifest.resolve()
        if place in seen:
            by = f"by {seen[place]}" + (f" and by {text}" if text != seen[place] else "")
            raise ValueError(f"{asked.manifest.parent}: is listed twice, {by}; leave one of them out")
        seen[place] = text
    return _with_names([asked for asked, _ in found])


def _named(text: str) -> list[Path]:
    """Manifests of the sets that a path or a pattern names."""
    path = Path(text)
    if not path.exists() and glob.has_magic(text):
        matches = [Path(match) for match in sorted(glob.glob(text, recursive=True))]
        sets = [manifest for match in matches if (manifest := _manifest(match)) is not None]
        if not sets:
            raise ValueError(f"{text}: matches no photo set, a folder with a {MANIFEST_NAME}")
        return sets
    if not path.exists():
        raise ValueError(f"{text}: does not exist; give folders of photo sets, patterns or CSV files")
    found = _manifest(path)
    if found is not None:
        return [found]
    inside = [_manifest(each) for each in sorted(path.iterdir())] if path.is_dir() else []
    manifests = [each for each in inside if each is not None]
    if not manifests:
        raise ValueError(
            f"{text}: is no photo set, and holds none: neither it nor a folder in it has a {MANIFEST_NAME}"
        )
    return manifests


def _manifest(path: Path) -> Path | None:
    if path.is_file():
        return path if path.suffix == ".toml" else None
    manifest = path / MANIFEST_NAME
    return manifest if manifest.is_file() else None


def _listed(file: Path, samples: int) -> Iterator[tuple[AskedSet, str]]:
    """The sets of a CSV file; their paths are relative to its folder."""
    try:
        with file.open(encoding="utf-8-sig", newline="") as stream:
            rows = list(csv.DictReader(stream))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ValueError(f"{file}: cannot be read as a CSV file ({error})") from error
    columns = list(rows[0]) if rows else []
    wrong = [name for name in columns if name not in _COLUMNS]
    if "set" not in columns or wrong:
        what = (
            f"has a column {wrong[0]!r}" if wrong else "has no rows" if not rows else "lacks the column 'set'"
        )
        raise ValueError(
            f"{file}: {what}; its first row names columns: {', '.join(_COLUMNS)}, of which 'set' is needed"
        )
    for number, row in enumerate(rows, start=2):
        where = f"{file}: line {number}"
        place = (row["set"] or "").strip()
        if not place:
            raise ValueError(f"{where}: names no set")
        manifest = _manifest(file.parent / place)
        if manifest is None:
            raise ValueError(f"{where}: {place}: is no photo set, a folder with a {MANIFEST_NAME}")
        own, published = (row.get("samples") or "").strip(), (row.get("published") or "").strip().lower()
        if own and not (own.isdigit() and int(own) >= _LEAST_SAMPLES):
            raise ValueError(f"{where}: samples is {own!r}; give a number of {_LEAST_SAMPLES} or more")
        if published not in _TRUTHS:
            raise ValueError(f"{where}: published is {published!r}; give true or false")
        name = (row.get("name") or "").strip()
        yield AskedSet(manifest, name, int(own) if own else samples, _TRUTHS[published]), where


def _with_names(sets: Sequence[AskedSet]) -> list[AskedSet]:
    """The sets with names for their results: those given, or their folders', with as much of the path as tells them."""
    names = [asked.name or asked.manifest.resolve().parent.name for asked in sets]
    depth = 1
    while len(set(names)) < len(names):
        depth += 1
        again = {name for name in names if names.count(name) > 1}
        longer = []
        for asked, name in zip(sets, names, strict=True):
            parts = asked.manifest.resolve().parent.parts
            if name in again and (asked.name or depth > len(parts)):
                raise ValueError(f"two sets are to be called {name!r}; give them names that differ")
            longer.append("-".join(parts[-depth:]) if name in again else name)
        names = longer
    for name in names:
        if "/" in name or name.startswith("."):
            raise ValueError(
                f"a set is to be called {name!r}, but its name is that of a folder for its result"
            )
    return [replace(asked, name=name) for asked, name in zip(sets, names, strict=True)]
