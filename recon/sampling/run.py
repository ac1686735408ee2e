"""The command `samples` at work: progress on the terminal, arrays and a figure on disk."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.markup import escape
from rich.table import Table

from capture.decode import decode_photo
from capture.files.documents import input_hashes, software, write_json
from capture.files.outfolder import result_folder
from capture.photo import Photo
from capture.photoset import PhotoSet, load_photoset
from capture.terminal import console, leave_cleanly_when_stopped, track
from recon.lighting import read_lighting
from recon.mesh.bodies import Body, MeshBody
from recon.mesh.transfer import TransferVectors
from recon.mesh.transfercache import cached_transfer
from recon.mesh.trianglemesh import TriangleMesh
from recon.sampling.draw import NO_SOURCES, sample_body
from recon.sampling.figure import PhotoPanel, samples_figure
from recon.sampling.find import FoundBody, find_body
from recon.sampling.lightfield import LightField
from recon.sampling.stream import light_fields

Floats = NDArray[np.float64]

OWN_FILES = ("samples.json", "samples.png", "samples", "transfer.npz")


def run_samples(source: Path, out: Path, budget: int | None, l_max: int, rays: int) -> None:
    """Sample a photo set into a folder and print what was found."""
    leave_cleanly_when_stopped()
    photoset = load_photoset(source)
    for path in _inputs(photoset):
        if not path.is_file():
            raise ValueError(f"{path}: there is no such file; see {photoset.manifest}")
    with result_folder(out, OWN_FILES) as folder:
        found = find_body(photoset, track)
        sources = known_sources(photoset, found.body)
        transfer, warnings = _transfer(photoset, found, l_max, rays)
        rows = []
        (folder / "samples").mkdir()
        streamed = light_fields(photoset, found.body, sources, budget, found.mask_of)
        for photo, overlap in track(
            list(zip(photoset.photos, found.overlaps, strict=True)), "Sampling photographs"
        ):
            field = next(streamed)
            _write_field(folder / "samples" / f"{_stem(photo)}.npz", field)
            rows.append(_summary(photo, field, overlap))
        if not any(row["samples"] for row in rows):
            raise ValueError(
                f"{photoset.manifest}: no pixel of any photograph is usable: not saturated, within the mask, on a"
                " smooth piece of the object; look at the masks and at the object's place"
            )
        sky = None
        if transfer is not None:
            assert isinstance(found.body, MeshBody)
            _write_transfer(folder / "transfer.npz", found.body.mesh, transfer)
            # The part of degree 0 is the cosine-weighted share of the sky, times pi Y_00.
            sky = transfer.coefficients[:, 0] / (np.pi * np.sqrt(1 / (4 * np.pi)))
        _draw(folder / "samples.png", photoset, found, sources, rows, sky)
        document = {
            "format": 1,
            "name": photoset.name,
            "photos": rows,
            "transfer": None
            if transfer is None
            else {"l_max": l_max, "rays": rays, "std_rms": float(np.sqrt(np.mean(transfer.std**2)))},
            "warnings": warnings,
            "inputs": input_hashes(_inputs(photoset)),
            "software": software(),
        }
        write_json(folder / "samples.json", document)
    _report(photoset, rows, warnings, out)


def _transfer(
    photoset: PhotoSet, found: FoundBody, l_max: int, rays: int
) -> tuple[TransferVectors | None, list[str]]:
    """Transfer vectors of a mesh in the world's axes, and all warnings so far; a sphere shadows nothing of itself."""
    warnings = list(found.warnings)
    if found.mesh is None:
        return None, warnings
    assert photoset.object.mesh is not None
    assert photoset.mesh_to_world is not None
    with console.status("Looking for shadows of the sky"):
        mesh_file = photoset.resolve(photoset.object.mesh)
        transfer, warning = cached_transfer(found.mesh, mesh_file, l_max, rays)
    return transfer.rotated(photoset.mesh_to_world[:3, :3]), warnings + ([warning] if warning else [])


