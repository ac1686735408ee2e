"""Brushed forms beside isotropic ones: tried where residuals say that one tangent has another width than the other.

Two widths take too many columns for the whole range of both. Columns hold a window of them (`transport.column_basis`),
which is moved until the best fit lies well within it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.brushed import FACETS, Brushed, brushed, window_about
from invrender.brdf.form import Axis, LobeForm
from invrender.brdf.microfacet import Microfacet
from invrender.brdf.smith import Smith
from invrender.estimate.jacobian import jacobians, pack
from invrender.estimate.linear import symmetric_pinv
from invrender.estimate.models import Estimate
from invrender.estimate.noise import Weights
from invrender.estimate.search import fit, models_of
from invrender.estimate.statistics import total_statistics
from invrender.transport.columns import Elements, PhotoColumns, columns_of, pooled_columns, sample_count
from invrender.transport.predict import predict, predict_photos

Floats = NDArray[np.float64]

# Samples on which a stretch is looked for, to the first order, and then searched for.
_SAMPLES, _SEARCHED = 300, 800
# Of the logarithm of the stretch, for slopes.
_STEP = 0.05
# The share of the cost that a stretch must take away, to the first order, and its least logarithm, for it to be tried.
_PAYS, _LEAST = 0.1, 0.03
# Radius of the object over the distance of sources, for slopes.
_NEARNESS = 0.02
# How often a window is moved at most.
_MOST_MOVES = 10
# Half the width of windows in the logarithms of sigma and stretch: of searches, and of fits to all samples.
_REACH, _NARROW = (0.35, 0.6), (0.2, 0.2)


def try_brushed(
    photos: Sequence[PhotoColumns],
    weights: Sequence[Weights],
    elements: Elements,
    isotropic: Mapping[LobeForm, Estimate],
    columns: Mapping[LobeForm, Sequence[PhotoColumns]],
    axis: Axis,
) -> dict[LobeForm, list[PhotoColumns]]:
    """Columns of forms of facets, brushed about an axis; none where isotropic forms leave no sign of two widths.

    photos : of RH01's form. isotropic : the fits of isotropic forms, and columns of the same samples in these forms.
    """
    facets = [form for form in FACETS if form in isotropic]
    if not facets:
        return {}
    of = min(facets, key=lambda form: isotropic[form].cost)
    first = isotropic[of]
    assert first.brdf.sigma is not None
    stretch = first_stretch(columns[of], weights, elements, first, axis)
    if stretch is None:
        return {}
    start = brushed(of, axis, window_about(first.brdf.sigma, stretch, _REACH))
    window = _searched(start, photos, weights, elements).window
    return columns_of([brushed(form, axis, window) for form in facets], photos, elements)


def narrowed(form: Brushed, brdf: Microfacet) -> Brushed:
    """A form whose window holds little but the neighbourhood of a BRDF that was found with it, for many samples."""
    return form.around(*_widths(brdf), _NARROW)


def first_stretch(
    photos: Sequence[PhotoColumns],
    weights: Sequence[Weights],
    elements: Elements,
    isotropic: Estimate,
    axis: Axis,
) -> float | None:
    """The stretch that residuals of an isotropic form of facets ask for, to the first order; None where they don't.

    photos : columns of the form. The other numbers are free to follow. None, too, where sources nearer than given
    explain more: these draw highlights out along one tangent as well, and two widths take long to search for.
    """
    gained = stretch_gain(photos, weights, elements, isotropic, axis)
    if gained.share < _PAYS or abs(gained.step) < _LEAST:
        return None
    near = nearness_gain(photos, weights, elements, isotropic)
    if near.step > 0 and near.share > gained.share:
        return None
    return float(np.exp(np.clip(gained.step, -_REACH[1], _REACH[1])))


@dataclass(frozen=True)
class Gain:
    """The share of the cost that one more number would take away, and how far it would go, to the first order."""

    share: float
    step: float


def stretch_gain(
    photos: Sequence[PhotoColumns],
    weights: Sequence[Weights],
    elements: Elements,
    isotropic: Estimate,
    axis: Axis,
) -> Gain:
    """What a stretch about an axis would gain beside an isotropic fit, in its logarithm."""
    of = isotropic.brdf.form
    assert isinstance(of, Smith)
    ends = [
        replace(
            isotropic.brdf, kd=np.zeros(3), form=brushed(of, axis).with_numbers({"stretch": np.exp(step)})
        )
        for step in (-_STEP, _STEP)
    ]

    def slope(photo: PhotoColumns) -> Floats:
        light = elements[photo.lighting], isotropic.strengths[photo.lighting]
        less, more = (predict(end, *light, photo.field, photo.shadows) for end in ends)
        return np.asarray((more - less) / (2 * _STEP))

    return _gain(*_thinned(photos, weights, _SAMPLES), isotropic, slope)


def nearness_gain(
    photos: Sequence[PhotoColumns], weights: Sequence[Weights], elements: Elements, isotropic: Estimate
) -> Gain:
    """What sources nearer than given would gain beside an isotropic fit, all at one closeness, 1/m."""
    thin, weighed = _thinned(photos, weights, _SAMPLES)
    places = np.concatenate([photo.field.positions for photo in thin])
    centre = places.mean(axis=0)
    step = _NEARNESS / float(np.linalg.norm(places - centre, axis=1).max())

    def slope(photo: PhotoColumns) -> Floats:
        given = elements[photo.lighting]
        ends = (given, [element.nearer(step, centre) for element in given])
        strengths = isotropic.strengths[photo.lighting]
        far, near = (predict(isotropic.brdf, end, strengths, photo.field, photo.shadows) for end in ends)
        return np.asarray((near - far) / step)

    return _gain(thin, weighed, isotropic, slope)


def _gain(
    photos: Sequence[PhotoColumns],
    weights: Sequence[Floats],
    isotropic: Estimate,
    slope: Callable[[PhotoColumns], Floats],
) -> Gain:
    """What a number of which each sample's radiance has a slope (n, 3) would gain, all others free to follow."""
    parameters = pack(isotropic, {photo.lighting: photo.elements for photo in photos})
    size = len(parameters.vector)
    gram, right, cost = np.zeros((size + 1, size + 1)), np.zeros(size + 1), 0.0
    predictions = predict_photos(photos, isotropic.brdf, isotropic.strengths)
    for photo, weight, predicted in zip(photos, weights, predictions, strict=True):
        slopes, residual = slope(photo), photo.radiance - predicted
        for c, jacobian in enumerate(jacobians(photo, parameters, isotropic)):
            rows = np.column_stack([jacobian, slopes[:, c]])
            weighted = rows * weight[:, c, None]
            gram += weighted.T @ rows
            right += weighted.T @ residual[:, c]
            cost += float(weight[:, c] @ residual[:, c] ** 2)
    # The number alone, what the others would make up for taken off.
    others = symmetric_pinv(gram[:-1, :-1])
    alone = max(float(gram[-1, -1] - gram[-1, :-1] @ others @ gram[:-1, -1]), 1e-300)
    pull = float(right[-1] - gram[-1, :-1] @ others @ right[:-1])
    rest = max(cost - float(right[:-1] @ others @ right[:-1]), 1e-300)
    return Gain(pull**2 / alone / rest, pull / alone)


