"""What a mesh is aligned by, and what comes of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recon.mesh.rays import RayTracer
from recon.poses.align.cloud import CloudMatcher
from recon.poses.align.outlines import Outline
from recon.poses.align.pixelrays import PixelRays, from_one_place
from recon.poses.align.refine import RefinedPlace
from recon.poses.align.uncertainty import PlaceUncertainty
from recon.poses.similarity import Similarity

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PickedPoints:
    """Picks as rays. rays : n of them. points : (n, 3) mesh frame. focal_px : typical focal length of their
    photographs, or their size where they have none. names : (n,) for messages."""

    rays: PixelRays
    points: Floats
    focal_px: float
    names: Sequence[str]


@dataclass(frozen=True, eq=False)
class Task:
    """What there is to align a mesh by.

    tracer : of the mesh in its frame, metres; unit : that of its file. outlines, labels : of the photographs with
    masks. metric : the poses are in metres. free_scale : the scale is estimated though they are. start : where to
    begin.
    """

    tracer: RayTracer
    unit: str
    outlines: Sequence[Outline]
    labels: Sequence[str]
    metric: bool
    free_scale: bool
    picks: PickedPoints | None = None
    cloud: CloudMatcher | None = None
    start: Similarity | None = None


@dataclass(frozen=True, eq=False)
class FoundPlace:
    """The mesh's place. uncertain : its covariance. scale_known : the world's scale was held, or is determined.

    refined : the fit to silhouettes and picks; None where only a cloud was there. kept : (n,) bool, picks that agree.
    left_out : labels of photographs that contradict the others, so that nothing was fitted to them.
    """

    place: Similarity
    uncertain: PlaceUncertainty
    pivot: Floats
    scale_known: bool
    refined: RefinedPlace | None
    kept: NDArray[np.bool_]
    warnings: tuple[str, ...]
    left_out: tuple[str, ...] = ()


class NoFitError(ValueError):
    """The mesh fits its masks nowhere."""


def from_several_places(task: Task) -> bool:
    """Whether cameras stand so that they determine how large the world is."""
    cameras = [outline.camera for outline in task.outlines]
    if cameras:
        centres = np.array([camera.centre for camera in cameras])
        parallel = any(camera.is_orthographic for camera in cameras)
    elif task.picks is not None:
        centres, parallel = task.picks.rays.origins, bool(task.picks.rays.parallel.any())
    else:
        return True
    return parallel or not from_one_place(centres)


def resized(task: Task, place: Similarity, scale: float) -> Similarity:
    """The place with another scale, the mesh's middle staying where it is."""
    middle = task.tracer.centre
    return Similarity(scale, place.rotation, place.apply(middle[None])[0] - scale * place.rotation @ middle)
