"""The files of a result folder: numbers first, then predicted photographs and the report. No terminal."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from capture.files.documents import file_hash, write_json
from capture.files.imagefile import write_exr
from capture.parallel import one_blas_thread, parallel_map
from capture.photo import Photo
from capture.photoset import PhotoSet
from capture.progress import Track, silent
from capture.tasks.stage import stage_results
from invrender.estimate.textured.textures import TEXTURE_FILES
from invrender.output.report.page import write_report
from invrender.output.report.photos import PhotoReport, Reporting, pictured, worst
from invrender.result.document import lighting_map, result_document, with_picture_errors
from invrender.result.run import Run

RESULT_FILES = ("result.json", "report.html", "predicted", "lighting*.exr", *TEXTURE_FILES)
PICTURES = "predicted photographs and report"


def write_fit(
    run: Run,
    folder: Path,
    more: Mapping[str, Any] | None = None,
    inputs: Mapping[str, str] | None = None,
) -> dict[str, Any]:
    """Write everything that a run found into a folder, but for its pictures; what stands in result.json.

    more : further keys of it. inputs : the set's `photoset_hashes`, where they are known.
    """
    files = {}
    several = len(run.solution.lightings) > 1
    for entry in run.solution.lightings:
        name = entry.lighting.name
        files[name] = f"lighting-{name.replace('/', '_')}.exr" if several else "lighting.exr"
        write_exr(folder / files[name], lighting_map(entry))
    if run.textures is not None:
        assert run.photoset.mesh_to_world is not None
        run.textures.write(folder, run.photoset.mesh_to_world)
    document = result_document(run, files, photoset_hashes(run.photoset) if inputs is None else inputs)
    document |= {"predicted_binning": None, **(more or {})}
    write_json(folder / "result.json", document)
    return document


def write_pictures(
    run: Run,
    folder: Path,
    document: Mapping[str, Any],
    track: Track = silent,
    key: str = "",
) -> dict[str, Any]:
    """Write a run's predicted photographs, its report, and its result.json with the errors of these, which is
    returned.

    key : of all that the run was made of, by which pictures are kept where a workplace is open.
    """
    (folder / "predicted").mkdir()
    reporting, photos = Reporting.of(run), run.photoset.photos
    names = photo_file_names([photo.label for photo in photos])
    chosen = pictured(photos)
    reports: list[PhotoReport] = []
    made = _reports(reporting, [(photo, photo.label in chosen) for photo in photos], key)
    for photo in track(photos, "Predicting photographs"):
        report = next(made)
        (folder / "predicted" / names[photo.label]).write_bytes(report.predicted)
        # All of them together may be larger than memory.
        reports.append(replace(report, predicted=b""))
    poor = worst(reports)
    again = _reports(reporting, [(photo, True) for photo in photos if photo.label in poor], key)
    pictures = {report.label: report.pictures for report in again}
    reports = [replace(each, pictures=pictures.get(each.label, each.pictures)) for each in reports]
    errors = {report.label: report.error for report in reports}
    complete = {**with_picture_errors(document, errors), "predicted_binning": run.binning}
    write_report(folder / "report.html", run, complete, reports, reporting.limit)
    write_json(folder / "result.json", complete)
    return complete


def pictures_stage(key: str) -> str:
    """What the pictures of a run are kept as, by its key."""
    return f"pictures-{key[:8]}"


def _reports(reporting: Reporting, items: Sequence[tuple[Photo, bool]], key: str) -> Iterator[PhotoReport]:
    # Of all threads together: one that ends would take the limit off the others.
    with one_blas_thread():
        yield from stage_results(pictures_stage(key), reporting, items, lambda item: str(item[0].file), key)


def photo_file_names(labels: Sequence[str]) -> dict[str, str]:
    """A file name for each photograph's prediction: its own with .exr for its suffix, or after it where two agree."""
    flat = {label: label.replace("/", "_") for label in labels}
    short = {label: Path(name).with_suffix(".exr").name for label, name in flat.items()}
    shared = Counter(short.values())
    return {label: short[label] if shared[short[label]] == 1 else f"{flat[label]}.exr" for label in labels}


def photoset_hashes(photoset: PhotoSet) -> dict[str, str]:
    """Hashes of every file that the result depends on, by its place in the set's folder, or its name elsewhere."""
    hashes: dict[str, str] = {}
    files = photoset.files
    for path, content in zip(files, parallel_map(file_hash, files), strict=True):
        inside = path.is_relative_to(photoset.folder)
        name = str(path.relative_to(photoset.folder)) if inside else path.name
        hashes[name if name not in hashes else str(path)] = content
    return hashes
