"""Candidate reflections, compared by photographs that their fits have not seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture.parallel import one_blas_thread, parallel_map
from capture.progress import Track, silent
from capture.selection import simplest
from invrender.brdf.form import LobeForm
from invrender.brdf.lobes import BECKMANN, GGX_FORM, PLASTICS
from invrender.brdf.richer import COATED, COATED_HAZY
from invrender.photometric_stereo.joint import fit_shared
from invrender.photometric_stereo.shading import SharedReflection
from invrender.photometric_stereo.stack import PixelStack, PixelSurface
from invrender.photometric_stereo.weights import error_of_loss, robust_weights, scales

Floats = NDArray[np.float64]
# Lambertian first; lobes above a Lambertian base, under an interface, on a coated base, and with a haze.
FORMS: tuple[LobeForm | None, ...] = (
    None,
    GGX_FORM,
    PLASTICS[GGX_FORM],
    PLASTICS[BECKMANN],
    COATED[GGX_FORM],
    COATED_HAZY[GGX_FORM],
)
# Photographs from which on residuals tell a lobe from shadows and noise.
FEWEST_FOR_A_LOBE = 6
# Photographs are left out by so many turns. Fits: how often the scales are renewed, and steps in between.
_FOLDS = 4
_RENEWALS, _STEPS = 3, 10
# Forms whose error on unseen photographs is at most this many times the chosen one's are as likely the truth: all are
# wrong, then, by more than they differ.
_ALTERNATIVE = 1.15
_FIRST_SIGMA, _FIRST_KS, _FIRST_AMBIENT = 0.15, 0.01, 0.01


@dataclass(frozen=True, eq=False)
class StereoModel:
    """A candidate: its reflection as fitted to all photographs, and its loss (j,) on each while it was left out."""

    reflection: SharedReflection
    losses: Floats

    @property
    def name(self) -> str:
        return "Lambertian" if self.reflection.form is None else self.reflection.form.name

    @property
    def error(self) -> float:
        """Typical error on unseen photographs, of the prediction: RMS, robust."""
        return error_of_loss(float(self.losses.mean()))


def first_reflection(form: LobeForm | None) -> SharedReflection:
    """A reflection of a form to start a fit from."""
    ks = np.full(3, _FIRST_KS if form is not None else 0.0)
    return SharedReflection(form, _FIRST_SIGMA, ks, _FIRST_AMBIENT)


def fit_renewed(
    reflection: SharedReflection, surface: PixelSurface, stack: PixelStack, floor: float, turning: bool
) -> tuple[SharedReflection, PixelSurface]:
    """`joint.fit_shared`, its scales renewed a few times."""
    for _ in range(_RENEWALS):
        reflection, surface = fit_shared(reflection, surface, stack, floor, _STEPS, turning)
    return reflection, surface


def compare_forms(
    surface: PixelSurface, stack: PixelStack, floor: float, turning: bool = True, track: Track = silent
) -> list[StereoModel]:
    """All candidates, fitted to some pixels and scored on photographs that were left out.

    surface : to start from. With fewer than six photographs only the Lambertian one: a lobe takes more.
    """
    forms = FORMS if stack.photos >= FEWEST_FOR_A_LOBE else FORMS[:1]

    def scored(form: LobeForm | None) -> StereoModel:
        return _scored(first_reflection(form), surface, stack, floor, turning)

    with one_blas_thread():
        return list(parallel_map(scored, track(list(forms), "Comparing lobes on unseen photographs")))


def _scored(
    first: SharedReflection, surface: PixelSurface, stack: PixelStack, floor: float, turning: bool
) -> StereoModel:
    reflection, fitted = fit_renewed(first, surface, stack, floor, turning)
    photos = np.arange(stack.photos)
    losses = np.zeros(stack.photos)
    # Of the photographs themselves, so that they are the same for all candidates.
    squares = scales(stack, stack.reflected.clip(0), floor)
    for fold in range(_FOLDS):
        left_out = photos % _FOLDS == fold
        if not left_out.any():
            continue
        seen = stack.of_photos(photos[~left_out])
        without, pixels = fit_shared(reflection, fitted, seen, floor, _STEPS, turning)
        unseen = stack.of_photos(photos[left_out])
        predicted = without.predicted(pixels, unseen)
        _, loss = robust_weights(unseen, predicted, squares[:, left_out])
        losses[left_out] = loss.sum(axis=0) / np.maximum(unseen.usable.sum(axis=0), 1)
    return StereoModel(reflection, losses)


def choose_form(models: Sequence[StereoModel]) -> tuple[StereoModel, list[StereoModel]]:
    """The simplest of the candidates that predict best, and those that may be the truth as well."""
    sizes = [len(model.reflection.numbers) + 3 * (model.reflection.form is not None) for model in models]
    chosen = models[simplest([model.losses for model in models], sizes)]
    others = [model for model in models if model is not chosen and model.error <= _ALTERNATIVE * chosen.error]
    return chosen, others
