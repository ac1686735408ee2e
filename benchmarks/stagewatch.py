"""Where a command's time goes: python benchmarks/stagewatch.py OUT.json MODULE WORDS ...

Runs `main` of a module that is a command line, of whatever version of the program is on the path, and looks every 20 ms
at what its first thread does. Its standard library alone is imported, so that nothing of this version runs with it.
"""

from __future__ import annotations

import importlib
import json
import os
import resource
import sys
import threading
import time
from collections import Counter
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
    code: object = 0
    try:
        importlib.import_module(module).main()
    except SystemExit as end:
        code = end.code
    over.set()
    watch.join()
    usage = resource.getrusage(resource.RUSAGE_SELF)
    found = {
        "seconds": dict(seen),
        "total": time.perf_counter() - begin,
        "processor": usage.ru_utime + usage.ru_stime,
        "megabytes": usage.ru_maxrss / 2**10,
    }
    with open(out, "w", encoding="utf-8") as file:
        json.dump(found, file)
    sys.stdout.flush()
    sys.stderr.flush()
    # A command that leaves threads behind has done its work.
    os._exit(code if isinstance(code, int) else 1)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], sys.argv[3:])
