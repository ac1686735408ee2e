"""A batch at work: progress on the terminal, results and their overview on disk."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from capture.files.outfolder import added_files, claimed
from capture.progress import counted
from capture.terminal import console, leave_cleanly_when_stopped, track
from lightfactor.batch.asked import asked_sets
from lightfactor.batch.page import PAGE_NAME, write_page
from lightfactor.batch.running import Outcome, outcomes, stop_all
from lightfactor.batch.table import TABLE_NAME, table_rows, write_tables


def run_batch(
    given: Sequence[str], out: Path, samples: int, workers: int, fresh: bool, cluster: str | None = None
) -> bool:
    """Process all sets that are named; whether each of them has its result. What failed is said on the terminal."""
    sets = asked_sets(given, samples)
    leave_cleanly_when_stopped(stop_all)
    if out.exists() and not out.is_dir():
        raise ValueError(f"{out}: is a file; give the name of a folder for the results")
    with claimed(out, f"results that were done are in {out}; run it again for the rest"):
        out.mkdir(parents=True, exist_ok=True)
        found: dict[str, Outcome] = {}
        with counted(track, len(sets), f"Processing {len(sets)} photo sets") as on_step:
            for outcome in outcomes(sets, out, workers, fresh, cluster):
                found[outcome.asked.name] = outcome
                on_step(outcome.in_words)
        ordered = [found[asked.name] for asked in sets]
        lacks = _write_overview(out, ordered)
    failed = [outcome for outcome in ordered if outcome.status == "failed"]
    for outcome in failed:
        console.print(f"{outcome.asked.name}: {outcome.error}", style="red", soft_wrap=True, markup=False)
    kept = sum(outcome.status == "kept" for outcome in ordered)
    done = len(ordered) - kept - len(failed)
    console.print(f"{done} processed, {kept} kept as they were, {len(failed)} failed.")
    if lacks:
        console.print(lacks, soft_wrap=True, markup=False)
    console.print(
        f"Results: {out / TABLE_NAME}   Open in a browser: {out / PAGE_NAME}", soft_wrap=True, markup=False
    )
    return not failed


def _write_overview(out: Path, ordered: Sequence[Outcome]) -> str:
    """Write page and tables; what lacks for one of them, in words, or ""."""
    rows = table_rows(ordered)
    with added_files(out, "its overview") as folder:
        write_page(folder, ordered, rows)
        return write_tables(folder, rows)
