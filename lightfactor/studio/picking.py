"""Points of a mesh that a person marks in photographs: kept as picks.csv, which `lightfactor align` reads."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture.files.outfolder import result_files
from capture.photoset import PhotoSet, load_photoset
from invrender.brdf.microfacet import Microfacet
from invrender.output.live.few_faces import few_faces
from invrender.output.live.live_light import LiveLight
from invrender.output.live.live_material import LiveReflectance
from invrender.output.live.lobe_maps import no_maps
from invrender.output.live.lobe_volume import lobe_volume
from invrender.output.live.packed import packed_scene
from invrender.output.live.scene import LiveScene
from invrender.output.render.view import DEFAULT_VIEW, new_optics
from lightfactor.studio.opened import Opened, UnknownIdError, key_of
from recon.mesh.shape import METRES, read_object_mesh
from recon.poses.align.absolute import LEAST_PICKS, PickFit, fit_picks
from recon.poses.align.evidence import picked_points
from recon.poses.align.picks import COLUMNS, Picks, read_picks
from recon.poses.align.pixelrays import from_one_place
from recon.poses.similarity import Similarity

Floats = NDArray[np.float64]

PICKS_NAME = "picks.csv"
_GREY = 0.25
# Nobody clicks better than this, pixels in u and v; a few picks that fit by chance don't show it.
_CLICK_PX = 0.3
# Steps of turns (radians) and shifts (of the mesh's radius) by which derivatives are taken.
_STEP = 1e-5


def mesh_to_pick(opened: Opened) -> bytes:
    """The set's mesh in its own axes, metres, grey under an even light, packed as live pictures are.

    One of many faces is simplified, and a note says so; ValueError as `few_faces` has it.
    """
    photoset = _photoset(opened)
    few, notes = few_faces(read_object_mesh(photoset).mesh, f"{photoset.manifest}: [object]")
    mesh = few.mesh
    centre = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
    radius = float(np.linalg.norm(mesh.vertices - centre, axis=1).max())
    count = len(mesh.vertices)
    white, ones = np.full((1, 1, 4), 255, np.uint8), np.ones((count, 4), np.float16)
    grey = Microfacet(np.full(3, _GREY), np.zeros(3), None, None)
    even = LiveLight(
        "even",
        1.0,
        np.zeros((0, 4)),
        np.zeros((0, 3)),
        np.ones((count, 1, 3), np.float16),
        no_maps(),
    )
    scene = LiveScene(
        name=opened.folder.name,
        mesh=mesh,
        centre=centre,
        radius=radius,
        has_shadows=False,
        kd=LiveReflectance(grey.kd, white, ones),
        ks=LiveReflectance(grey.ks, white, ones),
        brdf=grey,
        volume=lobe_volume(grey),
        transmitted=np.ones(2, np.float16),
        lights=(even,),
        optics=new_optics(None, radius, None, None),
        first_view=DEFAULT_VIEW,
        notes=(*notes, "Picks are points of what is shown.") if notes else (),
    )
    return packed_scene(scene)


def read_saved(opened: Opened) -> dict[str, Any]:
    """The picks that are kept, and what they say; none where there is no file."""
    photoset = _photoset(opened)
    file = photoset.folder / PICKS_NAME
    if not file.is_file():
        return {"picks": [], "fit": None, "said": _needed(0)}
    metres = METRES[photoset.object.unit]
    return _described(photoset, read_picks(file, photoset.photos, metres))


def save(opened: Opened, picks: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Keep picks as picks.csv in place of those that were there; returns what they say.

    picks : {photo: id, u, v, x, y, z} each; pixels, and the mesh file's unit. ValueError for numbers that aren't.
    """
    photoset = _photoset(opened)
    labels = {key_of(photo.label): photo.label for photo in photoset.photos}
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(COLUMNS)
    for pick in picks:
        if pick["photo"] not in labels:
            raise UnknownIdError(
                f"photograph {pick['photo']}: the set has none of this id; load the page again"
            )
        numbers = [float(pick[name]) for name in COLUMNS[1:]]
        if not np.isfinite(numbers).all():
            raise ValueError(f"a pick is {numbers}; all must be finite numbers")
        rows.writerow([labels[pick["photo"]], *(f"{number:.9g}" for number in numbers)])
    file = photoset.folder / PICKS_NAME
    if not picks:
        file.unlink(missing_ok=True)
        return read_saved(opened)
    with result_files(file) as folder:
        (folder / PICKS_NAME).write_text(text.getvalue(), encoding="utf-8")
        described = _described(
            photoset, read_picks(folder / PICKS_NAME, photoset.photos, METRES[photoset.object.unit])
        )
    return described


