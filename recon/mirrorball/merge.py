"""Several views of one light: their sources matched and combined, and whether the views agree."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from capture.lighting import latlong_solid_angles
from recon.mirrorball.triangulate import apart, placed
from recon.mirrorball.view import BallSource, BallView
from recon.mirrorball.viewmap import ViewMap, blend
from recon.sphere.sphere import Sphere

Floats = NDArray[np.float64]
Hidden = list[tuple[Floats, float]]
# A source, and the view that shows it.
_Shown = tuple[BallView, BallSource]

# Sources of two views this far apart are one source all the same, and their poses are off.
_MATCH = np.radians(6.0)
# Where they are farther apart, by how much the directions may miss the place of a near lamp.
_MATCH_NEAR = np.radians(1.0)
# How many times as bright the brighter one of a match may be, where both were measured.
_MATCH_RATIO = 3.0
# Deviations, in standard deviations, between views of one source that are worth a warning; and the angle in
# degrees that is none, since poses are never exact.
_DEVIATIONS, _NOTABLE_DEG = 4.0, 0.5
# A view that looks at a source without showing this share of its light contradicts it.
_LEAST_SHARE = 0.3
# Correlation of the log radiance of one view with that of the others below which they don't show one room,
# and the contrast (standard deviation of log radiance) that it takes to say so.
_LEAST_CORRELATION, _CONTRAST = 0.5, 0.2
# Factor between the radiances of one view and of the others that is worth a warning.
_NOTABLE_FACTOR = 1.15


@dataclass(frozen=True)
class Agreement:
    """How one view's map agrees with the others', where they overlap.

    correlation : of log radiance; None where they show too little contrast, or don't overlap.
    factor : median of this view's radiance over the others'; None where they don't overlap.
    """

    name: str
    correlation: float | None
    factor: float | None


def merge_sources(
    views: Sequence[BallView], ball: Sphere | None = None
) -> tuple[tuple[BallSource, ...], list[Hidden], tuple[str, ...]]:
    """The sources of all views, brightest first, each once; near ones where several views of the ball show it.

    Returns with them, for each view, the discs (axis, half-angle) around sources that other views took out of
    their maps and this one did not; and warnings about sources on which views disagree.
    """
    free = sorted(
        ((index, source) for index, view in enumerate(views) for source in view.sources),
        key=lambda entry: -float(entry[1].irradiance.mean()),
    )
    merged: list[BallSource] = []
    hidden: list[Hidden] = [[] for _ in views]
    warnings: list[str] = []
    while free:
        first, brightest = free.pop(0)
        group = {first: brightest}
        for index in range(len(views)):
            matches = [
                s
                for i, s in free
                if i == index
                and index != first
                and _may_match(ball, (views[first], brightest), (views[index], s))
            ]
            if matches:
                nearest = max(matches, key=lambda s: float(s.direction @ brightest.direction))
                group[index] = nearest
                free = [entry for entry in free if entry[1] is not nearest]
        source, warning = _combined(ball, [(views[index], group[index]) for index in sorted(group)])
        merged.append(source)
        warnings += [warning] if warning else []
        for index, view in enumerate(views):
            if index not in group:
                half_angle, within = _light_near(view, source)
                hidden[index].append((source.direction, half_angle))
                if within is not None and within < _LEAST_SHARE * source.irradiance.mean():
                    warnings.append(
                        f"{view.name} looks towards a source that {source.views[0]} shows"
                        f" ({_words(source.direction)}), but sees no such light there; check the poses"
                    )
    merged.sort(key=lambda source: -float(source.irradiance.mean()))
    return tuple(merged), hidden, tuple(warnings)


def _may_match(ball: Sphere | None, one: _Shown, other: _Shown) -> bool:
    # What lies farther apart must be where a near lamp would be.
    angle = float(np.arccos(np.clip(one[1].direction @ other[1].direction, -1, 1)))
    close = angle < _MATCH or apart(ball, (one, other)) < _MATCH_NEAR
    bright, dim = sorted((one[1].irradiance.mean(), other[1].irradiance.mean()), reverse=True)
    return bool(close and (one[1].clipped or other[1].clipped or bright <= _MATCH_RATIO * dim))


def _combined(ball: Sphere | None, shown: Sequence[_Shown]) -> tuple[BallSource, str]:
    """One source from what several views say of it, weighted by inverse variance; and a warning, or ""."""
    group = [source for _, source in shown]
    if len(group) == 1:
        return group[0], ""
    lamp = None if ball is None else placed(ball, shown)
    if lamp is not None:
        group = [
            replace(
                source,
                direction=lamp.direction,
                irradiance=by * source.irradiance,
                irradiance_std=by * source.irradiance_std,
                closeness=lamp.closeness,
                closeness_std=lamp.closeness_std,
            )
            for source, by in zip(group, lamp.brighter, strict=True)
        ]
    std = np.maximum(np.radians([source.direction_std_deg for source in group]), 1e-6)
    directions = np.array([source.direction for source in group])
    mean = (directions / std[:, None] ** 2).sum(axis=0)
    mean /= np.linalg.norm(mean)
    apart = np.linalg.norm(directions - mean, axis=1)
    # Of n directions, 2 (n - 1) numbers are left over; they scatter by more than stated if this exceeds 1.
    excess = np.sqrt(max(1.0, float(((apart / std) ** 2).sum()) / (2 * (len(group) - 1))))
    warning = ""
    if excess > _DEVIATIONS and np.degrees(apart.max()) > _NOTABLE_DEG:
        warning = (
            f"a source ({_words(mean)}) lies up to {np.degrees(apart.max()):.1f} degrees from the mean of"
            f" {', '.join(name for source in group for name in source.views)}, {excess:.0f} times the standard"
            " deviation; check the poses, their convention and the masks"
        )
        if ball is None:
            warning += "; a near lamp looks so, too: poses with the cameras' places tell how far it is"
    measured = [source for source in group if not source.clipped]
    values = np.array([source.irradiance for source in measured or group])
    if measured:
        stds = np.array([source.irradiance_std for source in measured])
        # A share of the brightest channel stands in for no doubt at all.
        variance = np.maximum(stds, 1e-6 * values.max()) ** 2
        irradiance = (values / variance).sum(axis=0) / (1 / variance).sum(axis=0)
        left_over = ((values - irradiance) ** 2 / variance).sum() / (3 * max(len(measured) - 1, 1))
        irradiance_std = np.sqrt(max(1.0, float(left_over)) / (1 / variance).sum(axis=0))
    else:
        # The largest of lower bounds.
        best = int(values.mean(axis=1).argmax())
        irradiance, irradiance_std = values[best], group[best].irradiance_std
    source = BallSource(
        direction=mean,
        irradiance=irradiance,
        irradiance_std=irradiance_std,
        angular_radius_deg=min(source.angular_radius_deg for source in measured or group),
        direction_std_deg=float(np.degrees(excess / np.sqrt((1 / std**2).sum()))),
        clipped=not measured,
        views=tuple(name for source in group for name in source.views),
        closeness=group[0].closeness,
        closeness_std=group[0].closeness_std,
    )
    return source, warning


def _light_near(view: BallView, source: BallSource) -> tuple[float, float | None]:
    """The half-angle in radians within which a view smears a source, and its mean irradiance there.

    The latter is None where the view does not show the whole of that disc, or shows it much stretched.
    """
    pixels = view.pixels
    cosine = np.where(pixels.usable, pixels.directions @ source.direction, -1.0)
    row, column = np.unravel_index(int(cosine.argmax()), cosine.shape)
    radius = np.radians(source.angular_radius_deg)
    half_angle = float(radius + 3 * pixels.stretch[row, column])
    disc = cosine > np.cos(half_angle)
    solid_angle = float(pixels.solid_angles[disc].sum())
    if half_angle > np.radians(20) or solid_angle < 0.8 * 2 * np.pi * (1 - np.cos(half_angle)):
        return half_angle, None
    around = (cosine > np.cos(2 * half_angle)) & ~disc
    background = np.median(pixels.radiance[around], axis=0) if around.any() else np.zeros(3)
    excess = (pixels.radiance[disc] - background) * pixels.solid_angles[disc][:, None]
    return half_angle, None if pixels.saturated[disc].any() else float(excess.sum(axis=0).mean())


def map_agreement(
    names: Sequence[str], maps: Sequence[ViewMap]
) -> tuple[tuple[Agreement, ...], tuple[str, ...]]:
    """How each view's map agrees with that of all others, and warnings where it does not."""
    found, warnings = [], []
    for index, (name, own) in enumerate(zip(names, maps, strict=True)):
        others = blend([each for k, each in enumerate(maps) if k != index])
        both = (np.minimum(own.covered, others.covered) > 0.99) & (own.saturated + others.saturated == 0)
        own_light, other_light = (each.radiance.mean(axis=2)[both].astype(float) for each in (own, others))
        if both.sum() < 10 or not (own_light.any() and other_light.any()):
            found.append(Agreement(name, None, None))
            continue
        # Each pixel counts as well as its worse view places it; black is a hundredth of what is usual.
        weight = np.minimum(own.weight, others.weight)[both]
        weight = weight * np.broadcast_to(latlong_solid_angles(len(both)), both.shape)[both]
        floor = 0.01 * (own_light.mean() + other_light.mean())
        x, y = np.log(own_light + floor), np.log(other_light + floor)
        covariance = np.cov(x, y, aweights=weight)
        contrast = np.sqrt(np.diag(covariance))
        correlation = None
        if contrast.min() > _CONTRAST:
            correlation = float(covariance[0, 1] / (contrast[0] * contrast[1]))
            if correlation < _LEAST_CORRELATION:
                warnings.append(
                    f"{name} and the other views don't show the same room (correlation {correlation:.2f});"
                    " check the poses, their convention and the masks"
                )
        order = np.argsort(x - y)
        middle = np.searchsorted(np.cumsum(weight[order]), weight.sum() / 2)
        factor = float(np.exp((x - y)[order][middle]))
        if max(factor, 1 / factor) > _NOTABLE_FACTOR:
            warnings.append(
                f"{name} is {factor:.2f} times as bright as the other views; check the exposures, or whether"
                " the light changed"
            )
        found.append(Agreement(name, correlation, factor))
    return tuple(found), tuple(warnings)


def _words(direction: Floats) -> str:
    return " ".join(f"{value:.2f}" for value in direction)
