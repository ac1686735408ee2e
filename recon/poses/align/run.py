"""`lightfactor align` at work: a photo set in, alignment.json and alignment.png out."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from capture.camera import Camera
from capture.decode import decode_photo, photo_mask
from capture.files.documents import file_hash, input_hashes, software, write_json
from capture.files.outfolder import result_files
from capture.found import ALIGNMENT_NAME
from capture.parallel import one_blas_thread
from capture.photoset import PhotoSet, load_photoset
from capture.tasks.stage import kept_result
from capture.tasks.workplace import opened_workplace
from capture.terminal import console, track
from recon.mesh.bodies import MeshBody, body_coverage
from recon.mesh.rays import RayTracer
from recon.mesh.shape import METRES, placed, read_object_mesh
from recon.mesh.trianglemesh import TriangleMesh
from recon.poses.align.absolute import fit_picks
from recon.poses.align.alignmentfile import PhotoFit, alignment_document, placement, std_of
from recon.poses.align.cloud import CloudMatcher
from recon.poses.align.evidence import Evidence, gather, picked_points, registered_poses
from recon.poses.align.overlay import Overlay, alignment_figure, shown_photos, title_of
from recon.poses.align.picks import Picks, check_on_surface, read_picks
from recon.poses.align.pixelrays import from_one_place
from recon.poses.align.placing import place_mesh
from recon.poses.align.refine import residuals_at
from recon.poses.align.silhouettes import overlap
from recon.poses.align.task import FoundPlace, Task
from recon.poses.align.verdicts import off_px
from recon.poses.similarity import Similarity

Floats = NDArray[np.float64]

_AUTO = "auto"


def run_align(path: Path, picks_file: Path | None, auto: bool, free_scale: bool, fresh: bool = False) -> None:
    """Align the mesh of a photo set and write where it stands beside its manifest; ValueError says what is wrong.

    fresh : as of `opened_workplace`.
    """
    photoset = load_photoset(path, find_alignment=True)
    read = read_object_mesh(photoset)
    assert photoset.object.mesh is not None
    mesh, mesh_file = read.mesh, photoset.resolve(photoset.object.mesh)
    picks_file, start, method = _method(photoset, picks_file, auto)
    poses = registered_poses(photoset)
    picks = None
    warnings = list(read.warnings)
    if picks_file is not None:
        picks = read_picks(picks_file, photoset.photos, METRES[photoset.object.unit])
        warnings += check_on_surface(picks_file, picks, mesh.vertices, mesh.faces)
    inputs = [photoset.manifest, mesh_file, *photoset.calibration_files]
    inputs += [photo.mask for photo in photoset.photos if photo.mask is not None]
    inputs += [] if picks_file is None else [picks_file]
    output = photoset.folder / ALIGNMENT_NAME
    workplace = opened_workplace(photoset.manifest, fresh=fresh)
    with result_files(output, [".png"], inputs) as folder, one_blas_thread(), workplace:
        evidence = gather(photoset, poses, True, track)
        warnings += evidence.warnings
        tracer = RayTracer(mesh.vertices, mesh.faces)
        task = _task(photoset, mesh, tracer, evidence, start, free_scale)
        found = kept_result(
            "place",
            partial(_placed, task, photoset, picks, picks_file),
            (mesh, photoset.object.unit, evidence, start, free_scale, picks),
        )
        warnings += found.warnings
        fits = _photo_fits(photoset, tracer, evidence, found, picks)
        if photoset.mesh_to_world is not None:
            warnings.append(
                f"{photoset.manifest.name} gives mesh_to_world in [object], which stands before the result: remove it"
                " there to use what was found"
            )
        made_from = {"mesh": file_hash(mesh_file)} | ({} if poses is None else {"poses": file_hash(poses)})
        document = alignment_document(found, fits, method, made_from, warnings)
        write_json(folder / output.name, document | {"inputs": input_hashes(inputs), "software": software()})
        figure = alignment_figure(*_panels(photoset, mesh, evidence, found, fits, picks))
        figure.savefig(folder / f"{output.stem}.png")
    _report(found, fits, warnings, output)


def _method(
    photoset: PhotoSet, picks_file: Path | None, auto: bool
) -> tuple[Path | None, Similarity | None, str]:
    """The picks to use, or where to start, and what this is called in the result."""
    asked = photoset.object.align
    if picks_file is None and not auto and asked not in (None, _AUTO):
        picks_file = photoset.resolve(asked or "")
        if not picks_file.is_file():
            raise ValueError(
                f"{photoset.manifest}: [object] align = {asked!r}: there is no such file; write 'auto', or the name of"
                " a CSV file of picks (photo,u,v,x,y,z)"
            )
    if picks_file is not None:
        return picks_file, None, "picks"
    if photoset.mesh_to_world is not None and not auto and asked is None:
        given = photoset.mesh_to_world
        return None, Similarity(1.0, given[:3, :3], given[:3, 3]), "mesh_to_world"
    return None, None, _AUTO


def _task(
    photoset: PhotoSet,
    mesh: TriangleMesh,
    tracer: RayTracer,
    evidence: Evidence,
    start: Similarity | None,
    free_scale: bool,
) -> Task:
    fitted = [i for i in evidence.outlines if not photoset.photos[i].held_out]
    cloud = evidence.cloud
    return Task(
        tracer=tracer,
        unit=photoset.object.unit,
        outlines=[evidence.outlines[i] for i in fitted],
        labels=[photoset.photos[i].label for i in fitted],
        metric=evidence.metric,
        free_scale=free_scale,
        cloud=None if cloud is None else CloudMatcher(mesh.vertices, mesh.faces, cloud),
        start=start,
    )


def _placed(task: Task, photoset: PhotoSet, picks: Picks | None, picks_file: Path | None) -> FoundPlace:
    if picks is None or picks_file is None:
        try:
            return place_mesh(task)
        except ValueError as error:
            raise ValueError(f"{photoset.manifest}: {error}") from error
    points = picked_points(picks, photoset.photos, picks_file.name)
    try:
        return place_mesh(replace(task, picks=points))
    except ValueError as error:
        raise ValueError(f"{picks_file}: {_explained(picks, photoset, picks_file) or error}") from error


def _explained(picks: Picks, photoset: PhotoSet, picks_file: Path) -> str:
    """What would make picks agree that don't, "" if nothing simple does."""
    try:
        turned = picked_points(picks, photoset.photos, picks_file.name, swapped=True)
        straight = picked_points(picks, photoset.photos, picks_file.name)
        several = not from_one_place(turned.rays.origins)
        after = fit_picks(turned.rays, turned.points, several, turned.focal_px)
    except ValueError:
        return ""
    try:
        before = fit_picks(straight.rays, straight.points, several, straight.focal_px)
    except ValueError:
        before = None
    # Few picks may fit either way; only where swapping mends them it is worth a word.
    if after.kept.all() and (before is None or before.sigma > 2 * after.sigma or not before.kept.all()):
        return "u and v look swapped: the picks agree if u is the row and v the column; u must be the column"
    return ""


