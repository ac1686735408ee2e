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
from capture.photoset import Photo, PhotoSet, load_photoset
from capture.terminal import console, leave_cleanly_when_stopped, track
from recon.knownlight import read_lighting
from recon.lightfield import LightField
from recon.samples.figure import Panel, samples_figure
from recon.samples.find import FoundMesh, find_mesh
from recon.samples.stream import light_fields
from recon.sampling import NO_SOURCES
from recon.transfer import TransferVectors
from recon.transfercache import cached_transfer

Floats = NDArray[np.float64]

OWN_FILES = ("samples.json", "samples.png", "samples", "transfer.npz")


def run_samples(source: Path, out: Path, budget: int | None, l_max: int, rays: int) -> None:
    """Sample a photo set into a folder and print what was found."""
    leave_cleanly_when_stopped()
    photoset = load_photoset(source)
    with result_folder(out, OWN_FILES) as folder:
        found = find_mesh(photoset, track)
        sources = known_sources(photoset)
        assert photoset.object.mesh is not None
        mesh_file = photoset.resolve(photoset.object.mesh)
        with console.status("Looking for shadows of the sky"):
            transfer, warning = cached_transfer(found.mesh, mesh_file, l_max, rays)
        assert photoset.mesh_to_world is not None
        transfer = transfer.rotated(photoset.mesh_to_world[:3, :3])
        rows = []
        (folder / "samples").mkdir()
        streamed = light_fields(photoset, found.body, sources, budget)
        for photo, overlap in track(
            list(zip(photoset.photos, found.placement.overlaps, strict=True)), "Sampling photographs"
        ):
            field = next(streamed)
            _write_field(folder / "samples" / f"{_stem(photo)}.npz", field)
            rows.append(_summary(photo, field, overlap))
        if not any(row["samples"] for row in rows):
            raise ValueError(
                f"{photoset.manifest}: no pixel of any photograph is usable: not saturated, within the mask, on a"
                " smooth piece of the mesh; look at the masks and at the mesh's place"
            )
        warnings = [*found.warnings, *([warning] if warning else [])]
        _write_transfer(folder / "transfer.npz", found, transfer)
        _draw(folder / "samples.png", photoset, found, sources, rows, transfer)
        inputs = [mesh_file, photoset.manifest, *photoset.calibration_files]
        inputs += [path for photo in photoset.photos for path in (photo.file, photo.mask) if path is not None]
        document = {
            "format": 1,
            "name": photoset.name,
            "photos": rows,
            "transfer": {
                "l_max": transfer.l_max,
                "rays": rays,
                "std_rms": float(np.sqrt(np.mean(transfer.std**2))),
            },
            "warnings": warnings,
        }
        write_json(
            folder / "samples.json", document | {"inputs": input_hashes(inputs), "software": software()}
        )
    _report(photoset, rows, warnings, out)


def known_sources(photoset: PhotoSet) -> dict[str, Floats]:
    """Directions (k, 3) of the known sources of each lighting; none where it is to be recovered."""
    known = {
        table.name: NO_SOURCES if table.unknown else read_lighting(photoset, table).directions
        for table in photoset.lightings
    }
    return known or {"": NO_SOURCES}


def _write_field(path: Path, field: LightField) -> None:
    arrays = {entry.name: getattr(field, entry.name) for entry in fields(field)}
    np.savez(path, **{name: values for name, values in arrays.items() if values is not None})


def _write_transfer(path: Path, found: FoundMesh, transfer: TransferVectors) -> None:
    mesh = found.body.mesh
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
    found: FoundMesh,
    sources: Mapping[str, Floats],
    rows: Sequence[Mapping[str, Any]],
    transfer: TransferVectors,
) -> None:
    """The figure of the photograph that has the median number of samples."""
    counts = [row["samples"] for row in rows]
    index = int(np.argsort(counts, kind="stable")[len(counts) // 2])
    photo = photoset.photos[index]
    lights = {photo.lighting: sources[photo.lighting]}
    alone = PhotoSet(
        **{entry.name: getattr(photoset, entry.name) for entry in fields(photoset)} | {"photos": (photo,)}
    )
    (field,) = light_fields(alone, found.body, lights, None)
    # The part of degree 0 is the cosine-weighted share of the sky, times pi Y_00.
    sky = transfer.coefficients[:, 0] / (np.pi * np.sqrt(1 / (4 * np.pi)))
    panel = Panel(
        photo.label, photo.camera, decode_photo(photoset, photo), field, sources[photo.lighting], sky
    )
    samples_figure(panel, found.body, found.body.mesh.faces).savefig(path)


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
