"""Registered poses as they are handed on: poses.json, and the cloud of points as a PLY file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from recon.poses.similarity import cross_matrix

Floats = NDArray[np.float64]

Method = Literal["features", "board", "colmap", "transforms"]
ScaleSource = Literal["board", "gantry", "poses", "free"]


@dataclass(frozen=True, eq=False)
class Registration:
    """Where the photographs of a set were taken from.

    names : (c,) of the photographs that have a pose, as the manifest writes their files; labels : the same, short.
    poses : (c, 4, 4), world to camera.
    covariance : (6c, 6c) as in `recon.poses.register.posecovariance.pose_covariance`, or None.
    rms_px, observations : (c,) or None.
    unregistered : names of the others, and why. points : (p, 3) in the world, colours : (p, 3) uint8; may be empty.
    scale_from : what gives the world's place and size; "free" if nothing does. relative_std : of its size, if known.
    """

    method: Method
    names: tuple[str, ...]
    labels: tuple[str, ...]
    poses: Floats
    covariance: Floats | None
    rms_px: Floats | None
    observations: NDArray[np.int64] | None
    unregistered: Mapping[str, str]
    points: Floats
    colours: NDArray[np.uint8]
    scale_from: ScaleSource
    relative_std: float | None
    warnings: tuple[str, ...]

    @property
    def metric(self) -> bool:
        return self.scale_from != "free"

    @property
    def pose_covariances(self) -> Floats | None:
        """Covariance (c, 6, 6) of each pose: of the turn w and the shift s in [exp(w) R | t + s]."""
        if self.covariance is None:
            return None
        count = len(self.poses)
        blocks = self.covariance.reshape(count, 6, count, 6)[np.arange(count), :, np.arange(count)]
        # A turn about the camera's centre leaves the centre; one of R alone moves it by the turn of t.
        change = np.tile(np.eye(6), (count, 1, 1))
        change[:, 3:, :3] = -cross_matrix(self.poses[:, :3, 3])
        return np.asarray(change @ blocks @ change.transpose(0, 2, 1))

    @property
    def stds(self) -> Floats | None:
        """Standard deviations (c, 2): of the orientation (radians) and of the camera's place, all axes together."""
        if self.covariance is None:
            return None
        variances = np.diag(self.covariance).reshape(-1, 2, 3).sum(axis=2)
        return np.sqrt(variances)


def poses_document(found: Registration, points_name: str | None) -> dict[str, Any]:
    """What a poses.json holds, but for inputs and software."""
    covariances, stds = found.pose_covariances, found.stds
    photos = []
    for row, name in enumerate(found.names):
        std = None
        if stds is not None:
            std = {"rotation_deg": float(np.degrees(stds[row, 0])), "position": float(stds[row, 1])}
        photos.append(
            {
                "file": name,
                "world_to_camera": found.poses[row].tolist(),
                "covariance": None if covariances is None else covariances[row].tolist(),
                "std": std,
                "rms_px": None if found.rms_px is None else float(found.rms_px[row]),
                "observations": None if found.observations is None else int(found.observations[row]),
            }
        )
    return {
        "format": 1,
        "method": found.method,
        "photos": photos,
        "unregistered": [{"file": name, "reason": why} for name, why in found.unregistered.items()],
        "scale": {"metric": found.metric, "from": found.scale_from, "relative_std": found.relative_std},
        "points": points_name,
        "warnings": list(found.warnings),
    }


def write_cloud(path: Path, points: Floats, colours: NDArray[np.uint8]) -> None:
    """Write points (n, 3) with colours (n, 3) as a binary PLY file."""
    import trimesh

    trimesh.PointCloud(points, colours).export(path)
