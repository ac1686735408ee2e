"""`process` of sets whose shape is normals: progress and a table on the terminal, maps and a figure on disk."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rich.table import Table

from capture.files.documents import write_json
from capture.files.imagefile import write_exr
from capture.files.outfolder import claimed, result_folder
from capture.photoset import PhotoSet
from capture.terminal import console, leave_cleanly_when_stopped, track
from invrender.output.report.files import photo_file_names, photoset_hashes
from invrender.photometric_stereo.document import shared_quantities, stereo_document
from invrender.photometric_stereo.figure import stereo_figure
from invrender.photometric_stereo.ptm import FEWEST_PHOTOS, polynomial_texture, write_ptm
from invrender.photometric_stereo.result import StereoResult, odd_photographs, photometric_stereo
from recon.normals.normalmap import write_normal_map

# What tables call the shared numbers, where not by their names.
_LABELS = {
    "ambient": "light from the room, of the lamp's",
    "bounce": "light from the object, of one bounce",
    "sigma": "sigma (rad)",
}
STEREO_FILES = (
    "result.json",
    "normals.*",
    "albedo.exr",
    "depth.exr",
    "relight.ptm",
    "stereo.png",
    "predicted",
)


def run_stereo(photoset: PhotoSet, out: Path) -> StereoResult:
    """Solve a set into a result folder and print what was found."""
    leave_cleanly_when_stopped()
    with claimed(out):
        inputs = photoset_hashes(photoset)
        result = photometric_stereo(photoset, track)
        with result_folder(out, STEREO_FILES) as folder:
            errors = _write_maps(folder, result)
            write_json(folder / "result.json", stereo_document(result, errors, inputs))
            stereo_figure(result, errors).savefig(folder / "stereo.png", dpi=120)
    _print_summary(result, errors)
    console.print(f"Results: {out / 'result.json'}   Look at it: {out / 'stereo.png'}", soft_wrap=True)
    return result


def _write_maps(folder: Path, result: StereoResult) -> list[float]:
    """Write everything but numbers and figure; the errors of the set's photographs, in their order."""
    write_normal_map(folder, result.normal_map)
    albedo = np.nan_to_num(result.as_picture(np.pi * result.solved.surface.kd))
    std = np.nan_to_num(result.as_picture(np.pi * result.solved.deviations.kd))
    write_exr(folder / "albedo.exr", albedo, layers={"std": std})
    depths = np.nan_to_num(result.depths)
    write_exr(folder / "depth.exr", np.repeat(depths[..., None], 3, axis=2))
    if result.solved.stack.photos >= FEWEST_PHOTOS:
        write_ptm(folder / "relight.ptm", polynomial_texture(result.solved.stack), result.capture.inside)
    (folder / "predicted").mkdir()
    names = photo_file_names([photo.name for photo in result.capture.photoset.photos])
    errors = []
    for place, photo in enumerate(track(result.capture.photoset.photos, "Predicting photographs")):
        predicted, error = result.predicted(place)
        write_exr(
            folder / "predicted" / names[photo.name], np.nan_to_num(result.as_picture(predicted)), half=True
        )
        errors.append(float(error))
    return errors


def _print_summary(result: StereoResult, errors: list[float]) -> None:
    table = Table("quantity", "value ± std", title=result.solved.model.name, title_justify="left")
    for name, quantity in shared_quantities(result.solved).items():
        table.add_row(_LABELS.get(name, name), quantity.text)
    if result.capture.normals is None:
        bars = result.solved.deviations.normal_deg
        table.add_row(
            "normals, error bars (deg)",
            f"median {np.median(bars):.2g}, 95% below {np.quantile(bars, 0.95):.2g}",
        )
    console.print(table)
    photos = result.capture.photoset.photos
    for held_out, what in ((False, "fitted"), (True, "held-out")):
        own = [error for photo, error in zip(photos, errors, strict=True) if photo.held_out == held_out]
        if own:
            console.print(f"Error on {len(own)} {what} photographs: {np.mean(own):.1%} (RMS, relative).")
    for warning in (*result.capture.warnings, *odd_photographs(photos, errors)):
        console.print(f"Warning: {warning}", soft_wrap=True)
