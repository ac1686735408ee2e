"""Commands at work: progress on the terminal, result folders on disk."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.table import Table

from capture.files.documents import file_hash, write_json
from capture.files.imagefile import write_exr
from capture.files.outfolder import added_files, result_folder
from capture.photoset import PhotoSet, load_photoset
from capture.terminal import console, leave_cleanly_when_stopped, track
from invrender.estimate.quantities import Quantity
from invrender.estimate.textured.textures import TEXTURE_FILES
from invrender.output.report.page import ReportWriter
from invrender.process.pipeline import DEFAULT_SAMPLES, process
from invrender.process.run import Prediction, Run
from invrender.result.document import (
    errors_in_words,
    identifiability,
    lighting_map,
    result_document,
    with_picture_errors,
)
from invrender.result.factorization import Factorization
from invrender.wording import with_error

RESULT_FILES = ("result.json", "report.html", "predicted", "lighting*.exr", *TEXTURE_FILES)
PICTURES = "predicted photographs and report"


def run_process(source: Path, out: Path, samples: int = DEFAULT_SAMPLES) -> Run:
    """Process a photo set into a result folder and print the summary."""
    leave_cleanly_when_stopped()
    photoset = load_photoset(source)
    with result_folder(out, RESULT_FILES) as folder:
        run = process(photoset, samples, track)
        document = write_fit(run, folder)
    _print_summary(run.result)
    # What was found is safe now, whatever becomes of the pictures.
    with added_files(out, PICTURES) as folder:
        document = write_pictures(run, folder, document)
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
        quantity = run.result.quantities.get(name)
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


def write_fit(run: Run, folder: Path, more: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Write everything that a run found into a folder, but for its pictures; what stands in result.json.

    more : further keys of it.
    """
    result = run.result
    files = {}
    several = len(result.lightings) > 1
    for entry in result.lightings:
        name = entry.lighting.name
        files[name] = f"lighting-{name.replace('/', '_')}.exr" if several else "lighting.exr"
        write_exr(folder / files[name], lighting_map(entry))
    if result.textures is not None:
        assert run.photoset.mesh_to_world is not None
        result.textures.write(folder, run.photoset.mesh_to_world)
    document = result_document(result, files, _input_hashes(run.photoset), run.seconds)
    document |= {"predicted_binning": None, **(more or {})}
    write_json(folder / "result.json", document)
    return document


def write_pictures(run: Run, folder: Path, document: Mapping[str, Any]) -> dict[str, Any]:
    """Write a run's predicted photographs, its report, and its result.json with the errors of these, which is
    returned.
    """
    (folder / "predicted").mkdir()
    report = ReportWriter(run)
    names = _predicted_names([photo.label for photo in run.photoset.photos])
    errors = {}
    for prediction in _with_progress(run):
        write_exr(folder / "predicted" / names[prediction.photo.label], prediction.predicted)
        errors[prediction.photo.label] = prediction.error
        report.add(prediction)
    complete = {**with_picture_errors(document, errors), "predicted_binning": run.binning}
    report.write(folder / "report.html", complete)
    write_json(folder / "result.json", complete)
    return complete


def _with_progress(run: Run) -> Iterator[Prediction]:
    predictions = run.predictions()
    for _ in track(range(len(run.photoset.photos)), "Predicting photographs"):
        yield next(predictions)


def _predicted_names(labels: Sequence[str]) -> dict[str, str]:
    """A file name for each photograph's prediction: its own with .exr for its suffix, or after it where two agree."""
    flat = {label: label.replace("/", "_") for label in labels}
    short = {label: Path(name).with_suffix(".exr").name for label, name in flat.items()}
    shared = Counter(short.values())
    return {label: short[label] if shared[short[label]] == 1 else f"{flat[label]}.exr" for label in labels}


