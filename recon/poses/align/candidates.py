"""Where a mesh may stand: places that picks allow, the best of many starts, and poses that were meant otherwise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from recon.placement.conventions import other_conventions
from recon.poses.align.absolute import fit_picks
from recon.poses.align.pixelrays import from_one_place
from recon.poses.align.refine import PickedRays, RefinedPlace, refine
from recon.poses.align.search import meeting_point, starting_places
from recon.poses.align.task import Task
from recon.poses.align.verdicts import fits, misfit_px, open_axis, ruled_out, tolerated_px
from recon.poses.similarity import Similarity

# Photos that are asked while many starts are tried, and starts that are followed to the end.
_TRIED_PHOTOS, _FOLLOWED = 8, 3
# Orientations that differ by more, radians, are two.
APART = np.radians(5)


def starts_from_picks(
    task: Task, several: bool
) -> tuple[list[Similarity], PickedRays, NDArray[np.bool_], list[str]]:
    picks = task.picks
    assert picks is not None
    origins = picks.rays.origins
    # From one place size and distance go together: the silhouettes of other photographs separate them.
    free = several and (bool(picks.rays.parallel.any()) or not from_one_place(origins))
    fit = fit_picks(picks.rays, picks.points, free, picks.focal_px)
    places = list(fit.places)
    if several and not free:
        target, eye = meeting_point(task.outlines), origins[0]
        nearer = []
        for place in places:
            middle = place.apply(task.tracer.centre[None])[0]
            factor = float(np.linalg.norm(target - eye) / np.linalg.norm(middle - eye))
            nearer += [
                Similarity(f * place.scale, place.rotation, eye + f * (place.translation - eye))
                for f in (1.0, factor, 0.9 * factor, 1.1 * factor)
            ]
        places = nearer
    elif len(places) > 1 and not task.outlines:
        raise ValueError(
            f"the picks fit {len(places)} places of the mesh; pick more points, spread over the object and its depth"
        )
    sigma = max(fit.sigma, 0.5)
    chosen = np.flatnonzero(fit.kept)
    pull = PickedRays(picks.rays.of(chosen), picks.points[chosen], sigma)
    notes = [
        f"{picks.names[i]} is {fit.residuals[i]:.3g} px from where the other picks put it, and is left out"
        for i in np.flatnonzero(~fit.kept).tolist()
    ]
    wrong = np.flatnonzero(~fit.kept)
    if len(wrong) == 2:
        exchanged, _ = picks.rays.of(wrong).offsets(fit.places[0].apply(picks.points[wrong[::-1]]))
        if np.linalg.norm(exchanged, axis=1).max() < 0.2 * fit.residuals[wrong].min():
            notes.append("with x, y, z of these two exchanged they would fit: are the rows swapped?")
    return places, pull, fit.kept, notes


def best_of(task: Task, starts: Sequence[Similarity], several: bool, pull: PickedRays | None) -> RefinedPlace:
    """The refined place that fits best; ValueError if another orientation fits as well."""
    some = np.linspace(0, len(task.outlines) - 1, min(len(task.outlines), _TRIED_PHOTOS)).round().astype(int)
    few = [task.outlines[i] for i in np.unique(some)] if task.outlines else []
    if len(starts) > 1 and few:
        tried = [refine(task.tracer, few, start, several, pull, thorough=False) for start in starts]
        tried.sort(key=misfit_px)
        starts = []
        for trial in tried:
            if len(starts) < _FOLLOWED and all(trial.place.angle_to(other) > APART for other in starts):
                starts.append(trial.place)
    followed = [refine(task.tracer, task.outlines, start, several, pull) for start in starts]
    followed.sort(key=misfit_px)
    best = followed[0]
    tolerated = tolerated_px(task.outlines)
    for other in followed[1:]:
        turned = best.place.angle_to(other.place)
        if turned < APART or misfit_px(other) > 2 * tolerated:
            continue
        if not ruled_out(best, other):
            if task.cloud is not None:
                ratio = task.cloud.rms(other.place) / task.cloud.rms(best.place)
                if ratio > 1.5:
                    continue
                if ratio < 1 / 1.5:
                    best = other
                    continue
            if pull is None and open_axis(task.tracer, task.outlines, best) is not None:
                break  # that says it better
            raise ValueError(
                f"the masks fit two orientations of the mesh that are {np.degrees(turned):.0f} degrees apart equally"
                f" well ({misfit_px(best):.2f} and {misfit_px(other):.2f} px): its shape is too symmetric, or the views"
                " are too few; give picks (--picks), or add photographs from other sides with masks"
            )
    return best


def suspected_convention(task: Task) -> str | None:
    """The convention in which the poses must have been written for the mesh to fit, if there is one."""
    for name, convert in other_conventions().items():
        outlines = [
            replace(outline, camera=outline.camera.posed(convert(outline.camera.world_to_camera)))
            for outline in task.outlines
        ]
        try:
            starts = starting_places(task.tracer.vertices, outlines, True)
        except ValueError:
            continue
        tried = [refine(task.tracer, outlines, start, True, thorough=False) for start in starts[:4]]
        if fits(task.tracer, outlines, min(tried, key=misfit_px)):
            return name
    return None
