"""All charts of speed against accuracy, and of stability where methods fail: python -m benchmarks.

    python -m benchmarks --quick                coarse versions of all of them, in two minutes, into build/benchmarks
    python -m benchmarks                        the figures and tables of docs/benchmarks, in some 45 minutes
    python -m benchmarks --only race --out DIR  one of them

What has been measured is kept beside the charts, in .json: a run that was interrupted goes on, one that is complete
only draws anew. Delete a .json to measure again. Times are ratios within one run; leave the machine alone meanwhile.
A part that fails doesn't keep the others from being drawn, but makes the command fail.
"""

from __future__ import annotations

import sys
import time
import traceback
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

from benchmarks.atlas.charts import draw_atlas
from benchmarks.calibration import draw_calibration
from benchmarks.commandline import documented_parser
from benchmarks.gloss.chart import draw_gloss
from benchmarks.pareto import draw_pareto
from benchmarks.programs import PROGRAMS
from benchmarks.race import draw_race
from benchmarks.scaling import draw_scaling

CHARTS: dict[str, Callable[[Path, bool], None]] = {
    "atlas": draw_atlas,
    "calibration": draw_calibration,
    "gloss": draw_gloss,
    "pareto": draw_pareto,
    "race": draw_race,
    "scaling": draw_scaling,
    **PROGRAMS,
}
_DOCS = Path(__file__).parents[1] / "docs" / "benchmarks"


def main(arguments: list[str] | None = None) -> None:
    """Draw what is asked for."""
    options = documented_parser("python -m benchmarks", __doc__)
    options.add_argument("--quick", action="store_true", help="coarse versions, to see whether all works")
    options.add_argument("--only", choices=sorted(CHARTS), help=f"one of {', '.join(CHARTS)}", metavar="NAME")
    options.add_argument(
        "--workers", type=int, metavar="N", help="processes of the atlas' sweeps (one per core)"
    )
    options.add_argument(
        "--cluster", metavar="ADDRESS", help="a Dask scheduler, whose workers do these sweeps"
    )
    options.add_argument("--out", type=Path, help="folder of the figures and tables (docs/benchmarks)")
    chosen = options.parse_args(arguments)
    out = chosen.out or (Path("build/benchmarks") if chosen.quick else _DOCS)
    if out.exists() and not out.is_dir():
        sys.exit(f"{out}: is a file; give the name of a folder for the figures")
    names = [chosen.only] if chosen.only else list(CHARTS)
    spread = {"workers": chosen.workers, "cluster": chosen.cluster}
    charts = CHARTS | ({"atlas": partial(draw_atlas, **spread)} if any(spread.values()) else {})
    programs = [name for name in names if name in PROGRAMS] if chosen.quick else []
    failed: list[str] = []

    def draw(name: str) -> None:
        print(f"{name} ...", flush=True)
        begin = time.perf_counter()
        try:
            charts[name](out, chosen.quick)
        except Exception:
            traceback.print_exc()
            failed.append(name)
        print(f"{name}: {time.perf_counter() - begin:.0f} s", flush=True)

    # Coarse versions measure nothing: programs, which are processes of their own, run beside the charts.
    with ThreadPoolExecutor(1) as beside:
        running = [beside.submit(draw, name) for name in programs]
        for name in names:
            if name not in programs:
                draw(name)
        for each in running:
            each.result()
    print(f"written: {out}")
    if failed:
        sys.exit(f"failed: {', '.join(failed)}")


if __name__ == "__main__":
    main()
