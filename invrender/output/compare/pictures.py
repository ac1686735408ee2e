"""Pictures of a comparison: both predictions of the same photographs, and both materials under one light."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from capture.camera import Camera
from capture.files.imagefile import read_pixels
from invrender.brdf.microfacet import Microfacet
from invrender.estimate.quantities import FittedLighting
from invrender.output.compare.lightings import LightPair
from invrender.output.render.light import light_element
from invrender.output.render.picture import take_picture
from invrender.output.render.subject import sphere_subject
from invrender.output.render.view import View, ViewCamera, seen_from
from invrender.output.report.pictures import (
    difference_picture,
    figure_url,
    image_url,
    lighting_figure,
    shrunk,
    tone_mapped,
    white_level,
)
from invrender.result.reflectance import Reflectance
from invrender.result.side import Side

Floats = NDArray[np.float64]

_MAX_PHOTOS, _MAX_LIGHTS = 4, 6
# Shares of white at which the colours of differences may saturate: the first that is three times their RMS.
_LIMITS = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5)
# The sphere under one light: seen from three sides, so many pixels wide.
_AZIMUTHS, _ELEVATION, _SIDE = (0, 120, 240), 20.0, 160


@dataclass(frozen=True)
class ComparisonPanel:
    """Two pictures and their difference as data URLs, under a heading.

    rms : of the difference, relative to the first picture. limit : share of white at which its colours saturate.
    """

    heading: str
    first: str
    second: str
    difference: str
    rms: float
    limit: float


def photo_panels(first: Side, second: Side) -> Iterator[ComparisonPanel]:
    """A few photographs that both sides predict, or know; B's scaled to A's per channel where a gauge is relative."""
    shared = [label for label in first.pictures if label in second.pictures]
    chosen = np.unique(np.linspace(0, len(shared) - 1, min(len(shared), _MAX_PHOTOS)).astype(int))
    free = not (first.is_absolute and second.is_absolute)
    for label in (shared[k] for k in chosen):
        one, other = (
            read_pixels(side.pictures[label]).astype(float) * side.picture_factor for side in (first, second)
        )
        if one.shape != other.shape:
            continue
        # Where one side leaves the outline out, neither is judged there.
        inside = np.asarray(one.any(axis=2) & other.any(axis=2))
        if inside.any():
            yield _panel(label, one, other, inside, free)


def material_panels(first: Side, second: Side, lights: Sequence[LightPair]) -> Iterator[ComparisonPanel]:
    """A sphere of both materials under the first lighting of A; of shares where a gauge is relative."""
    if first.brdf is None or second.brdf is None or not lights:
        return
    lighting = lights[0].first.lighting
    element = light_element(lighting)
    free = not (first.is_absolute and second.is_absolute)
    materials = [_shares(brdf) if free else brdf for brdf in (first.brdf, second.brdf)]
    subject = sphere_subject(np.zeros(3), 1.0)
    scale = 0.45 * _SIDE
    camera = Camera("ORTHOGRAPHIC", np.array([scale, _SIDE / 2, _SIDE / 2]), _SIDE, _SIDE, np.eye(4))
    for azimuth in _AZIMUTHS:
        seen = seen_from(ViewCamera(camera, 10.0), View(azimuth, _ELEVATION, None), np.zeros(3), 1.0)
        pictures = [
            take_picture(subject, seen, Reflectance(brdf, np.zeros((3, 4, 4)), {}, ()), element)
            for brdf in materials
        ]
        one, other = (picture.radiance.astype(float) for picture in pictures)
        yield _panel(f"from azimuth {azimuth}", one, other, pictures[0].coverage == 1, free=False)


def lights_figure(lights: Sequence[LightPair]) -> str:
    """Both sides of the first few lightings as maps on one scale, as a data URL."""
    entries = []
    for pair in lights[:_MAX_LIGHTS]:
        for side, entry, factor in (("A", pair.first, np.ones(3)), ("B", pair.second, pair.factor)):
            lighting = entry.lighting
            radiance = lighting.radiance_map
            scaled = None if radiance is None else radiance * np.maximum(factor, 0).astype(np.float32)
            shown = replace(lighting, name=f"{side}: {lighting.name}", radiance_map=scaled)
            entries.append(FittedLighting(shown, np.zeros_like(lighting.irradiances), None, None))
    return figure_url(lighting_figure(entries))


def _shares(brdf: Microfacet) -> Microfacet:
    total = brdf.kd + brdf.ks
    total = np.where(total > 0, total, 1.0)
    return replace(brdf, kd=brdf.kd / total, ks=brdf.ks / total)


def _panel(
    heading: str, one: Floats, other: Floats, inside: NDArray[np.bool_], free: bool
) -> ComparisonPanel:
    if free:
        power = (other[inside] ** 2).sum(axis=0)
        other = other * (one[inside] * other[inside]).sum(axis=0) / np.where(power > 0, power, 1)
    rows, columns = np.nonzero(inside)
    crop = np.s_[max(rows.min() - 2, 0) : rows.max() + 3, max(columns.min() - 2, 0) : columns.max() + 3]
    one, other, inside = one[crop], other[crop], inside[crop]
    white = white_level(one[inside])
    apart = (other - one)[inside]
    level = np.sqrt((one[inside] ** 2).mean())
    rms = float(np.sqrt((apart**2).mean()) / level) if level > 0 else 0.0
    limit = next((limit for limit in _LIMITS if limit >= 3 * rms), _LIMITS[-1])
    return ComparisonPanel(
        heading,
        image_url(shrunk(tone_mapped(one, white)), jpeg=True),
        image_url(shrunk(tone_mapped(other, white)), jpeg=True),
        image_url(shrunk(difference_picture((other - one).mean(axis=2), limit * white, inside))),
        rms,
        limit,
    )