def _photo_fits(
    photoset: PhotoSet, tracer: RayTracer, evidence: Evidence, found: FoundPlace, picks: Picks | None
) -> list[PhotoFit]:
    """How each photograph fits, those that were not fitted to among them."""
    masked = list(evidence.outlines)
    off: dict[int, float] = {}
    if found.refined is not None and masked:
        outlines = [evidence.outlines[i] for i in masked]
        values = off_px(residuals_at(tracer, outlines, found.refined), len(masked))
        off = dict(zip(masked, values.tolist(), strict=True))
    fits = []
    for index, photo in enumerate(photoset.photos):
        of_picks = None
        mine = np.zeros(0, bool) if picks is None else (picks.photos == index) & found.kept
        if picks is not None and mine.any():
            seen = photo.camera.project(found.place.apply(picks.points[mine]))
            of_picks = float(np.sqrt(((seen - picks.pixels[mine]) ** 2).sum(axis=1).mean()))
        left_out = photo.label in found.left_out
        area = overlap(tracer, found.place, evidence.outlines[index]) if index in evidence.outlines else None
        fits.append(
            PhotoFit(photo.name, photo.label, off.get(index), area, of_picks, photo.held_out, left_out)
        )
    return fits


def _panels(
    photoset: PhotoSet,
    mesh: TriangleMesh,
    evidence: Evidence,
    found: FoundPlace,
    fits: list[PhotoFit],
    picks: Picks | None,
) -> tuple[list[Overlay], str]:
    mesh_to_world, world_scale = placement(found.place)
    body = MeshBody(placed(mesh, mesh_to_world))
    chosen = shown_photos([fit.rms_px for fit in fits])
    if not chosen:
        with_picks = [i for i, fit in enumerate(fits) if fit.picks_px is not None]
        chosen = [(i, "") for i in (with_picks or range(len(fits)))[:3]]
    overlays = []
    for index, what in chosen:
        photo, fit = photoset.photos[index], fits[index]
        clicked = np.zeros((0, 2)) if picks is None else picks.pixels[picks.photos == index]
        to = np.zeros((0, 2))
        if picks is not None:
            to = photo.camera.project(found.place.apply(picks.points[picks.photos == index]))
        overlays.append(
            Overlay(
                title=title_of(
                    photo.label, "left out" if fit.left_out else what, fit.rms_px, fit.overlap, photo.camera
                ),
                radiance=decode_photo(photoset.radiometry, photo).radiance,
                mesh=body_coverage(body, _scaled(photo.camera, world_scale)),
                mask=photo_mask(photo),
                picks=clicked,
                to=to,
            )
        )
    return overlays, f"{photoset.name}: the aligned mesh on the photographs ({_summary(found, fits)})"


