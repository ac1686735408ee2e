"""RH01's Fig. 7, 11 and 12 on synthetic spheres: python -m benchmarks.spheres.

Photographs by brute-force integration, 1% noise, an area light and a source. Parts: `table`, truth beside estimate for
known and unknown light, 60 views and 3, six materials, all rungs of transfer and RH01's own procedures, with what
is within the budget (+) and what isn't (!); `fig12`, how far the lights recovered from six spheres differ; `coverage`,
errors over many draws of the noise in their own standard deviations; `timing`, time against error. What is measured is
kept in FOLDER at once: an interrupted run goes on where it was.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks.kept import Kept
from benchmarks.spheres import coverage, timing
from benchmarks.spheres.bench import MATERIALS
from benchmarks.spheres.figures import draw_errors, draw_lights
from benchmarks.spheres.table import cases, measure, print_consistency, print_table

PARTS = ("table", "fig12", "coverage", "timing")
RUNGS = ("exact", "filtered", "mirror", "published")


def main() -> None:
    """Measure what isn't kept, print tables, draw figures."""
    options = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    options.add_argument("--part", nargs="*", choices=PARTS, default=PARTS)
    options.add_argument("--light", nargs="*", choices=("known", "unknown"), default=("known", "unknown"))
    options.add_argument("--views", nargs="*", type=int, choices=(60, 3), default=(60, 3))
    options.add_argument("--materials", nargs="*", choices=tuple(MATERIALS), default=tuple(MATERIALS))
    options.add_argument("--rungs", nargs="*", choices=RUNGS, default=RUNGS)
    options.add_argument("--samples", type=int, default=25_000, help="of all photographs, in the table")
    options.add_argument("--draws", type=int, default=200, help="of the noise, for coverage")
    options.add_argument("--draw-material", choices=tuple(MATERIALS), default="teflon")
    options.add_argument("--draw-samples", type=int, default=6000)
    options.add_argument("--draw-views", type=int, default=30)
    options.add_argument("--largest", type=int, default=timing.SAMPLES[-1], help="most samples, for timing")
    options.add_argument(
        "--folder", type=Path, default=Path("build/spheres"), help="where measurements are kept"
    )
    options.add_argument("--figures", type=Path, help="where spheres-*.png go; the folder if left out")
    chosen = options.parse_args()
    figures: Path = chosen.figures or chosen.folder
    figures.mkdir(parents=True, exist_ok=True)
    if {"table", "fig12"} & set(chosen.part):
        kept = Kept(chosen.folder / "table.json", {"samples": chosen.samples, "seed": 0})
        rows = []
        for case in cases(chosen.light, chosen.views, chosen.materials, chosen.rungs):
            fresh = case.key not in kept
            rows.append((case, measure(case, kept, chosen.samples)))
            if fresh:
                print(f"measured {case.key} in {rows[-1][1]['seconds']:.1f} s", flush=True)
        if "table" in chosen.part:
            print_table(rows)
            draw_errors(rows, kept, figures / "spheres-errors.png")
        if "fig12" in chosen.part:
            print_consistency(rows)
            draw_lights(rows, kept, figures / "spheres-light.png")
    if "coverage" in chosen.part:
        for light in chosen.light:
            setting = (chosen.draw_material, light, chosen.draw_views, chosen.draw_samples)
            title = "{}, {} light, {} views, {} samples".format(*setting)
            kept = Kept(chosen.folder / f"draws-{light}.json", {"of": title})
            coverage.draw(kept, *setting, chosen.draws)
            coverage.print_coverage(kept, title)
    if "timing" in chosen.part:
        kept = Kept(chosen.folder / "timing.json", {"largest": chosen.largest})
        timing.measure(kept, chosen.largest)
        timing.print_timing(kept)
        timing.draw_timing(kept, figures / "spheres-time.png")


if __name__ == "__main__":
    main()
