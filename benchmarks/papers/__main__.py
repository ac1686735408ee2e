"""The figures and tables of RH01 and of R02, chapters 2 and 5: python -m benchmarks.papers [FIGURE ...].

    python -m benchmarks.papers                     all of them, from scratch, into docs/papers
    python -m benchmarks.papers rh01-fig4 r02-fig5.5
    python -m benchmarks.papers --list

Each is drawn from photographs that are rendered by brute-force integration, or from measured BRDFs and real light,
and stands beside what the paper printed. The index, README.md, is written anew after each. LIGHTFACTOR_DATA names the
folder of real data; what needs it says so where it is missing.
"""

from __future__ import annotations

import os
import sys
import time
import traceback
from collections.abc import Sequence
from difflib import get_close_matches
from pathlib import Path

from benchmarks.commandline import documented_parser
from benchmarks.kept import Kept
from benchmarks.papers.catalogue import ENTRIES
from benchmarks.papers.entry import MissingMeansError, Workplace
from benchmarks.papers.page import write_index

_DOCS = Path(__file__).parents[2] / "docs" / "papers"


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw what is asked for, and write the index."""
    options = documented_parser("python -m benchmarks.papers", __doc__)
    options.add_argument(
        "figures", nargs="*", metavar="FIGURE", help="names as in the index; all if left out"
    )
    options.add_argument("--list", action="store_true", help="list the names, and end")
    options.add_argument(
        "--quick", action="store_true", help="coarse versions, of those figures that have one"
    )
    options.add_argument(
        "--out", type=Path, help="folder of pictures and index (docs/papers; build/papers if quick)"
    )
    options.add_argument(
        "--sets",
        type=Path,
        default=Path("build/papers/sets"),
        help="folder where rendered photo sets are kept",
    )
    chosen = options.parse_args(arguments)
    drawn = {name: entry for name, entry in ENTRIES.items() if entry.draw is not None}
    if chosen.list:
        print("\n".join(f"{entry.name:16} {entry.shows}" for entry in ENTRIES.values()))
        return
    for name in chosen.figures:
        if name not in drawn:
            sys.exit(_refusal(name, list(drawn)))
    out = chosen.out or (Path("build/papers") if chosen.quick else _DOCS)
    if out.exists() and not out.is_dir():
        sys.exit(f"{out}: is a file; give the name of a folder for the figures")
    out.mkdir(parents=True, exist_ok=True)
    chosen.sets.mkdir(parents=True, exist_ok=True)
    data = os.environ.get("LIGHTFACTOR_DATA")
    place = Workplace(out, chosen.sets, Path(data) if data else None, chosen.quick)
    kept = Kept(out / "papers.json", {"quick": chosen.quick})
    names = chosen.figures or [name for name, entry in drawn.items() if entry.coarse or not chosen.quick]
    failed = [name for name in names if not _draw(name, place, kept)]
    print(f"written: {out / 'README.md'}")
    if failed:
        sys.exit(f"failed: {', '.join(failed)}")


def _draw(name: str, place: Workplace, kept: Kept) -> bool:
    """Draw one figure, keep what came of it, and write the index; False where it failed."""
    draw = ENTRIES[name].draw
    assert draw is not None
    print(f"{name} ...", flush=True)
    begin = time.perf_counter()
    try:
        outcome = draw(place)
    except MissingMeansError as missing:
        print(f"{name}: left out: {missing}", flush=True)
        return True
    except Exception:
        traceback.print_exc()
        return False
    seconds = time.perf_counter() - begin
    print(f"{name}: {outcome.ours} (printed: {outcome.printed}), {seconds:.0f} s", flush=True)
    kept[name] = {**outcome.document(), "seconds": round(seconds, 1)}
    write_index(place.out / "README.md", kept)
    return True


def _refusal(name: str, names: Sequence[str]) -> str:
    if name in ENTRIES:
        return f"{name}: there is nothing to draw: {ENTRIES[name].reason}"
    near = get_close_matches(name, names, 1)
    return f"there is no figure {name!r}: " + (f"did you mean {near[0]!r}?" if near else "--list names them")


if __name__ == "__main__":
    main()
