"""Where a command's time goes: python -P benchmarks/stagewatch.py OUT.json MODULE WORDS ...

Runs `main` of a module that is a command line, of whatever version of the program is on the path, and looks every 20 ms
at what its first thread does. Only the standard library is imported, so that nothing of this version runs with another.
-P keeps this folder, which has a module `statistics`, off the path.
"""

from __future__ import annotations

import importlib
import json
import resource
import runpy
import sys
import threading
import time
from collections import Counter
from pathlib import Path
from types import FrameType

# Functions, of this version and of earlier ones, whose time is a stage's; the innermost counts.
STAGES = {
    "_find_and_load": "start",
    "photoset_hashes": "start",
    "content_key": "start",
    "read_staging": "scene",
    "find_geometry": "samples",
    "importances": "samples",
    "read_samples": "samples",
    "first_pass": "samples",
    "all_columns": "lobes under the light",
    "columns_of": "lobes under the light",
    "factorize_blind": "search and fit",
    "explain": "search and fit",
    "fit_textured": "search and fit",
    "second_pass": "texels",
    "solve_texture": "texels",
    "correct_known_light": "bounced light",
    "correct_unknown_light": "bounced light",
    "correct_textures": "bounced light",
    "diagnose": "causes and bars",
    "with_calibration": "causes and bars",
    "weighed_photos": "causes and bars",
    "calibration_scores": "causes and bars",
    "solution_of": "causes and bars",
    "write_pictures": "pictures and report",
    "write_results": "pictures and report",
    "write_report": "pictures and report",
    "photographs": "photographs",
    "write_photoset": "photographs",
    "plan_experiment": "plan",
    "advise": "plan",
}
REST = "rest"
_EVERY_S = 0.02


def stage(frame: FrameType | None) -> str:
    """The stage that a thread is in."""
    while frame is not None:
        if frame.f_code.co_name in STAGES:
            return STAGES[frame.f_code.co_name]
        frame = frame.f_back
    return REST


def main(out: str, module: str, words: list[str]) -> None:
    """Run the command, then write seconds by stage, of all on the clock and of the processor, and megabytes."""
    first, over, seen = threading.get_ident(), threading.Event(), Counter[str]()

    def look() -> None:
        before = time.perf_counter()
        while not over.wait(_EVERY_S):
            now = time.perf_counter()
            seen[stage(sys._current_frames().get(first))] += now - before  # type: ignore[assignment]
            before = now

    begin = time.perf_counter()
    watch = threading.Thread(target=look, daemon=True)
    watch.start()
    sys.argv = ["lightfactor", *words]
    code = None
    try:
        importlib.import_module(module).main()
    except SystemExit as end:
        code = end.code
    total = time.perf_counter() - begin
    over.set()
    watch.join()
    usage = resource.getrusage(resource.RUSAGE_SELF)
    peak = runpy.run_path(str(Path(__file__).with_name("memory.py")))["peak_megabytes"]
    found = {
        "seconds": dict(seen),
        "total": total,
        "processor": usage.ru_utime + usage.ru_stime,
        "megabytes": peak(),
    }
    Path(out).write_text(json.dumps(found), encoding="utf-8")
    sys.exit(code)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], sys.argv[3:])