def _photoset(opened: Opened) -> PhotoSet:
    if opened.manifest is None:
        raise ValueError(opened.problem)
    photoset = load_photoset(opened.manifest, find_alignment=True)
    if photoset.object.mesh is None:
        raise ValueError(f"{photoset.manifest}: [object] has no mesh to pick points of")
    return photoset


def _needed(count: int) -> str:
    return (
        f"{count} points are picked; {LEAST_PICKS} are needed, 6 or more are better"
        if count < LEAST_PICKS
        else ""
    )


def _described(photoset: PhotoSet, picks: Picks) -> dict[str, Any]:
    metres = METRES[photoset.object.unit]
    listed = [
        {
            "photo": key_of(photoset.photos[photo].label),
            **dict(zip(COLUMNS[1:], [*pixel, *(point / metres)], strict=True)),
        }
        for photo, pixel, point in zip(picks.photos, picks.pixels.tolist(), picks.points, strict=True)
    ]
    if said := _needed(len(np.unique(picks.points, axis=0))):
        return {"picks": listed, "fit": None, "said": said}
    try:
        taken = picked_points(picks, photoset.photos, PICKS_NAME)
        several = not from_one_place(taken.rays.origins)
        found = fit_picks(taken.rays, taken.points, several, taken.focal_px)
    except ValueError as error:
        return {"picks": listed, "fit": None, "said": str(error)}
    return {"picks": listed, "fit": _fit(photoset, picks, found, several), "said": ""}


def _fit(photoset: PhotoSet, picks: Picks, found: PickFit, free_scale: bool) -> dict[str, Any]:
    """Residuals, scatter, and how well the picks alone determine the mesh's place."""
    place = found.places[0]
    middle = picks.points.mean(axis=0)
    pivot = place.apply(middle[None])[0]
    radius = float(np.linalg.norm(picks.points - middle, axis=1).max())
    unit = np.array([1.0] * 3 + [radius] * 3 + [1.0])[: 7 if free_scale else 6]

    def pixels(of: Similarity) -> Floats:
        points = of.apply(picks.points)
        return np.concatenate(
            [
                photoset.photos[photo].camera.project(point[None])[0]
                for photo, point in zip(picks.photos, points, strict=True)
            ]
        )

    columns = []
    for k in range(len(unit)):
        step = np.zeros(7)
        step[k] = _STEP * unit[k]
        columns.append((pixels(place.moved(step, pivot)) - pixels(place.moved(-step, pivot))) / (2 * _STEP))
    kept = np.repeat(found.kept, 2)
    information = np.stack(columns, axis=1)[kept]
    covariance = max(found.sigma, _CLICK_PX) ** 2 * np.linalg.pinv(information.T @ information)
    std = np.sqrt(np.diag(covariance)) * unit
    exact = 2 * int(found.kept.sum()) <= len(unit)
    return {
        "residuals": found.residuals.tolist(),
        "kept": found.kept.tolist(),
        "sigma": found.sigma,
        # As many numbers as there are unknowns fit whatever they are.
        "turnDeg": None if exact else float(np.degrees(np.linalg.norm(std[:3]))),
        "shiftMetres": None if exact else float(np.linalg.norm(std[3:6])),
        "places": len(found.places),
    }
