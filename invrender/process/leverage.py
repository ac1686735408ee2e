"""How informative pixels are about a BRDF under known light: the leverage by which samples are drawn.

A narrow highlight is a handful of pixels, and all that is seen of the lobe's width. Samples are drawn by leverage: how
far the numbers of a first fit would move if a pixel's radiance did, in standard deviations of both. It holds the
gradient of the predicted radiance, as RMB07's gradient-based sampling does (section 6), in the numbers that are looked
for.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from capture.lighting import Lighting
from capture.photoset import PhotoSet
from capture.progress import silent
from invrender.brdf.form import Angles
from invrender.brdf.lobes import GGX_FORM
from invrender.estimate.linear import symmetric_pinv
from invrender.estimate.noise import NoiseModel
from invrender.estimate.search import fit, models_of
from invrender.estimate.statistics import total_statistics
from invrender.estimate.weighing import weigh
from invrender.observation.clock import Clock
from invrender.observation.geometry import SceneGeometry
from invrender.observation.samples import read_samples
from invrender.transport.columns import PhotoColumns, all_columns
from invrender.transport.transfer import LightElement, diffuse_transfer, light_elements
from recon.sampling.draw import Importance

Floats = NDArray[np.float64]

# The first fit's photographs, and the samples of each; under a map, which takes long, fewer.
_PHOTOS, _SAMPLES, _SAMPLES_OF_MAPS = 8, 500, 60
# Widths that are looked for before anything is known.
_WIDTHS = (0.01, 0.03, 0.1)
# Step in the logarithm of the width, and sources of a lighting that count, the strongest.
_STEP, _SOURCES = 0.1, 16


def importances(
    photoset: PhotoSet, geometry: SceneGeometry, lightings: Mapping[str, Lighting], clock: Clock
) -> dict[str, Importance]:
    """How informative pixels are, by the name of the lighting; none for one without directional sources.

    From a first fit to a few photographs; what these are under has its leverage, the rest what the same fit predicts.
    """
    # What is drawn where may go by light from afar: what each sample stands for makes up for it.
    elements = {name: light_elements(lighting.from_afar) for name, lighting in lightings.items()}
    lit = {name: own for name, own in elements.items() if any(len(e.directions) for e in own)}
    fitted = [photo for photo in photoset.photos if not photo.held_out and photo.lighting in lit]
    if not fitted:
        return {}
    chosen = [fitted[k] for k in np.unique(np.linspace(0, len(fitted) - 1, _PHOTOS).round().astype(int))]
    few = replace(photoset, photos=tuple(chosen))
    sources = {name: lighting.sources for name, lighting in lightings.items()}
    narrow = {name: Importance(_AtAnyWidth(own)) for name, own in lit.items()}
    mapped = any(element.slow_map is not None for photo in chosen for element in lit[photo.lighting])
    samples = (_SAMPLES_OF_MAPS if mapped else _SAMPLES) * len(chosen)
    fields, _ = read_samples(few, geometry.found, sources, samples, clock, silent, narrow)
    with clock.on("invrender"):
        photos = all_columns(
            [photo.lighting for photo in chosen],
            {name: light_elements(lighting) for name, lighting in lightings.items()},
            [fields[photo.label] for photo in chosen],
            GGX_FORM,
            geometry.shadows,
        )
        first = _first_fit(photos, elements)
    return {name: Importance(_Leverage(first, own), first.sigma) for name, own in lit.items()}


@dataclass(frozen=True, eq=False)
class _FirstFit:
    """A first fit, means over channels, and the covariance (3, 3) of Kd, Ks and the logarithm of sigma."""

    kd: float
    ks: float
    sigma: float
    noise: NoiseModel
    covariance: Floats


@dataclass(frozen=True, eq=False)
class _Leverage:
    """How informative pixels are under a lighting: the leverage that a first fit says."""

    first: _FirstFit
    elements: Sequence[LightElement]

    def __call__(self, normals: Floats, views: Floats) -> Floats:
        rows, radiance = _gradient(self.first, self.elements, normals, views)
        return np.einsum("np,pq,nq->n", rows, self.first.covariance, rows) / self.first.noise.variance(
            radiance
        )


def _first_fit(photos: Sequence[PhotoColumns], elements: Mapping[str, Sequence[LightElement]]) -> _FirstFit:
    model = models_of(GGX_FORM)[0]
    noise, weights = weigh(photos, model)
    brdf = fit(model, total_statistics(photos, [own.weight for own in weights])).brdf
    assert brdf.sigma is not None
    means = float(brdf.kd.mean()), float(brdf.ks.mean()), brdf.sigma
    first = _FirstFit(*means, noise, np.eye(3))
    information = np.zeros((3, 3))
    for photo in photos:
        field = photo.field
        mean = field.sample_normals, np.asarray(field.mean_over_rays(field.views))
        normals, views = (each / np.linalg.norm(each, axis=1, keepdims=True) for each in mean)
        rows, radiance = _gradient(first, elements[photo.lighting], normals, views)
        weight = field.shares / noise.variance(radiance)
        information += rows.T @ (weight[:, None] * rows)
    return replace(first, covariance=symmetric_pinv(information))


def _gradient(
    first: _FirstFit, elements: Sequence[LightElement], normals: Floats, views: Floats
) -> tuple[Floats, Floats]:
    """Slopes (n, 3) of radiance in Kd, Ks and the logarithm of sigma, mean over channels, and the radiance (n,).

    Highlights are those of sources; what a map reflects varies slowly.
    """
    rows = np.zeros((len(normals), 3))
    for element in elements:
        rows[:, 0] += diffuse_transfer(element, normals).mean(axis=1)
        for lobe in _lobes(element, normals, views, first.sigma):
            rows[:, 1:] += lobe
    radiance = first.kd * rows[:, 0] + first.ks * rows[:, 1]
    rows[:, 2] *= first.ks
    return rows, radiance


def _lobes(element: LightElement, normals: Floats, views: Floats, sigma: float) -> list[Floats]:
    """For each of an element's sources a lobe's radiance and its slope in the logarithm of sigma, (n, 2)."""
    strength = element.irradiances.mean(axis=1)
    found = []
    for k in np.argsort(-strength)[:_SOURCES]:
        angles = Angles.between(normals, element.directions[k], views)
        at = [GGX_FORM.shape(angles, sigma * np.exp(way)) for way in (0, -_STEP, _STEP)]
        found.append(strength[k] * np.stack([at[0], (at[2] - at[1]) / (2 * _STEP)], axis=-1))
    return found


@dataclass(frozen=True, eq=False)
class _AtAnyWidth:
    """How informative pixels are on highlights of any width, where only the light's directions are known."""

    elements: Sequence[LightElement]

    def __call__(self, normals: Floats, views: Floats) -> Floats:
        total = np.zeros(len(normals))
        for sigma in _WIDTHS:
            lobes = [lobe for element in self.elements for lobe in _lobes(element, normals, views, sigma)]
            slope = np.abs(sum(lobe[:, 1] for lobe in lobes))
            total += slope / max(float(slope.sum()), 1e-300)
        return total
