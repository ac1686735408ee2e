"""Commands at work: progress on the terminal, result folders on disk."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from capture.imagefile import write_exr
from capture.outfolder import result_folder
from capture.photoset import PhotoSet, load_photoset
from invrender.factorization import Factorization, Quantity
from invrender.pipeline import DEFAULT_SAMPLES, Prediction, Run, process
from invrender.report.page import ReportWriter
from invrender.result import file_hash, identifiability, lighting_map, result_document, write_json

console = Console(highlight=False)


def run_process(source: Path, out: Path, samples: int = DEFAULT_SAMPLES) -> Run:
    """Process a photo set into a result folder and print the summary."""
    photoset = load_photoset(source)
    with result_folder(out, "result.json") as folder:
        run = process(photoset, samples, track)
        _write_result(run, folder)
    _print_summary(run.result)
    console.print(
        f"Results: {out / 'result.json'}   Open in a browser: {out / 'report.html'}", soft_wrap=True
    )
    return run


def run_demo(out: Path) -> None:
    """Make the demonstration's photo set, process it, and print truth beside estimate."""
    from synthetic.demo import write_demo
    from synthetic.writer import TRUTH_NAME

    photos = out / "photos"
    with result_folder(photos, TRUTH_NAME) as folder:
        write_demo(folder, track)
    run = run_process(photos, out / "result")
    truth = json.loads((photos / TRUTH_NAME).read_text(encoding="utf-8"))["brdf"]
    table = Table(title="Truth beside estimate", title_justify="left")
    for heading in ("parameter", "truth", "estimate", "std", "off by"):
        table.add_column(heading, justify="left" if heading == "parameter" else "right")
    for name in ("kd", "ks", "mu", "sigma"):
        quantity = run.result.quantities.get(name)
        expected = truth[name] if isinstance(truth[name], list) else [truth[name]]
        if quantity is None or quantity.value is None or quantity.std is None:
            table.add_row(name, _triple(expected), "undetermined", "", "")
            continue
        off = [value - true for value, true in zip(quantity.value, expected, strict=True)]
        worst = max(off, key=abs)
        relative = f"{worst:+.5f} ({worst / expected[off.index(worst)]:+.2%})"
        table.add_row(name, _triple(expected), _triple(quantity.value), _triple(quantity.std), relative)
    console.print(table)
    console.print(f"Photo set: {photos}", soft_wrap=True)


def track(items: Iterable[Any], description: str) -> Iterator[Any]:
    """Iterate with a progress bar that vanishes when done; nothing is shown where stdout is no terminal."""
    if not console.is_terminal:
        yield from items
        return
    items = list(items)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=True) as progress:
        yield from progress.track(items, description=description)


def _write_result(run: Run, folder: Path) -> None:
    result = run.result
    files = {}
    several = len(result.lightings) > 1
    for entry in result.lightings:
        name = entry.lighting.name
        files[name] = f"lighting-{name}.exr" if several else "lighting.exr"
        write_exr(folder / files[name], lighting_map(entry))
    (folder / "predicted").mkdir()
    document = result_document(result, files, _input_hashes(run.photoset), run.seconds)
    report = ReportWriter(run, document)
    for prediction in _with_progress(run):
        name = prediction.photo.label.replace("/", "_")
        path = folder / "predicted" / Path(name).with_suffix(".exr")
        write_exr(path, prediction.predicted)
        report.add(prediction)
    write_json(folder / "result.json", document)
    report.write(folder / "report.html")


def _with_progress(run: Run) -> Iterator[Prediction]:
    predictions = run.predictions()
    for _ in track(range(len(run.photoset.photos)), "Predicting photographs"):
        yield next(predictions)


def _input_hashes(photoset: PhotoSet) -> dict[str, str]:
    """Hashes of every file that the result depends on, by the name that the manifest gives it."""
    paths = {photoset.manifest.name: photoset.manifest}
    for photo in photoset.photos:
        paths[photo.label] = photo.file
        if photo.mask is not None:
            paths[photo.mask.name] = photo.mask
    for table in photoset.lightings:
        ball = table.mirror_ball
        for name in (table.map, ball.photo if ball else None, ball.mask if ball else None):
            if name is not None:
                paths[name] = photoset.resolve(name)
    return {name: file_hash(path) for name, path in paths.items()}


def _print_summary(result: Factorization) -> None:
    table = Table(title=f"{result.name}: {result.model.estimate.model.name}", title_justify="left")
    for heading in ("parameter", "value", "std", "status"):
        table.add_column(heading, justify="right" if heading in ("value", "std") else "left")
    for row in identifiability(result):
        name = row["parameter"]
        quantity = result.quantities.get(name)
        table.add_row(_label(name), *_cells(quantity), row["status"] if quantity else "not needed")
    console.print(table)
    held_out = result.rms(held_out=True)
    console.print(
        f"RMS {result.rms(held_out=False):.2%} of the radiance, {result.model.error:.2%} on photographs not seen"
        + (f", {held_out:.2%} on those held out" if held_out is not None else "")
    )
    ladder = ", ".join(f"{rung.estimate.model.name} {rung.error:.2%}" for rung in result.rungs)
    console.print(
        f"Models by error on unseen photographs: {ladder}; chosen: {result.model.estimate.model.name}"
    )
    console.print(f"Scale: {result.gauge}")
    for row in identifiability(result):
        if row["reason"]:
            console.print(f"{_label(row['parameter'])}: {row['reason']}. To settle it: {row['remedy']}.")
    for warning in result.warnings:
        console.print(f"Warning: {warning}", style="yellow")


def _label(name: str) -> str:
    return {"kd": "Kd (1/sr)", "ks": "Ks", "mu": "mu", "sigma": "sigma (rad)"}[name]


def _cells(quantity: Quantity | None) -> tuple[str, str]:
    if quantity is None or quantity.value is None or quantity.std is None:
        return "-", "-"
    return _triple(quantity.value), _triple(quantity.std)


def _triple(values: Iterable[float]) -> str:
    return "  ".join(f"{value:.4g}" if abs(value) >= 1e-3 else f"{value:.2g}" for value in values)
