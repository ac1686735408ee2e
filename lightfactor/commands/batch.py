"""lightfactor batch: many photo sets in, all their results and one page over them out."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from capture.commands.options import ClusterAddress
from invrender.commands.process import DEFAULT_SAMPLES


def batch(
    sets: Annotated[
        list[str],
        typer.Argument(
            metavar="SETS...",
            help="Folders of photo sets, folders that hold such, patterns in quotes ('shoot/*/'), or CSV files: a"
            " column set (relative to the file), and if you like name, samples and published.",
            show_default=False,
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(
            "-o",
            "--out",
            metavar="OUT",
            help="Folder for all results, each in a folder by its set's name.",
            show_default=False,
        ),
    ],
    samples: Annotated[
        int,
        typer.Option(min=1000, help="Pixels of each set that enter its fit; a CSV file may say otherwise."),
    ] = DEFAULT_SAMPLES,
    workers: Annotated[
        int,
        typer.Option(
            min=1, help="Sets that are processed at a time, each on its share of the cores; memory adds up."
        ),
    ] = 1,
    fresh: Annotated[
        bool, typer.Option("--fresh", help="Process sets again whose results are there and up to date.")
    ] = False,
    cluster: ClusterAddress = None,
) -> None:
    """Process many photo sets: all results, one page over them, results.csv.

    Writes OUT/NAME/ for each set as `process` does; OUT/index.html, a table to sort; OUT/results.csv, a row per set
    with each number and its standard deviation, and OUT/results.parquet where pyarrow is installed. A set that fails is
    named with its error, and the others are processed all the same; the exit code is then 1. Run again, it does the
    rest: a result is kept where photographs, masks, calibrations, manifest, settings and version are those it was made
    of.
    """
    from lightfactor.batch.run import run_batch

    if not run_batch(sets, out, samples, workers, fresh, cluster):
        raise typer.Exit(1)
