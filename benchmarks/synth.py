"""Speed against accuracy of synthetic photographs: how exact they are, and what that costs.

    python -m benchmarks.synth [OUT.png [SCENE ...]]

For built-in scenes one photograph is integrated over more and more directions. The error is that of random pixels that
the object fills against 16384 directions and other random numbers; the time that of the whole photograph, on all cores.
Prints a table and draws it.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.ink import save
from benchmarks.kept import machine, machine_words
from synthetic.render.photograph import Tile, photographs, plain_radiance, tile_radiance
from synthetic.render.pixels import pixel_coverage
from synthetic.scene import Scene
from synthetic.scenes.build import read_staging
from synthetic.scenes.builtin import scene_path

SCENES = ("rh01-teflon", "exact-teflon", "rh01-cat", "cat-interreflection")
DIRECTIONS = (64, 256, 1024)
REFERENCE, JUDGED = 16384, 300


def with_effort(scene: Scene, directions: int) -> Scene:
    return replace(scene, effort=replace(scene.effort, directions=directions))


def measured(scene: Scene) -> list[tuple[int, float, float]]:
    """Directions, seconds of a photograph, relative RMS error."""
    rows, columns = np.nonzero(pixel_coverage(scene.surface, scene.shots[0].camera) == 1)
    chosen = np.random.default_rng(1).choice(len(rows), JUDGED, replace=False)
    judged = Tile(0, 0, np.column_stack([columns, rows])[chosen])
    truth = plain_radiance(replace(with_effort(scene, REFERENCE), seed=99), judged)
    results = []
    for directions in DIRECTIONS:
        finer = with_effort(scene, directions)
        start = time.perf_counter()
        list(photographs(finer))
        seconds = time.perf_counter() - start
        off = tile_radiance(finer, judged) - truth
        results.append((directions, seconds, float(np.sqrt((off**2).mean() / (truth**2).mean()))))
    return results


def main(out: Path, scenes: Sequence[str]) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4, 4.4), layout="constrained")
    axes = figure.subplots()
    print(f"{'scene':22} {'directions':>10} {'s/photo':>8} {'error':>9}")
    for name in scenes:
        scene = read_staging(scene_path(name)).scene
        results = measured(replace(scene, shots=scene.shots[:1]))
        for directions, seconds, error in results:
            print(f"{name:22} {directions:10d} {seconds:8.2f} {error:9.4%}")
        axes.loglog([s for _, s, _ in results], [100 * e for _, _, e in results], "o-", label=name)
    axes.axhline(0.1, color="grey", linestyle=":", label="0.1%")
    axes.set_xlabel("time of a photograph of 320x240 pixels (s)")
    axes.set_ylabel("relative RMS error of a pixel (%)")
    axes.set_title(
        f"Synthetic photographs: {', '.join(map(str, DIRECTIONS))} directions per pixel", fontsize=10
    )
    axes.legend(fontsize=8)
    save(figure, out, machine_words(machine()))
    print(f"Chart: {out}")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("synth.png"), sys.argv[2:] or SCENES)
