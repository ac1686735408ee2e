"""Time against error of all methods and settings on the same photographs, and the front that none of the others passes.

    python -m benchmarks --only pareto

Errors are root mean squares over draws of the noise, times medians, relative to the default's in the same run.
"""

from __future__ import annotations

from pathlib import Path

from benchmarks.ink import save, write_table
from benchmarks.kept import Kept
from benchmarks.pareto.boards import Board, Point, measured
from benchmarks.pareto.cats import cat_boards
from benchmarks.pareto.chart import pareto_figure, pareto_table
from benchmarks.pareto.lights import light_board
from benchmarks.pareto.spheres import sphere_boards


def draw_pareto(out: Path, quick: bool) -> None:
    """Write pareto.json, pareto.png and pareto.md."""
    whole = {
        "seeds": "0 and 1 (told order and form: 0 at least)",
        "cat judged by": "8192 directions, 8 x 8 rays",
    }
    kept = Kept(out / "pareto.json", {"seeds": "0"} if quick else whole)
    boards: list[Board] = [*sphere_boards(quick), light_board(quick)]
    if not quick:
        # To photograph it takes longer than all else of a coarse version.
        boards += cat_boards()
    points: dict[str, list[Point]] = {}
    for board in boards:
        points[board.title] = measured(board, kept)
        print(f"  {board.title}", flush=True)
    save(pareto_figure(points), out / "pareto.png", kept.caption)
    write_table(out / "pareto.md", pareto_table(points), kept.caption)
