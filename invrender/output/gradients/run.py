"""The command `gradients` at work: files per photograph, a table on the terminal."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.markup import escape
from rich.table import Table

from capture.files.documents import write_json
from capture.files.imagefile import write_exr
from capture.files.outfolder import result_folder
from capture.photoset import MANIFEST_NAME, load_photoset
from capture.terminal import console, leave_cleanly_when_stopped, track
from invrender.output.gradients.document import TERMS, gradients_document, named_terms, photo_entry
from invrender.output.gradients.figure import gradients_figure
from invrender.output.gradients.photograph import PhotoGradients, photo_gradients
from invrender.output.render.light import light_element
from invrender.output.render.photographer import photographer
from invrender.output.render.run import parse_assumed
from invrender.output.report.files import photo_file_names
from invrender.output.report.run import run_process
from invrender.result.saved import RESULT_NAME, SavedPhoto, SavedResult, nearest, read_result

OWN_FILES = ("gradients.json", "*.exr", "*.png")
# Share of pixels without curvature from which a mesh is said to have flat facets.
_FLAT = 0.5
_FLAT_FACETS = (
    "The mesh has flat facets: at {share:.0%} of the pixels the normal doesn't turn. It says nothing of curvature"
    " there, so facets are taken as they are: no curvature term, and any lamp at a place counts as near."
)
_BOUNCED = "Light that parts of the object send each other is in no term."


@dataclass(frozen=True)
class GradientsOptions:
    """What the command line says, unread: see `lightfactor gradients --help`."""

    source: Path
    out: Path
    photos: tuple[str, ...]
    photoset: Path | None
    pixels: int
    assume: tuple[str, ...]


def run_gradients(options: GradientsOptions) -> None:
    """Split the gradients of a result's predicted photographs into a result folder; a photo set is processed first."""
    leave_cleanly_when_stopped()
    assumed = parse_assumed(options.assume)
    source, out, photoset = options.source, options.out, options.photoset
    if _is_photoset(source):
        if photoset is not None:
            raise ValueError(
                f"--set names the photo set of a result, and {source} is a photo set; leave it out"
            )
        # What is mistyped is said before minutes of work.
        labels = [photo.label for photo in load_photoset(source).photos]
        _check_photos(options.photos, labels, source)
        source, out, photoset = out / "result", out / "gradients", source
        run_process(photoset, source)
    result = read_result(source)
    photos = _chosen(result, options.photos)
    with result_folder(out, OWN_FILES) as folder:
        entries, warnings, seen = _write_photos(folder, result, photos, photoset, assumed, options.pixels)
        inputs = [result.path] if seen is None else [result.path, seen]
        write_json(folder / "gradients.json", gradients_document(result.path, entries, warnings, inputs))
    _report(result, entries, warnings, out)


def _is_photoset(source: Path) -> bool:
    if source.is_dir():
        return (source / MANIFEST_NAME).is_file() and not (source / RESULT_NAME).is_file()
    return source.suffix == ".toml"


def _chosen(result: SavedResult, names: Sequence[str]) -> list[SavedPhoto]:
    """The result's photographs of given names, all if none are given."""
    known = {photo.file: photo for photo in result.content.photos}
    if not known:
        raise ValueError(f"{result.path}: holds no photographs, and gradients are those of photographs")
    _check_photos(names, known, result.path)
    return [known[name] for name in dict.fromkeys(names)] or list(known.values())


def _check_photos(names: Sequence[str], known: Collection[str], where: Path) -> None:
    for name in names:
        if name not in known:
            raise ValueError(f"--photo {name}: {where} has no such photograph; {nearest(name, known)}")