def _input_hashes(photoset: PhotoSet) -> dict[str, str]:
    """Hashes of every file that the result depends on, by its place in the set's folder, or its name elsewhere."""
    paths = [photoset.manifest, *photoset.calibration_files]
    paths += [photoset.resolve(photoset.object.mesh)] if photoset.object.mesh else []
    for photo in photoset.photos:
        paths += [photo.file] + ([photo.mask] if photo.mask else [])
    for table in photoset.lightings:
        named = (table.map, *(table.mirror_ball.files if table.mirror_ball else ()))
        paths += [photoset.resolve(name) for name in named if name]
    hashes: dict[str, str] = {}
    for path in dict.fromkeys(paths):
        inside = path.is_relative_to(photoset.folder)
        name = str(path.relative_to(photoset.folder)) if inside else path.name
        hashes[name if name not in hashes else str(path)] = file_hash(path)
    return hashes


def _print_summary(result: Factorization) -> None:
    table = Table(title=f"{result.name}: {result.model.estimate.model.name}", title_justify="left")
    for heading in ("parameter", "value ± std", "status"):
        table.add_column(heading)
    rows = identifiability(result)
    for row in rows:
        quantity = result.quantities.get(row["parameter"])
        status = row["status"] if quantity or result.misfits else "not needed"
        for label, text in _lines(row["parameter"], quantity, result.is_absolute):
            table.add_row(label, text, status)
    for name in ("exponent", *result.brdf.form.numbers):
        if quantity := result.quantities.get(name):
            table.add_row(*_lines(name, quantity)[0], quantity.status)
    console.print(table)
    if result.textures is not None:
        console.print(
            f"Kd{' and Ks vary' if result.textures.ks_varies else ' varies'} over the surface: these are means over the"
            f" {result.textures.share_known:.0%} of it that the photographs determine; the maps lie beside the report."
        )
    console.print(f"Scale: {result.gauge}.")
    console.print(_ladder(result))
    if result.interreflection is not None:
        console.print(str(result.interreflection))
    for reason, remedy in dict.fromkeys((row["reason"], row["remedy"]) for row in rows if row["reason"]):
        names = [_LABELS.get(row["parameter"], row["parameter"]) for row in rows if row["reason"] == reason]
        console.print(f"{', '.join(names)}: {reason}. To settle it: {remedy}.")
    for warning in result.warnings:
        console.print(f"Warning: {warning}", style="yellow")


def _ladder(result: Factorization) -> str:
    """The models that were tried with their errors; of many those that matter."""
    shown, rest = list(result.candidates), ""
    if len(shown) > _MOST_MODELS:
        shown = sorted(shown, key=lambda candidate: candidate.error)[: _MOST_MODELS - 1]
        rest = f"; the other {len(result.candidates) - len(shown)} are in the report"
    ladder = ", ".join(f"{candidate.estimate.model.name} {candidate.error:.2%}" for candidate in shown)
    return (
        f"Error of {'each model' if not rest else 'the best models'} on unseen photographs: {ladder}{rest}."
    )


_MOST_MODELS = 5
_LABELS = {"kd": "Kd", "ks": "Ks", "spread": "haze / core width", "beyond": "share beyond sigma"}
_LABELS |= {f"beyond_{width}": f"of that, beyond {width} sigma" for width in (2, 4, 8)}
_UNITS = {"kd": " (1/sr)", "sigma": " (rad)"}


def _lines(name: str, quantity: Quantity | None, is_absolute: bool = True) -> list[tuple[str, str]]:
    """Label and text of each number of a parameter."""
    unit = _UNITS.get(name, "") if is_absolute or name != "kd" else ""
    label = _LABELS.get(name, name) + unit
    if quantity is None or quantity.value is None or quantity.std is None:
        return [(label, "-")]
    texts = [with_error(value, std) for value, std in zip(quantity.value, quantity.std, strict=True)]
    if len(texts) == 1:
        return [(label, texts[0])]
    channels = ("red", "green", "blue")
    return [(f"{_LABELS[name]} {channel}{unit}", text) for channel, text in zip(channels, texts, strict=True)]
