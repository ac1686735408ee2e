"""What the page is told of a set, its fits and results, as JSON-ready data."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Any

from capture.files.documents import input_hashes, numbers
from capture.photoset import PhotoSet
from invrender.result.saved import SavedResult
from invrender.result.shown import shown_numbers
from lightfactor.studio import starter
from lightfactor.studio.jobs import Job, jobs, plan_folder, result_exists
from lightfactor.studio.opened import Opened, key_of
from lightfactor.studio.regions import takes_regions
from lightfactor.studio.relit import maps
from recon.mesh.shape import METRES


def state(opened: Opened) -> dict[str, Any]:
    """All that is open."""
    photoset, problem = opened.as_far_as_it_goes()
    started = jobs(opened)
    results = [
        {"id": key_of(path.name), "name": path.name, "first": path == opened.first}
        for path in opened.results()
    ]
    lacks = opened.manifest is not None and not opened.manifest.exists()
    return {
        "folder": opened.folder.name,
        "problem": "" if lacks else problem,
        "starter": starter.found(opened.folder) if lacks else None,
        "set": None if photoset is None else _photoset(photoset),
        "results": results,
        "fits": [job(opened, each) for each in started],
    }


def _photoset(photoset: PhotoSet) -> dict[str, Any]:
    return {
        "name": photoset.name,
        "shape": photoset.object.shape,
        "metres": METRES[photoset.object.unit],
        "photos": [
            {
                "id": key_of(photo.label),
                "label": photo.label,
                "lighting": photo.lighting,
                "heldOut": photo.held_out,
                "hasMask": photo.mask is not None,
                "width": photo.camera.width,
                "height": photo.camera.height,
                "missing": not photo.file.is_file(),
            }
            for photo in photoset.photos
        ],
        "cameras": [
            {
                "photo": key_of(photo.label),
                "centre": numbers(photo.camera.camera_to_world[:3, 3]),
                "axes": numbers(photo.camera.camera_to_world[:3, :3].T),
                "reach": _reach(photo.camera.width, photo.camera.height, photo.camera.focal_px),
                "orthographic": photo.camera.is_orthographic,
            }
            for photo in photoset.photos
            if photo.posed
        ],
        "lightings": [
            {
                "id": key_of(table.name),
                "name": table.name,
                "unknown": table.unknown,
                "takesRegions": takes_regions(table),
                "regions": [
                    {"direction": cone.direction, "radiusDeg": cone.radius_deg}
                    for cone in table.source_regions
                ],
            }
            for table in photoset.lightings
        ],
    }


def _reach(width: int, height: int, focal: float) -> list[float]:
    return [width / 2 / focal, height / 2 / focal]


def job(opened: Opened, started: Job) -> dict[str, Any]:
    """A fit: how it stands, what it is doing, and what it said if it failed."""
    now = started.state()
    return {
        "id": started.key,
        "name": started.name,
        "state": now,
        "progress": started.progress() if now == "running" else None,
        "said": started.said().strip() if now != "running" else "",
        "hasResult": result_exists(opened, started.name),
    }


def result(opened: Opened, found: SavedResult) -> dict[str, Any]:
    """A result's numbers, models, photographs and lights."""
    content = found.content
    brdf = content.brdf
    return {
        "id": key_of(found.folder.name),
        "name": found.folder.name,
        "set": content.name,
        "gauge": content.gauge,
        "lobe": brdf.form.description if brdf.ks else "matte: no lobe was needed",
        "numbers": [asdict(number) for number in shown_numbers(found)],
        "models": [
            {
                "name": model.name,
                "parameters": model.parameters,
                "unseen": model.unseen,
                "chosen": model.chosen,
            }
            for model in content.models
        ],
        "errors": {
            "fitted": content.fit.fitted,
            "unseen": content.fit.unseen,
            "heldOut": content.fit.held_out,
        },
        "photos": [
            {
                "id": key_of(photo.file),
                "label": photo.file,
                "heldOut": photo.held_out,
                "error": photo.rms_relative,
            }
            for photo in content.photos
        ],
        "warnings": list(content.warnings),
        "lights": [entry.name for entry in content.lighting] + [path.stem for path in maps(opened.own)],
        "predicted": (found.folder / "predicted").is_dir(),
    }


def plan(opened: Opened, found: SavedResult) -> dict[str, Any] | None:
    """What is planned of a result as it is now, with directions to its lamps; None where nothing is."""
    file = plan_folder(opened, found.folder) / "plan.json"
    if not file.is_file():
        return None
    document = json.loads(file.read_text(encoding="utf-8"))
    if document["inputs"] != dict(input_hashes([found.path])):
        return None
    lamps = [source.direction for entry in found.content.lighting for source in entry.directional]
    return {"advice": document["advice"], "sentences": document["sentences"], "lamps": lamps}
