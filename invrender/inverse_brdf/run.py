"""The command `brdf` at work: progress and tables on the terminal, brdf.json and brdf.png on disk."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from capture.decode import decode_photo
from capture.files.documents import input_hashes, write_json
from capture.files.outfolder import result_folder
from capture.parallel import one_blas_thread
from capture.photo import Photo
from capture.photoset import PhotoSet, load_photoset
from capture.radiance import CHANNELS
from capture.tasks.workplace import opened_workplace
from capture.terminal import console, leave_cleanly_when_stopped, track
from invrender.brdf.form import Axis
from invrender.inverse_brdf.brushed_harmonics import BrushedBasis
from invrender.inverse_brdf.document import (
    FIT_PARTS,
    brushed_document,
    document,
    harmonic_document,
    table_document,
)
from invrender.inverse_brdf.figure import brushed_figure, harmonic_figure, table_figure
from invrender.inverse_brdf.harmonic import FURTHER, HarmonicBRDF, estimate_harmonic
from invrender.inverse_brdf.near import Measured, measure_under
from invrender.inverse_brdf.observe import Observations, light_coefficients, observe, single_source
from invrender.inverse_brdf.reciprocal import unknowns
from invrender.inverse_brdf.rendering import Rendering
from invrender.inverse_brdf.slices import ringing
from invrender.observation.geometry import brushing_axis
from invrender.wording import with_error
from recon.harmonics.complex import project_sources
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]

OWN_FILES = ("brdf.json", "brdf.png")
# Pixels of all photographs together, where nobody says how many; a table takes all, its highlight being small.
SAMPLES = {"harmonic": 60_000, "table": None}
# Coefficients of degrees up to this are printed.
_PRINTED_DEGREE = 2
# Chi-square per degree of freedom from which on a misfit is no noise.
_MISFIT = 4.0


def run_brdf(
    source: Path,
    out: Path,
    method: Literal["harmonic", "table"],
    order: int,
    samples: int | None,
    anisotropic: bool = False,
    fresh: bool = False,
) -> HarmonicBRDF | Measured:
    """Measure a set's BRDF into a folder, and print what was found.

    anisotropic : whether harmonics are those of a brushed sphere. fresh : as of `opened_workplace`.
    """
    leave_cleanly_when_stopped()
    photoset = load_photoset(source)
    workplace = opened_workplace(photoset.manifest, fresh=fresh)
    with one_blas_thread(), result_folder(out, OWN_FILES) as folder, workplace:
        seen = observe(photoset, samples, track)
        if method == "table":
            result: HarmonicBRDF | Measured = _table(seen, folder)
        else:
            result = _harmonic(seen, folder, order, brushing_axis(photoset) if anisotropic else None)
    for warning in seen.warnings:
        console.print(f"Warning: {warning}.", soft_wrap=True, markup=False)
    places = f"Result: {out / 'brdf.json'}   Look at it: {out / 'brdf.png'}"
    console.print(places, soft_wrap=True, markup=False)
    return result


def _harmonic(seen: Observations, folder: Path, order: int, axis: Axis | None) -> HarmonicBRDF:
    lights = {name: light_coefficients(light, order + FURTHER) for name, light in seen.lightings.items()}
    with console.status("Solving for the coefficients"):
        brdf = estimate_harmonic(
            [field for _, field in seen.fitted],
            [lights[photo.lighting] for photo, _ in seen.fitted],
            order,
            axis,
        )
    photos = []
    unseen = np.zeros(2)
    for photo, field in zip(seen.photoset.photos, seen.fields, strict=True):
        predicted = field.mean_over_rays(brdf.radiance(lights[photo.lighting], field.normals, field.views))
        left = float(field.weight @ ((field.radiance - predicted) ** 2).sum(axis=1))
        energy = float(field.weight @ (field.radiance**2).sum(axis=1))
        rms = np.sqrt(left / energy) if energy > 0 else None
        photos.append(_photo(photo, field) | {"relative_rms": rms})
        unseen += photo.held_out * np.array([left, energy])
    name, pictures = seen.photoset.name, _pictures(seen, brdf)
    if isinstance(brdf.basis, BrushedBasis):
        measured = brushed_document(brdf, brdf.basis)
        brushed_figure(name, brdf, pictures).savefig(folder / "brdf.png")
        _print_determined(brdf)
    else:
        rings = ringing(brdf)
        measured = harmonic_document(brdf, rings)
        harmonic_figure(name, brdf, pictures).savefig(folder / "brdf.png")
        _print_harmonic(seen.photoset, brdf)
        _print_determined(
            brdf,
            f" {rings.negative_share:.1%} of the BRDF is negative, down to {rings.depth:.1%} of its peak: ringing,"
            " since higher degrees are missing.",
        )
    write_json(folder / "brdf.json", _document(seen, measured, photos))
    if unseen[1] > 0:
        # Together: a photo of the dark side has hardly any radiance of its own.
        console.print(f"RMS residual of held-out photos: {np.sqrt(unseen[0] / unseen[1]):.2%}.")
    return brdf


def _table(seen: Observations, folder: Path) -> Measured:
    sources = [single_source(seen.photoset, seen.lightings[photo.lighting]) for photo, _ in seen.fitted]
    with console.status("Gathering the table"):
        found = measure_under([field for _, field in seen.fitted], sources, seen.centre)
    photos = [_photo(photo, field) for photo, field in zip(seen.photoset.photos, seen.fields, strict=True)]
    write_json(folder / "brdf.json", _document(seen, table_document(found), photos))
    table_figure(seen.photoset.name, found.table, found.fit).savefig(folder / "brdf.png")
    _print_table(seen.photoset, found)
    return found


def _pictures(seen: Observations, brdf: HarmonicBRDF) -> dict[str, NDArray[np.floating]]:
    """The photograph in the middle, as the BRDF predicts it, and under a source at the viewpoint instead."""
    photo, _ = seen.fitted[len(seen.fitted) // 2]
    rendering = Rendering.of(seen, photo)
    own = light_coefficients(seen.lightings[photo.lighting], brdf.order)
    flash = project_sources(rendering.towards[None], np.ones((1, 3)), brdf.order)
    return {
        "photograph": rendering.cut(decode_photo(seen.photoset.radiometry, photo).radiance),
        f"rendered, order {brdf.order}, same light": rendering.of_brdf(brdf, own),
        f"order {brdf.order}, source at the viewpoint": rendering.of_brdf(brdf, flash),
    }


def _document(
    seen: Observations, measured: dict[str, Any], photos: Sequence[dict[str, Any]]
) -> dict[str, Any]:
    photoset = seen.photoset
    files = [path for photo in photoset.photos for path in (photo.file, photo.mask) if path is not None]
    maps = [photoset.resolve(table.map) for table in photoset.lightings if table.map]
    inputs = input_hashes([photoset.manifest, *photoset.calibration_files, *maps, *files])
    return document(photoset.name, measured, photos, seen.warnings, inputs)


def _photo(photo: Photo, field: LightField) -> dict[str, Any]:
    return {"file": photo.name, "samples": len(field), "held_out": photo.held_out}


def _print_harmonic(photoset: PhotoSet, brdf: HarmonicBRDF) -> None:
    shown = Table("l", "p", "q", *CHANNELS, title=f"{photoset.name}: rho_lpq", title_justify="left")
    for index, (l, p, q) in enumerate(zip(*unknowns(brdf.order), strict=True)):
        if p <= _PRINTED_DEGREE:
            numbers = [
                with_error(float(value), float(std)) if known else "undetermined"
                for value, std, known in zip(
                    brdf.coefficients[index], brdf.std[index], brdf.determined[index], strict=True
                )
            ]
            shown.add_row(str(l), str(p), str(q), *numbers)
    console.print(shown)


def _print_determined(brdf: HarmonicBRDF, more: str = "") -> None:
    """How much of the coefficients is known, and what stands in the way of the rest."""
    whole = np.all(brdf.determined, axis=1)
    console.print(
        f"{int(whole.sum())} of {len(whole)} coefficients up to degree {brdf.order} determined; RMS residual"
        f" {brdf.residual:.2%} of the radiance.{more}",
        soft_wrap=True,
    )
    for reason, count in Counter(reason for reason in brdf.reasons if reason).most_common(3):
        console.print(f"{count} undetermined: {reason}.", soft_wrap=True)


def _print_table(photoset: PhotoSet, found: Measured) -> None:
    table, fit = found.table, found.fit
    shown = Table(
        "parameter", "value ± std", title=f"{photoset.name}: fit to the table", title_justify="left"
    )
    units = {"kd": "Kd (1/sr)", "ks": "Ks", "mu": "mu", "sigma": "sigma (rad)"}
    for name, part in FIT_PARTS.items():
        labels = (
            [f"{units[name]} {channel}" for channel in CHANNELS] if name in ("kd", "ks") else [units[name]]
        )
        for label, value, std in zip(labels, fit.parameters[part], fit.std[part], strict=True):
            shown.add_row(label, with_error(float(value), float(std)))
    console.print(shown)
    console.print(
        f"{int(table.counts.sum())} samples in {int(table.measured.sum())} bins:"
        f" {table.coverage(table.measured):.1%} of those above the surface,"
        f" {table.coverage(table.filled):.1%} with light and viewer exchanged. RMS misfit of the parametric model"
        f" {fit.misfit:.2%}.",
        soft_wrap=True,
    )
    outliers = f"misses by {np.sqrt(fit.chi2):.1f} times as far as its values scatter"
    if found.distance is not None:
        console.print(
            f"The source is {with_error(*found.distance)} m from the object's centre, as its light turns and falls off"
            f" across the object: so the table is measured. Under a source that is far the fit would miss"
            f" {np.sqrt(found.far_chi2):.1f} times as far as the table's values scatter.",
            soft_wrap=True,
        )
    if fit.chi2 > _MISFIT:
        console.print(
            f"The model {outliers}, the width of bins and how near the source is taken into account: the material has"
            " another lobe, or a pose, a mask or the light's direction is wrong.",
            soft_wrap=True,
        )