def _scaled(camera: Camera, world_scale: float) -> Camera:
    pose = camera.world_to_camera.copy()
    pose[:3, 3] *= world_scale
    return camera.posed(pose)


def _summary(found: FoundPlace, fits: list[PhotoFit]) -> str:
    off = [fit.rms_px for fit in fits if fit.rms_px is not None and not (fit.held_out or fit.left_out)]
    if off:
        return f"silhouettes {np.median(off):.2f} px from {len(off)} outlines, median"
    picked = [fit.picks_px for fit in fits if fit.picks_px is not None]
    if picked:
        return f"{int(found.kept.sum())} picks, {np.sqrt(np.mean(np.square(picked))):.2f} px RMS"
    return "from the cloud of points alone"


def _report(found: FoundPlace, fits: list[PhotoFit], warnings: list[str], output: Path) -> None:
    from rich.markup import escape
    from rich.table import Table

    mesh_to_world, world_scale = placement(found.place)
    std = std_of(found)
    table = Table(box=None, show_header=False)
    rows = "\n".join(" ".join(f"{value + 0.0:9.5f}" for value in row) for row in mesh_to_world[:3].round(5))
    table.add_row("mesh_to_world", rows)
    table.add_row("", f"± {std['rotation_deg']:.2g} degrees, ± {1000 * std['position']:.2g} mm")
    if found.scale_known:
        scale_std = world_scale * np.sqrt(found.uncertain.covariance[6, 6])
        table.add_row(
            "world_scale", f"{world_scale:.6g}" + (f" ± {scale_std:.2g}" if scale_std else " (held)")
        )
    table.add_row("fit", _summary(found, fits))
    held = [fit.rms_px for fit in fits if fit.rms_px is not None and fit.held_out]
    if held:
        table.add_row("held out", f"silhouettes {np.median(held):.2f} px from {len(held)} outlines, median")
    console.print(table)
    for warning in warnings:
        console.print(f"Warning: {escape(warning)}.")
    console.print(f"Wrote {escape(str(output))} and {output.stem}.png: look whether the outlines agree.")
