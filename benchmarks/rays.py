"""Rays through `recon.mesh.rays` against bare `embreex` times cores, in one run.

    python -m benchmarks.rays [OUT.png [EDGE ...]] [--once]

On the cat, for meshes of several sizes, by the grid's edge in metres: a camera's first hits with weights, shadow rays
from the points hit, and rays over the hemispheres of vertices. Bare is `EmbreeScene.run` with single-precision arrays
made beforehand, in one call and one thread, times the number of cores. They take turns; the ratios of the medians
count: of the time on the clock, and of the processors' time, which other programs on the machine disturb less.
`--once` takes one turn alone, to see whether all works.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from embreex.mesh_construction import TriangleMesh as EmbreeMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from benchmarks.ink import save
from benchmarks.kept import machine, machine_words
from recon.mesh.rays import RayTracer
from recon.mesh.trianglemesh import TriangleMesh
from synthetic.shapes.cat import REACH, cat_field
from synthetic.shapes.meshing import mesh_implicit

Floats = NDArray[np.float64]

_EDGES = (0.002, 0.001, 0.0005)  # metres, about 20,000 to 350,000 faces
_PIXELS, _ROUNDS = 1000, 7
_GOAL = 0.75


class Work(NamedTuple):
    """The same rays through the tracer and bare, and how many they are."""

    name: str
    traced: Callable[[RayTracer], object]
    bare: Callable[[], object]
    rays: int


def works(mesh: TriangleMesh, tracer: RayTracer) -> list[Work]:
    """A camera's rays, shadow rays and hemisphere rays on a mesh of unit size about the origin."""
    rng = np.random.default_rng(5)
    scene = EmbreeScene()
    EmbreeMesh(scene, mesh.vertices.astype(np.float32), mesh.faces.astype(np.int32))

    x, y = np.meshgrid(*2 * [(np.arange(_PIXELS) + 0.5) / _PIXELS - 0.5])
    directions = np.column_stack([np.full(x.size, -1.0), 0.5 * x.ravel(), 0.5 * y.ravel()])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    origins = np.broadcast_to([2.0, 0.0, 0.0], directions.shape)
    o32, d32 = origins.astype(np.float32), directions.astype(np.float32)

    hits = tracer.first_hits(origins, directions)
    hit = hits.faces >= 0
    faces = tracer.faces[hits.faces[hit]]
    a, b, c = (mesh.vertices[corner] for corner in faces.T)
    facets = np.cross(b - a, c - a)
    facets /= np.linalg.norm(facets, axis=1, keepdims=True)
    positions = np.einsum("nk,nkc->nc", hits.weights[hit], mesh.vertices[faces])
    towards = rng.normal(size=positions.shape)
    towards *= np.sign((towards * facets).sum(axis=1, keepdims=True))
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    p32, t32 = (positions + 1e-4 * facets).astype(np.float32), towards.astype(np.float32)

    some = np.sort(rng.choice(len(mesh.vertices), 4000, replace=False))
    sky = rng.normal(size=(512, 3))
    sky /= np.linalg.norm(sky, axis=1, keepdims=True)
    vertex, above = np.nonzero(mesh.normals[some] @ sky.T > 0)
    v32 = (mesh.vertices[some] + 1e-4 * mesh.normals[some]).astype(np.float32)[vertex]
    s32 = sky.astype(np.float32)[above]
    return [
        Work(
            "camera",
            lambda tracer: tracer.first_hits(origins, directions),
            lambda: scene.run(o32, d32, output=1),
            len(o32),
        ),
        Work(
            "shadow",
            lambda tracer: tracer.occluded(positions, facets, towards),
            lambda: scene.run(p32, t32, query="OCCLUDED"),
            len(p32),
        ),
        Work(
            "hemisphere",
            lambda tracer: tracer.occluded_sky(mesh.vertices[some], mesh.normals[some], sky),
            lambda: scene.run(v32, s32, query="OCCLUDED"),
            len(v32),
        ),
    ]


def seconds(work: Callable[[], object]) -> tuple[float, float]:
    """On the clock, and of all processors."""
    clock, processors = time.perf_counter(), time.process_time()
    work()
    return time.perf_counter() - clock, time.process_time() - processors


def measured(
    work: Work, single: RayTracer, spread: RayTracer, rounds: int = _ROUNDS
) -> tuple[float, float, float, float, float]:
    """Bare rays per second and core, and the shares of it that the tracer reaches.

    On all cores by the clock and by the processors' time, and in one thread by the processor's time; and, by the
    clock, what bare calls themselves reach of that when every core makes one at once.
    """
    bare, alone, together, crowd = [], [], [], []
    for _ in range(rounds):
        bare.append(seconds(work.bare))
        alone.append(seconds(lambda: work.traced(single)))
        together.append(seconds(lambda: work.traced(spread)))
        crowd.append(seconds(lambda: all_at_once(work.bare)))
    (clock, busy), (_, one), (all_cores, all_busy), (crowded, _) = (
        np.median(each, axis=0) for each in (bare, alone, together, crowd)
    )
    cores = os.cpu_count() or 1
    return work.rays / clock, clock / cores / all_cores, busy / all_busy, busy / one, clock / crowded


def all_at_once(work: Callable[[], object]) -> None:
    """The same work in as many threads as there are cores."""
    threads = [threading.Thread(target=work) for _ in range(os.cpu_count() or 1)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


def main(out: Path, edges: Sequence[float], rounds: int = _ROUNDS) -> None:
    """Print the ratios, medians of some rounds, and draw them."""
    from matplotlib.figure import Figure

    shares: dict[str, list[float]] = {}
    counts = []
    print(f"{'':>32} | {'all cores':^21} | one thread | bare on all")
    print(
        f"{'faces':>8} {'rays':12} {'bare 1/s':>10} | {'clock':>10} {'processor':>10} | {'processor':>10}"
        f" | {'clock':>10}"
    )
    for edge in edges:
        mesh = mesh_implicit(cat_field, REACH, edge)
        low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
        mesh = TriangleMesh((mesh.vertices - (low + high) / 2) / (high - low).max(), mesh.faces, mesh.normals)
        single = RayTracer(mesh.vertices, mesh.faces)
        spread = RayTracer(mesh.vertices, mesh.faces, on_all_cores=True)
        counts.append(len(mesh.faces))
        for work in works(mesh, single):
            bare, *share = measured(work, single, spread, rounds)
            columns = "{:10.0%} {:10.0%} | {:10.0%} | {:10.0%}".format(*share)
            print(f"{len(mesh.faces):8d} {work.name:12} {bare:10.3g} | {columns}")
            shares.setdefault(work.name, []).append(share[0])
    figure = Figure(figsize=(6.4, 4.0), layout="constrained")
    axes = figure.subplots()
    for name, each in shares.items():
        axes.semilogx(counts, [100 * share for share in each], "o-", label=f"{name} rays")
    axes.axhline(100 * _GOAL, color="grey", linestyle=":", label="to reach")
    axes.set_ylim(0, 110)
    axes.set_xlabel("faces of the mesh")
    axes.set_ylabel("rays per second, % of bare embreex x cores")
    axes.set_title(f"Rays through recon.mesh.rays on {os.cpu_count()} cores", fontsize=10)
    axes.legend(fontsize=8, loc="lower left")
    save(figure, out, machine_words(machine()))
    print(f"Chart: {out}")


if __name__ == "__main__":
    given = [word for word in sys.argv[1:] if word != "--once"]
    main(
        Path(given[0]) if given else Path("rays.png"),
        [float(e) for e in given[1:]] or _EDGES,
        1 if "--once" in sys.argv else _ROUNDS,
    )