def _write_photos(
    folder: Path,
    result: SavedResult,
    photos: Sequence[SavedPhoto],
    photoset: Path | None,
    assumed: Mapping[str, float],
    pixels: int,
) -> tuple[list[dict[str, Any]], list[str], Path | None]:
    """Write the files of photographs; what gradients.json says of each, warnings, and the set's manifest."""
    lightings = {name: result.read_lighting(result.lighting(name)) for name in {p.lighting for p in photos}}
    studio = photographer(result, lightings[photos[0].lighting], photoset, assumed)
    names = photo_file_names([photo.file for photo in result.content.photos])
    entries, flat = [], []
    for photo in track(photos, "Splitting gradients"):
        lighting = lightings[photo.lighting]
        found = photo_gradients(
            studio.subject, studio.photo_camera(photo.file), studio.material, light_element(lighting), pixels
        )
        picture = names[photo.file]
        files = [picture, str(Path(picture).with_suffix(".png"))]
        _write_picture(folder / files[0], found)
        gradients_figure(photo.file, found).savefig(folder / files[1])
        entries.append(photo_entry(photo.file, lighting.name, found, files))
        flat.append(float((found.curvature == 0).mean()))
    warnings = [*studio.material.notes, *studio.subject.warnings]
    if studio.subject.turns_visibly and np.mean(flat) > _FLAT:
        warnings.append(_FLAT_FACETS.format(share=np.mean(flat)))
    if result.bounces and studio.subject.shadows is not None:
        warnings.append(_BOUNCED)
    return entries, warnings, None if studio.photoset is None else studio.photoset.manifest


def _write_picture(path: Path, found: PhotoGradients) -> None:
    """An EXR: R, G, B the predicted radiance; layers TERM-x and TERM-y of each term, and near, 1 / d over 2 k."""
    layers = {
        f"{name}-{way}": found.picture(values[:, k])
        for name, values in named_terms(found).items()
        for k, way in enumerate("xy")
    }
    layers["near"] = found.picture(found.nearness)
    write_exr(path, found.picture(found.terms.radiance), layers=layers)


def _report(
    result: SavedResult, entries: Sequence[Mapping[str, Any]], warnings: Sequence[str], out: Path
) -> None:
    many = len(entries) > 1
    table = Table(
        title=escape(f"{result.content.name}: what makes the gradients"),
        title_justify="left",
    )
    for heading in ("term", f"mean of {len(entries)}", "most", "in") if many else ("term", "share"):
        table.add_column(heading, justify="left" if heading in ("term", "in") else "right")
    for name in TERMS:
        shares = {entry["file"]: entry["terms"][name]["share"] or 0.0 for entry in entries}
        if any(shares.values()):
            most = max(shares, key=lambda file: shares[file])
            cells = [f"{np.mean(list(shares.values())):.1%}", f"{shares[most]:.1%}", escape(most)]
            table.add_row(name, *(cells if many else cells[:1]))
    console.print(table)
    console.print("Shares of the squared difference across a pixel; they add up to 100%.")
    for line in (_strength(entries), _nearness(entries)):
        console.print(line, soft_wrap=True)
    for warning in warnings:
        console.print(f"Note: {escape(warning)}", style="yellow", soft_wrap=True)
    look = out / entries[0]["files"][1]
    console.print(f"Gradients: {out / 'gradients.json'}   Look at it: {look}", soft_wrap=True)


def _strength(entries: Sequence[Mapping[str, Any]]) -> str:
    strengths = [entry["rms_gradient"] / entry["rms_radiance"] for entry in entries if entry["rms_radiance"]]
    if not strengths:
        return "No light reaches what the cameras see."
    return f"From pixel to pixel the radiance differs by {np.mean(strengths):.1%} (RMS over RMS radiance)."


def _nearness(entries: Sequence[Mapping[str, Any]]) -> str:
    shares = [entry["near"]["share"] for entry in entries]
    if any(shares):
        return f"Light counts as near at {np.mean(shares):.0%} of the pixels."
    distances = [entry["near"]["near_below_m"]["median"] for entry in entries]
    if not all(distances):
        return "Light is far away; on what is flat any lamp at a place would count as near."
    return f"Light is far away; a lamp nearer than {np.mean(distances):.4g} m (median pixel) would count as near."