def in_window(form: Brushed, brdf: Microfacet) -> bool:
    """Whether a BRDF that was found with a form lies well within its window."""
    return form.holds(*_widths(brdf))


def _searched(
    form: Brushed, photos: Sequence[PhotoColumns], weights: Sequence[Weights], elements: Elements
) -> Brushed:
    """The form with a window that its best fit to some of the samples lies well within."""
    thin, weighed = _thinned(photos, weights, _SEARCHED)
    for _ in range(_MOST_MOVES):
        columns = columns_of((form,), thin, elements)[form]
        widths = _widths(fit(models_of(form)[-1], total_statistics(columns, weighed)).brdf)
        settled, form = form.holds(*widths), form.around(*widths, _REACH)
        if settled:
            break
    return form


def _thinned(
    photos: Sequence[PhotoColumns], weights: Sequence[Weights], samples: int
) -> tuple[list[PhotoColumns], list[Floats]]:
    """About so many of the samples, evenly, and their weights; photographs under one lighting as one."""
    stride = -(-sample_count(photos) // samples)
    kept = [np.arange(len(photo.field)) % stride == 0 for photo in photos]
    thin = [photo.where(own) for photo, own in zip(photos, kept, strict=True)]
    weighed = [weight.weight[own] for weight, own in zip(weights, kept, strict=True)]
    # Each photograph has few: a map's integral takes as long for a few rays as for many.
    found = list(pooled_columns(thin, weighed))
    return [photo for photo, _ in found], [weight for _, weight in found]


def _widths(brdf: Microfacet) -> tuple[float, float]:
    assert brdf.sigma is not None
    return brdf.sigma, brdf.form.numbers["stretch"]
