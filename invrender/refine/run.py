"""`lightfactor refine` at work: a photo set in, refined poses out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from rich.markup import escape
from rich.table import Table

from capture.files.documents import input_hashes, numbers, software, write_json
from capture.files.outfolder import result_files
from capture.found import ALIGNMENT_NAME
from capture.photoset import load_photoset
from capture.tasks.workplace import opened_workplace
from capture.terminal import console, leave_cleanly_when_stopped, track
from invrender.refine.alternate import RefinedPoses, refine_poses
from invrender.refine.posechange import pose_covariance, position_std
from invrender.transport.columns import COLUMNS_STAGE

POSES_NAME = "refined-poses.json"


def run_refine(source: Path, samples: int, turn_deg: float, shift_px: float, fresh: bool = False) -> None:
    """Refine the poses of a set, write them beside its manifest, and print how far they moved.

    fresh : as of `opened_workplace`.
    """
    leave_cleanly_when_stopped()
    photoset = load_photoset(source)
    output = photoset.folder / POSES_NAME
    if output in photoset.calibration_files:
        raise ValueError(
            f'{photoset.manifest}: poses = "{POSES_NAME}" is what refining made; take the line out to refine the poses'
            " as they were given, or rename the file to refine them further"
        )
    inputs = [photoset.manifest, *photoset.calibration_files, *(photo.file for photo in photoset.photos)]
    inputs += [photo.mask for photo in photoset.photos if photo.mask is not None]
    with opened_workplace(photoset.manifest, fresh=fresh) as workplace:
        found = refine_poses(photoset, samples, turn_deg, shift_px, track)
        # Rounds are kept as a whole.
        workplace.store.forget(COLUMNS_STAGE)
    if len(found.errors) == 1:
        console.print(
            "The poses stand as they are: moving them does not lower the error on unseen photographs"
            f" ({found.errors[0]:.2%}). Nothing was written.",
            soft_wrap=True,
        )
        return
    with result_files(output, inputs=inputs) as folder:
        about = {"inputs": input_hashes(inputs), "software": software()}
        write_json(folder / output.name, _document(found) | about)
    _report(found)
    console.print(f"Wrote {escape(str(output))}", soft_wrap=True)
    use = f'To use it, write poses = "{POSES_NAME}" at the top of {photoset.manifest}'
    if any(path.name == ALIGNMENT_NAME for path in photoset.calibration_files):
        # An alignment.json is bound to the poses that it was made with.
        assert photoset.mesh_to_world is not None
        use += f", and mesh_to_world = {numbers(photoset.mesh_to_world)} in its [object]"
    console.print(f"{escape(use)}.", soft_wrap=True)


def _report(found: RefinedPoses) -> None:
    table = Table(box=None, header_style="bold")
    for heading in ("photo", "turned (degrees)", "shifted (px)", "± degrees", "± shift (px)"):
        table.add_column(heading, justify="left" if heading == "photo" else "right")
    for photo, given, pose in zip(found.photoset.photos, found.given, found.poses, strict=True):
        change, std = (values * given.units for values in (pose.change, np.sqrt(np.diag(pose.covariance))))
        moved = photo.camera.project(given.centre) - given.camera.project(given.centre)
        table.add_row(
            escape(photo.label),
            f"{np.degrees(np.linalg.norm(change[:3])):.2f}",
            f"{np.linalg.norm(moved):.2f}",
            f"{np.degrees(np.linalg.norm(std[:3])):.2f}",
            f"{np.linalg.norm(std[3:5]) * given.px_per_metre:.2f}",
        )
    console.print(table)
    errors = ", ".join(f"{error:.2%}" for error in found.errors)
    console.print(
        f"Error on unseen photographs as given and after each round: {errors}.",
        soft_wrap=True,
    )


def _document(found: RefinedPoses) -> dict[str, Any]:
    """What the file holds but for inputs and software: a poses.json."""
    photos = []
    for photo, given, pose in zip(found.photoset.photos, found.given, found.poses, strict=True):
        own = pose.covariance * np.outer(given.units, given.units)
        covariance = pose_covariance(photo.camera, given.centre, own)
        photos.append(
            {
                "file": photo.name,
                "world_to_camera": photo.camera.world_to_camera.tolist(),
                "covariance": covariance.tolist(),
                "std": {
                    "rotation_deg": float(np.degrees(np.sqrt(np.trace(covariance[:3, :3])))),
                    "position": position_std(photo.camera, covariance),
                },
                "rms_px": None,
                "observations": pose.observations,
            }
        )
    return {
        "format": 1,
        "method": "photometric",
        "photos": photos,
        "unregistered": [],
        "scale": {"metric": True, "from": "poses", "relative_std": None},
        "points": None,
        "warnings": [],
    }
