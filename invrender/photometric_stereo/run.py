"""`process` of sets whose shape is normals: progress and a table on the terminal, maps and a figure on disk."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from capture.files.documents import write_json
from capture.files.imagefile import write_exr
from capture.files.outfolder import claimed, result_folder
from capture.photoset import PhotoSet
from capture.progress import Track, silent
from capture.terminal import console, leave_cleanly_when_stopped, track
from invrender.output.report.files import photo_file_names, photoset_hashes
from invrender.photometric_stereo.bounces import CONCAVE_FROM, bounced_light
from invrender.photometric_stereo.capture import StereoCapture, read_capture
from invrender.photometric_stereo.document import shared_quantities, stereo_document
from invrender.photometric_stereo.figure import stereo_figure
from invrender.photometric_stereo.solve import SolvedSurface, solve_stereo
from invrender.photometric_stereo.stack import PixelStack, Surface
from recon.normals.integration import integrate
from recon.normals.normalmap import NormalMap, write_normal_map

Floats = NDArray[np.float64]
STEREO_FILES = ("result.json", "normals.*", "albedo.exr", "depth.exr", "stereo.png", "predicted")


@dataclass(frozen=True, eq=False)
class StereoResult:
    """A set whose normals and albedo are solved. depths : (h, w) metres along the camera's axis, NaN outside."""

    capture: StereoCapture
    solved: SolvedSurface
    depths: Floats

    @property
    def normal_map(self) -> NormalMap:
        """Normals in the picture's axes with standard deviations; without these where the normals were given."""
        sought = self.capture.normals is None
        std_deg = self.as_picture(self.solved.deviations.normal_deg) if sought else None
        return NormalMap(self.as_picture(self.solved.surface.normals), std_deg)

    def as_picture(self, values: Floats) -> Floats:
        """Values of pixels (p, ...) as a picture (h, w, ...), NaN outside."""
        picture = np.full((*self.capture.inside.shape, *values.shape[1:]), np.nan)
        picture[self.capture.inside] = values
        return picture

    def predicted(self, photo: int) -> tuple[Floats, Floats]:
        """Radiance (p, 3) that one of the set's photographs should have, and its error, relative RMS of usable pixels."""
        places = np.array([photo])
        stack = self.capture.stack(places, self.depths)
        if self.solved.stack.bounced is not None:
            bounced, _ = bounced_light(self.solved.surface, stack, self.capture.camera, self.depths)
            stack = replace(stack, bounced=bounced)
        shown = self.solved.reflection.predicted(self.solved.surface, stack)
        shown = (shown * self.capture.irradiances(places, self.depths))[:, 0]
        usable, seen = self.capture.usable[:, photo], self.capture.radiance[:, photo].astype(float)
        off = np.sqrt(((shown - seen)[usable] ** 2).mean() / max((seen[usable] ** 2).mean(), 1e-300))
        return shown, off


def photometric_stereo(photoset: PhotoSet, track: Track = silent) -> StereoResult:
    """Normals, albedo and the shared lobe of a set whose [object] shape is "normals"; ValueError says what it lacks."""
    capture = read_capture(photoset, track)
    fitted = capture.places(held_out=False)
    plane = capture.stack(fitted, capture.plane())
    near = len(plane.lamps) > 1

    def depths_of(surface: Surface) -> Floats:
        normals = np.full((*capture.inside.shape, 3), np.nan)
        normals[capture.inside] = surface.normals
        return integrate(NormalMap(normals), capture.camera, capture.depth)

    def surroundings(surface: Surface) -> PixelStack | None:
        depths = depths_of(surface)
        stack = capture.stack(fitted, depths) if near else plane
        bounced, share = bounced_light(surface, stack, capture.camera, depths)
        if share > CONCAVE_FROM:
            return replace(stack, bounced=bounced)
        return stack if near else None

    solved = solve_stereo(plane, capture.inside, surroundings, capture.normals, track)
    return StereoResult(capture, solved, depths_of(solved.surface))


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
    (folder / "predicted").mkdir()
    names = photo_file_names([photo.name for photo in result.capture.photoset.photos])
    errors = []
    for place, photo in enumerate(track(result.capture.photoset.photos, "Predicting photographs")):
        predicted, error = result.predicted(place)
        write_exr(folder / "predicted" / names[photo.name], np.nan_to_num(result.as_picture(predicted)), half=True)
        errors.append(float(error))
    return errors


def _print_summary(result: StereoResult, errors: list[float]) -> None:
    table = Table("quantity", "value ± std", title=result.solved.model.name, title_justify="left")
    for name, quantity in shared_quantities(result.solved).items():
        table.add_row(name, quantity.text)
    if result.capture.normals is None:
        bars = result.solved.deviations.normal_deg
        table.add_row("normals, error bars (deg)", f"median {np.median(bars):.2g}, 95% below {np.quantile(bars, 0.95):.2g}")
    console.print(table)
    photos = result.capture.photoset.photos
    for held_out, what in ((False, "fitted"), (True, "held-out")):
        own = [error for photo, error in zip(photos, errors, strict=True) if photo.held_out == held_out]
        if own:
            console.print(f"Error on {len(own)} {what} photographs: {np.mean(own):.1%} (RMS, relative).")
    for warning in result.capture.warnings:
        console.print(f"Warning: {warning}", soft_wrap=True)
