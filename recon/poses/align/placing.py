"""From masks, picks, a cloud and cameras to the place of the mesh, or to a sentence that says why there is none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from recon.poses.align.candidates import APART, best_of, starts_from_picks, suspected_convention
from recon.poses.align.refine import PickedRays, RefinedPlace, refine
from recon.poses.align.search import starting_places
from recon.poses.align.silhouettes import overlap
from recon.poses.align.task import FoundPlace, NoFitError, Task, from_several_places, resized
from recon.poses.align.uncertainty import PlaceUncertainty, uncertainty
from recon.poses.align.verdicts import fits, misfit_px, off_px, open_axis, tolerated_px, wrong_size

# Photographs that are off by so many times what the others are, and by more than is tolerated, are left out.
_LEFT_OUT = 5.0
# Share of the outlines that may lie far from the silhouettes without a word.
_FAR_SHARE = 0.1
# Points of a cloud that lie farther from the mesh, in its sizes, don't show it.
_MAX_CLOUD_RMS = 0.02
# Scale of poses that are metric: off by more than this share the mesh is another, or in another unit.
_SAME_SIZE = 0.1
_ADVICE = "check masks and poses, or give picks (--picks)"


def place_mesh(task: Task) -> FoundPlace:
    """Where the mesh stands; ValueError says why it is undetermined, and what to do."""
    try:
        return _placed(task)
    except NoFitError as error:
        name = suspected_convention(task) if task.picks is None else None
        if name is None and task.start is not None:
            raise ValueError(f"{error}; or start from nothing (--auto) instead of mesh_to_world") from error
        if name is None:
            raise
        raise ValueError(f"the mesh fits its masks nowhere; the poses look like {name}") from error


def _placed(task: Task) -> FoundPlace:
    several, labels = from_several_places(task), task.labels
    kept = np.ones(0 if task.picks is None else len(task.picks.points), bool)
    warnings: list[str] = []
    pull = None
    if task.picks is not None:
        starts, pull, kept, notes = starts_from_picks(task, several)
        warnings += notes
    elif task.start is not None:
        starts = [task.start]
    elif task.outlines:
        try:
            starts = starting_places(task.tracer.vertices, task.outlines, several)
        except ValueError as error:
            raise NoFitError(str(error)) from error
        if task.cloud is not None:
            starts += [fit.place for fit in task.cloud.search(several or not task.metric)[:2]]
    elif task.cloud is not None:
        return _from_cloud(task)
    else:
        raise ValueError(
            "there is nothing to align the mesh by: give masks (mask = '...' in [[photo]]), picks (--picks), or poses"
            " from `lightfactor register`, whose cloud of points serves too"
        )
    if not several:
        starts = [resized(task, start, 1.0) for start in starts]
    best = best_of(task, starts, several, pull)
    scale_free = task.free_scale or not task.metric
    if several and not scale_free:
        best, notes = _at_given_scale(task, best, pull)
        warnings += notes
    _check(task, best)
    task, best, notes = _without_misfits(task, best, pull)
    warnings += notes
    axis = open_axis(task.tracer, task.outlines, best) if pull is None and task.outlines else None
    uncertain = uncertainty(best, best.place.scale * task.tracer.size / 2, bool(task.outlines))
    if uncertain.open_turn is not None:
        axis = best.place.rotation.T @ uncertain.open_turn
    if axis is not None:
        raise ValueError(
            f"nothing determines how the mesh is turned about its axis ({', '.join(f'{a:.2f}' for a in axis)}), as on a"
            " vase: its silhouettes look the same all around; give picks of details on the surface (--picks)"
        )
    known = several or task.metric
    if not known:
        warnings.append(
            "all cameras see from one place: how large the world is, and how far the mesh, can't be determined;"
            " world_scale is left at 1; add photographs from other sides"
        )
    elif several and scale_free and uncertain.covariance[6, 6] > 0.05**2:
        warnings.append(
            f"the world's scale is known to {np.sqrt(uncertain.covariance[6, 6]):.0%} only; add photographs from other"
            " sides and distances"
        )
    if uncertain.open_depth:
        warnings.append(
            "orthographic cameras from one side: the mesh's depth can't be determined; it changes nothing that they"
            " see"
        )
    warnings += _pick_warnings(task, best, pull)
    left_out = tuple(label for label in labels if label not in task.labels)
    return FoundPlace(best.place, uncertain, best.pivot, known, best, kept, tuple(warnings), left_out)


def _check(task: Task, fit: RefinedPlace) -> None:
    """ValueError unless it fits."""
    if fits(task.tracer, task.outlines, fit):
        return
    areas = [overlap(task.tracer, fit.place, outline) for outline in task.outlines]
    worst = int(np.argmin(areas))
    raise NoFitError(
        f"the mesh did not find its place: at the best one its silhouettes are {misfit_px(fit):.1f} px (mean) from the"
        f" masks' outlines, and overlap the masks by {np.median(areas):.0%} (median; {task.labels[worst]}:"
        f" {areas[worst]:.0%}); {_ADVICE}"
    )


def _at_given_scale(
    task: Task, free: RefinedPlace, pull: PickedRays | None
) -> tuple[RefinedPlace, list[str]]:
    """The fit at scale 1, and a sentence if the mesh fits better at another; ValueError if it fits there only."""
    size = free.place.scale
    spread = uncertainty(free, size * task.tracer.size / 2, bool(task.outlines)).covariance[6, 6]
    sure = abs(np.log(size)) > max(4 * np.sqrt(spread), 0.003)
    if sure and abs(np.log(size)) > _SAME_SIZE and fits(task.tracer, task.outlines, free):
        raise ValueError(wrong_size(size, task.unit))
    held = refine(task.tracer, task.outlines, resized(task, free.place, 1.0), False, pull)
    if not fits(task.tracer, task.outlines, held) and fits(task.tracer, task.outlines, free):
        raise ValueError(wrong_size(size, task.unit))
    if sure:
        return held, [
            f"the mesh would fit better if it were {size:.4f} times as large (± {size * np.sqrt(spread):.4f}): is the"
            " scale of the poses, or the mesh's, exact? --free-scale estimates it"
        ]
    return held, []


def _from_cloud(task: Task) -> FoundPlace:
    assert task.cloud is not None
    matches = task.cloud.search(free_scale=True)
    best = matches[0]
    if best.rms > _MAX_CLOUD_RMS:
        raise ValueError(
            f"the cloud of points doesn't fit the mesh: the nearer of its points are {best.rms:.1%} of the mesh's size"
            " (RMS) from it; give masks, which separate the object's points from the background's, or picks (--picks)"
        )
    for other in matches[1:]:
        if other.place.angle_to(best.place) > APART and other.rms < 1.2 * best.rms:
            raise ValueError(
                "the cloud of points fits two orientations of the mesh,"
                f" {np.degrees(other.place.angle_to(best.place)):.0f} degrees apart, equally well; give masks or picks"
            )
    if task.metric and not task.free_scale:
        if abs(np.log(best.place.scale)) > _SAME_SIZE:
            raise ValueError(wrong_size(best.place.scale, task.unit))
        best = task.cloud.finish([resized(task, best.place, 1.0)], free_scale=False)[0]
    note = (
        "no photograph has a mask: the place rests on the cloud of points alone; masks make it far more exact"
    )
    return FoundPlace(
        best.place,
        PlaceUncertainty(best.covariance, None, False),
        best.pivot,
        True,
        None,
        np.ones(0, bool),
        (note,),
    )


def _without_misfits(
    task: Task, fit: RefinedPlace, pull: PickedRays | None
) -> tuple[Task, RefinedPlace, list[str]]:
    """Task and fit without photographs that contradict it, and sentences on them and on what else doesn't fit."""
    if not task.outlines:
        return task, fit, []
    off = off_px(fit.left, len(task.outlines))
    tolerated = tolerated_px(task.outlines)
    wrong = off > max(_LEFT_OUT * float(np.median(off)), 2 * tolerated)
    notes = []
    if wrong.any():
        for photo in np.flatnonzero(wrong).tolist():
            seen = overlap(task.tracer, fit.place, task.outlines[photo]) > 0
            what = (
                f"mask and mesh lie {off[photo]:.1f} px apart"
                if seen
                else "the mesh isn't seen where the mask is"
            )
            notes.append(
                f"{task.labels[photo]} is left out: {what}, unlike in the others; check its mask and pose"
            )
        good = np.flatnonzero(~wrong)
        task = replace(
            task,
            outlines=[task.outlines[i] for i in good.tolist()],
            labels=[task.labels[i] for i in good.tolist()],
        )
        fit = refine(task.tracer, task.outlines, fit.place, bool(fit.free[6]), pull)
    away = np.where(fit.left.found, np.abs(fit.left.offsets), fit.left.reach) > 2 * tolerated
    if away.mean() > _FAR_SHARE:
        notes.append(
            f"{away.mean():.0%} of the masks' outlines lie more than {2 * tolerated:.1f} px from the mesh's: has the"
            " object parts that the mesh lacks, or is the mesh its mirror image, or do masks show more than the object?"
        )
    return task, fit, notes


def _pick_warnings(task: Task, best: RefinedPlace, pull: PickedRays | None) -> list[str]:
    if pull is None or not task.outlines:
        return []
    off = float(np.sqrt((best.left.picks**2).sum(axis=1).mean() / 2))
    if off > 3 * max(pull.sigma, 1.0):
        return [
            f"where the masks put the mesh, the picks are {off:.1f} px (RMS) off, but {pull.sigma:.1f} px among"
            " themselves: masks and picks contradict each other"
        ]
    return []
