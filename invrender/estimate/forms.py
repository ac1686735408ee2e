"""Forms of the specular part, tried on a share of the samples beside RH01's own.

What a form is worth shows in its error on unseen photographs less RH01's on the same samples; added to RH01's on all
samples it stands in one ladder with the other models. The share holds more of the samples that RH01's form explains
badly: there forms differ. Where two forms differ by a share of the noise too small for so few, numbers differ by less
than their error bars hold.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from capture.progress import OnStep, unwatched
from invrender.brdf.form import Axis, LobeForm
from invrender.brdf.lobes import RH01_FORM, UNCORRELATED
from invrender.brdf.richer import Richer, extended, tabulated
from invrender.brdf.smith import Smith
from invrender.estimate.brushed import try_brushed
from invrender.estimate.evidence import Candidate, climb_ladder, patches_of, unseen_on
from invrender.estimate.models import Estimate, Model
from invrender.estimate.noise import Weights
from invrender.estimate.search import OTHER_FORMS, fit, models_of
from invrender.estimate.statistics import total_statistics
from invrender.estimate.weighing import some_samples, weigh
from invrender.transport.columns import Elements, PhotoColumns, columns_of, sample_count
from invrender.transport.predict import predict_photos

# Two forms that differ by a tenth of the noise are three standard errors apart on 1500; of a highlight twice as many
# tell its flanks apart.
_SAMPLES = 3000
# Variances of the noise by which the cost must fall for a form of more numbers to be tried: three standard deviations.
_DECISIVE = 9.0
# Fits whose widths differ by less than this factor lie in one minimum.
_ALIKE = 1.5
# Times the least cost up to which facets that hide light and viewer apart are tried beside those that do it together.
_NEAR = 2.0


@dataclass(frozen=True, eq=False)
class FormTrial:
    """Models of one form, fitted to a share of the samples.

    candidates : their evidence on the share. photos, weights : the share. patches : of the surface, as of
    `climb_ladder`.
    """

    candidates: tuple[Candidate, ...]
    photos: tuple[PhotoColumns, ...]
    weights: tuple[Weights, ...]
    patches: NDArray[np.int64]

    @classmethod
    def of(
        cls,
        form: LobeForm,
        photos: Sequence[PhotoColumns],
        weights: Sequence[Weights],
        patches: NDArray[np.int64],
        near: Estimate | None = None,
    ) -> FormTrial:
        """A form's models, fitted to columns of it; near : the richest, with nearly the same weights."""
        ladder = climb_ladder(photos, weights, models=models_of(form), patches=patches, near=near)
        return cls(ladder, tuple(photos), tuple(weights), patches)

    def judged(self, candidate: Candidate) -> Candidate:
        """The richest candidate of the form, which was fitted to all samples, as the share shows it.

        That is the fit to the share, which has what weighs in others too. A narrow and a wide lobe may cost nearly the
        same, though: where the fit to the share lies in another minimum, it is the candidate by its errors there.
        """
        own = self.candidates[-1]
        width, other = own.estimate.brdf.sigma, candidate.estimate.brdf.sigma
        if width is None or other is None or 1 / _ALIKE < width / other < _ALIKE:
            return own
        return unseen_on(candidate, self.photos, self.weights, self.patches)

    def candidate_like(self, model: Model) -> Candidate:
        """The candidate with a Fresnel factor if a model, of any form and colour, has one and this form too."""
        return next(
            (r for r in self.candidates if r.estimate.model.fresnel == model.fresnel), self.candidates[-1]
        )


def try_forms(
    photos: Sequence[PhotoColumns],
    weights: Sequence[Weights],
    elements: Elements,
    first: Estimate,
    on_step: OnStep = unwatched,
    axis: Axis | None = None,
) -> dict[LobeForm, FormTrial]:
    """Forms, RH01's among them, on the same share of the samples; photos are columns of RH01's, `first` its best fit.

    Beside `OTHER_FORMS` those that the best of facets extends to, where they fit better, and the same with light
    and viewer hidden apart. axis : that the surface would be brushed about; then facets with two widths, too, where
    residuals ask for them. The noise is read off the residuals of the form that fits best: what another misses is no
    noise. `on_step` is called `len(OTHER_FORMS)` times at most.
    """
    share, weighed = _share(photos, weights, first)
    columns: dict[LobeForm, list[PhotoColumns]] = {RH01_FORM: share}
    single = [form for form in OTHER_FORMS if isinstance(form, Smith)]
    # Made of the same lobes, they share their columns.
    richer = {form: (*extended(form), *tabulated(form)) for form in single}
    for group in together((*OTHER_FORMS, *chain.from_iterable(richer.values()))):
        columns |= columns_of(group, share, elements)
        on_step()

    def fits_of(forms: Iterable[LobeForm]) -> dict[LobeForm, Estimate]:
        return {form: _fitted(models_of(form)[-1], columns[form], weighed) for form in forms}

    found = fits_of((RH01_FORM, *OTHER_FORMS))

    def cost(form: LobeForm) -> float:
        return found[form].cost

    facets, isotropic = min(single, key=cost), dict(found)
    decisive = min(map(cost, found)) * (1 - _DECISIVE / (3 * sample_count(share)))
    found |= {form: fitted for form, fitted in fits_of(richer[facets]).items() if fitted.cost < decisive}
    if cost(facets) < _NEAR * min(map(cost, found)):
        apart = UNCORRELATED[facets]
        columns |= columns_of((apart,), share, elements)
        found |= fits_of((apart,))
    if axis is not None:
        more = try_brushed(share, weighed, elements, isotropic, columns, axis)
        columns |= more
        found |= fits_of(more)
    best = min(found, key=cost)
    own = weigh(columns[best], models_of(best)[-1], weighed)[1]
    patches = patches_of(photos)
    return {
        form: FormTrial.of(form, columns[form], own, patches, found[form])
        for form in columns
        if form in found
    }


def _fitted(model: Model, photos: Sequence[PhotoColumns], weights: Sequence[Weights]) -> Estimate:
    return fit(model, total_statistics(photos, [w.weight for w in weights]))


def together(forms: Sequence[LobeForm]) -> list[tuple[LobeForm, ...]]:
    """Forms in groups whose columns are made at once: those of facets, which reflect the same rays; each other one."""
    facets = tuple(form for form in forms if isinstance(form, Smith | Richer))
    others: list[tuple[LobeForm, ...]] = [(form,) for form in forms if form not in facets]
    return [facets, *others] if facets else others


def beside(reference: Candidate, tried: Candidate, own: Candidate) -> Candidate:
    """A candidate tried on a share of the samples as it would be on all.

    reference : of another model, on all samples. own : the same model on the share.
    """
    squares = reference.photo_errors**2 + tried.photo_errors**2 - own.photo_errors**2
    return replace(
        tried,
        # Where the share's noise says that nothing is left, a tenth is.
        photo_errors=np.sqrt(np.maximum(squares, 0.01 * reference.photo_errors**2)),
        patch_energy=reference.patch_energy + tried.patch_energy - own.patch_energy,
    )


def _share(
    photos: Sequence[PhotoColumns], weights: Sequence[Weights], first: Estimate
) -> tuple[list[PhotoColumns], list[Weights]]:
    """The samples to try forms on and their weights: half drawn evenly, half by what a first fit leaves of them."""
    predictions = predict_photos(photos, first.brdf, first.strengths)
    left = [
        (own.trust * (photo.radiance - predicted) ** 2).sum(axis=1)
        for photo, own, predicted in zip(photos, weights, predictions, strict=True)
    ]
    return some_samples(photos, weights, left, _SAMPLES)
