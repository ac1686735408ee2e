"""alignment.json: where a mesh stands, as `load_photoset` reads it back, with how sure that is and how well it fits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from recon.poses.align.task import FoundPlace
from recon.poses.align.uncertainty import in_mesh_metres
from recon.poses.similarity import Similarity

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class PhotoFit:
    """How a photograph fits. rms_px : of its mask's outline from the mesh's, robust; overlap : intersection over union,
    both None without a mask. picks_px : RMS of its picks, None without. held_out, left_out : it was not
    fitted to, as the manifest says, or because it contradicts the others."""

    file: str
    label: str
    rms_px: float | None
    overlap: float | None
    picks_px: float | None
    held_out: bool
    left_out: bool


def placement(place: Similarity) -> tuple[Floats, float]:
    """mesh_to_world (4, 4), rigid, and world_scale, by which cameras' positions are multiplied, of a similarity."""
    mesh_to_world = np.eye(4)
    mesh_to_world[:3, :3] = place.rotation
    mesh_to_world[:3, 3] = place.translation / place.scale
    return mesh_to_world, 1 / place.scale


def alignment_document(
    found: FoundPlace,
    photos: Sequence[PhotoFit],
    method: str,
    made_from: Mapping[str, str],
    warnings: Sequence[str],
) -> dict[str, Any]:
    """What alignment.json holds, but for its inputs and the software."""
    mesh_to_world, world_scale = placement(found.place)
    covariance = in_mesh_metres(found.uncertain.covariance, found.place, found.pivot)
    scale_std = float(np.sqrt(found.uncertain.covariance[6, 6]))
    return {
        "format": 1,
        "method": method,
        "mesh_to_world": mesh_to_world.tolist(),
        "world_scale": world_scale,
        "made_from": dict(made_from),
        "covariance": covariance.tolist(),
        "std": std_of(found) | {"world_scale": world_scale * scale_std if found.scale_known else None},
        "mask_growth_px": None if found.refined is None else -found.refined.growth,
        "photos": [
            {
                "file": photo.file,
                "rms_px": photo.rms_px,
                "overlap": photo.overlap,
                "picks_rms_px": photo.picks_px,
                "held_out": photo.held_out,
                "left_out": photo.left_out,
            }
            for photo in photos
        ],
        "warnings": list(warnings),
    }


def std_of(found: FoundPlace) -> dict[str, float]:
    """Standard deviations of the angle by which the mesh is turned, degrees, and of its middle's place, metres."""
    variance = np.diag(found.uncertain.covariance)
    return {
        "rotation_deg": float(np.degrees(np.sqrt(variance[:3].sum()))),
        "position": float(np.sqrt(variance[3:6].sum()) / found.place.scale),
    }
