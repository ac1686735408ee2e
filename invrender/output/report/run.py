"""Commands at work: progress on the terminal, result folders on disk."""

from __future__ import annotations

import json
from pathlib import Path

from rich.table import Table

from capture.files.outfolder import added_files, claimed, result_folder
from capture.photoset import load_photoset
from capture.tasks.store import kept
from capture.tasks.workplace import opened_workplace
from capture.terminal import console, leave_cleanly_when_stopped, track
from invrender.estimate.quantities import Quantity, limits
from invrender.estimate.solution import Solution
from invrender.output.report.files import (
    PICTURES,
    RESULT_FILES,
    photoset_hashes,
    pictures_stage,
    write_fit,
    write_pictures,
)
from invrender.output.report.keptfit import fit_place, keep_fit
from invrender.process.pipeline import DEFAULT_SAMPLES, process
from invrender.process.texture_passes import PIXELS_STAGE, TILES_STAGE
from invrender.result.document import identifiability, own_numbers
from invrender.result.run import Run
from invrender.result.sentences import errors_in_words, filters_in_words, reference_in_words
from invrender.transport.columns import COLUMNS_STAGE
from invrender.wording import PARAMETER_LABELS, parameter_lines

# Models whose errors are printed; the report has all of them.
_MOST_MODELS = 5


def run_process(
    source: Path,
    out: Path,
    samples: int = DEFAULT_SAMPLES,
    published: bool = False,
    fresh: bool = False,
    workers: int | None = None,
    cluster: str | None = None,
) -> Run:
    """Process a photo set into a result folder and print the summary.

    fresh, workers, cluster : as of `opened_workplace`.
    """
    leave_cleanly_when_stopped()
    # Workers elsewhere are in other folders.
    photoset = load_photoset(source.absolute() if cluster else source)
    settings = {"samples": samples, "published": published}
    with claimed(out), opened_workplace(photoset.manifest, workers, cluster, fresh) as workplace:
        inputs = photoset_hashes(photoset)
        place = fit_place(workplace.store, photoset, inputs, settings)
        found = None if fresh else kept(place)
        with result_folder(out, RESULT_FILES) as folder:
            run = (
                found[0] if found else keep_fit(place, process(photoset, samples, track, published=published))
            )
            document = write_fit(run, folder, {"settings": settings}, inputs)
        if found is not None:
            console.print("An earlier run had solved this and was stopped: what lacks is made now.")
        _print_summary(run)
        # What was found is safe now, whatever becomes of the pictures.
        with added_files(out, PICTURES) as folder:
            document = write_pictures(run, folder, document, track, key=place.name)
        # It is in the result now.
        for stage in (COLUMNS_STAGE, pictures_stage(place.name), PIXELS_STAGE, TILES_STAGE):
            workplace.store.forget(stage)
        place.unlink(missing_ok=True)
    console.print(errors_in_words(document["fit"]))
    console.print(
        f"Results: {out / 'result.json'}   Open in a browser: {out / 'report.html'}", soft_wrap=True
    )
    return run


def run_demo(out: Path) -> None:
    """Make the demonstration's photo set, process it, and print truth beside estimate."""
    from synthetic.demo import write_demo
    from synthetic.writer import PHOTOSET_FILES, TRUTH_NAME

    leave_cleanly_when_stopped()
    photos = out / "photos"
    with result_folder(photos, PHOTOSET_FILES) as folder:
        write_demo(folder, track)
    run = run_process(photos, out / "result")
    truth = json.loads((photos / TRUTH_NAME).read_text(encoding="utf-8"))["brdf"]
    table = Table(title="Truth beside estimate", title_justify="left")
    for heading in ("parameter", "truth", "estimate ± std", "off by"):
        table.add_column(heading)
    for name in ("kd", "ks", "mu", "sigma"):
        quantity = run.solution.quantities.get(name)
        expected = truth[name] if isinstance(truth[name], list) else [truth[name]]
        lines = _lines(name, quantity)
        for k, (label, text) in enumerate(lines):
            off = (
                ""
                if quantity is None or quantity.value is None
                else f"{quantity.value[k] / expected[k] - 1:+.3%}"
            )
            table.add_row(label, f"{expected[k]:.5g}", text, off)
    console.print(table)
    console.print(f"Photo set: {photos}", soft_wrap=True)


def _print_summary(run: Run) -> None:
    solution, textures = run.solution, run.textures
    table = Table(title=f"{run.photoset.name}: {solution.model.estimate.model.name}", title_justify="left")
    for heading in ("parameter", "value ± std", "status", "limited most by"):
        table.add_column(heading)
    rows = identifiability(solution)
    for row in rows:
        quantity = solution.quantities.get(row["parameter"])
        status = row["status"] if quantity or solution.misfits else "not needed"
        for label, text in _lines(row["parameter"], quantity, solution.is_absolute):
            table.add_row(label, text, status, limits(quantity.shares, 1) if quantity else "")
    for name in ("exponent", *own_numbers(solution.brdf)):
        if quantity := solution.quantities.get(name):
            table.add_row(*_lines(name, quantity)[0], quantity.status, limits(quantity.shares, 1))
    console.print(table)
    if textures is not None:
        console.print(
            f"Kd{' and Ks vary' if textures.ks_varies else ' varies'} over the surface: these are means over the"
            f" {textures.share_known:.0%} of it that the photographs determine; the maps lie beside the report."
        )
    console.print(f"Scale: {solution.gauge}.")
    for score in run.references:
        console.print(reference_in_words(score))
    console.print(_ladder(solution))
    if run.photoset.extinction is not None:
        console.print(filters_in_words(run.photoset.extinction))
    if run.interreflection is not None:
        console.print(str(run.interreflection))
    for reason, remedy in dict.fromkeys((row["reason"], row["remedy"]) for row in rows if row["reason"]):
        names = [
            PARAMETER_LABELS.get(row["parameter"], row["parameter"])
            for row in rows
            if row["reason"] == reason
        ]
        console.print(f"{', '.join(names)}: {reason}. To settle it: {remedy}.")
    for warning in run.warnings:
        console.print(f"Warning: {warning}", style="yellow")


def _ladder(solution: Solution) -> str:
    """The models that were tried with their errors; of many those that matter."""
    shown, rest = list(solution.candidates), ""
    if len(shown) > _MOST_MODELS:
        shown = sorted(shown, key=lambda candidate: candidate.error)[: _MOST_MODELS - 1]
        rest = f"; the other {len(solution.candidates) - len(shown)} are in the report"
    ladder = ", ".join(f"{candidate.estimate.model.name} {candidate.error:.2%}" for candidate in shown)
    return (
        f"Error of {'each model' if not rest else 'the best models'} on unseen photographs: {ladder}{rest}."
    )


def _lines(name: str, quantity: Quantity | None, is_absolute: bool = True) -> list[tuple[str, str]]:
    """Label and text of each number of a parameter."""
    if quantity is None:
        return parameter_lines(name, None, None, is_absolute)
    return parameter_lines(name, quantity.value, quantity.std, is_absolute)