def _inputs(photoset: PhotoSet) -> list[Path]:
    mesh = [photoset.resolve(photoset.object.mesh)] if photoset.object.mesh else []
    photos = [path for photo in photoset.photos for path in (photo.file, photo.mask) if path is not None]
    return [photoset.manifest, *photoset.calibration_files, *mesh, *photos]


def known_sources(photoset: PhotoSet, body: Body) -> dict[str, Floats]:
    """The known sources of each lighting, (k, 3) or (k, 4); none where it is to be recovered."""
    return {
        table.name: NO_SOURCES if table.unknown else read_lighting(photoset, table, body).sources
        for table in photoset.lightings
    }


def _write_field(path: Path, field: LightField) -> None:
    arrays = {entry.name: getattr(field, entry.name) for entry in fields(field)}
    np.savez(path, **{name: values for name, values in arrays.items() if values is not None})


def _write_transfer(path: Path, mesh: TriangleMesh, transfer: TransferVectors) -> None:
    np.savez(
        path,
        vertices=mesh.vertices,
        faces=mesh.faces,
        normals=mesh.normals,
        coefficients=transfer.coefficients,
        std=transfer.std,
    )


def _summary(photo: Photo, field: LightField, overlap: float | None) -> dict[str, Any]:
    lit = field.mean_over_rays(field.sources_visible.astype(float)) if len(field) else field.sources_visible
    return {
        "file": photo.name,
        "samples": len(field),
        "mean_weight": float(field.weight.mean()) if len(field) else None,
        "mask_overlap": overlap,
        "mirrored_rays_free": float(field.reflected_visible.mean()) if len(field) else None,
        "sources_seen": lit.mean(axis=0).tolist() if len(field) else None,
    }


def _draw(
    path: Path,
    photoset: PhotoSet,
    found: FoundBody,
    sources: Mapping[str, Floats],
    rows: Sequence[Mapping[str, Any]],
    sky: NDArray[np.floating] | None,
) -> None:
    """The figure of the photograph that has the median number of samples."""
    counts = [row["samples"] for row in rows]
    index = int(np.argsort(counts, kind="stable")[len(counts) // 2])
    photo = photoset.photos[index]
    image, lights = decode_photo(photoset.radiometry, photo), sources[photo.lighting]
    whole = np.random.default_rng(0)  # asked for nothing where every pixel is taken
    field = sample_body(found.body, photo.camera, image, found.mask_of(photo), lights, None, whole)
    panel = PhotoPanel(photo.label, photo.camera, image, field, lights, sky)
    faces = found.body.mesh.faces if isinstance(found.body, MeshBody) else None
    samples_figure(panel, found.body, faces).savefig(path)


def _stem(photo: Photo) -> str:
    return photo.label.replace("/", "_").rsplit(".", 1)[0]


def _report(
    photoset: PhotoSet, rows: Sequence[Mapping[str, Any]], warnings: Sequence[str], out: Path
) -> None:
    table = Table("photo", "samples", "mean weight", "mask overlap", "mirrored rays free", "sources seen")
    for photo, row in zip(photoset.photos, rows, strict=True):
        seen = row["sources_seen"]
        table.add_row(
            escape(photo.label),
            str(row["samples"]),
            _share(row["mean_weight"], 2),
            _share(row["mask_overlap"], 3),
            _share(row["mirrored_rays_free"], 3),
            "" if not seen else " ".join(f"{share:.2f}" for share in seen),
        )
    console.print(table)
    for warning in warnings:
        console.print(f"Warning: {escape(warning)}.", soft_wrap=True)
    console.print(
        f"{sum(row['samples'] for row in rows)} samples. Look at {out / 'samples.png'}", soft_wrap=True
    )


def _share(value: float | None, digits: int) -> str:
    return "" if value is None else f"{value:.{digits}f}"
