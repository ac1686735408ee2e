"""What a textured fit says of its numbers: in the terms of one BRDF, whose Kd and Ks are the texture's means."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from capture.lighting import Lighting
from capture.photoset import PhotoSet
from invrender.brdf.microfacet import Microfacet
from invrender.estimate.clusters import structured_share
from invrender.estimate.identifiability import Scalar, assess_linear, assess_mu, assess_sigma, lighting_degree
from invrender.estimate.noise import photo_weights
from invrender.estimate.quantities import FittedLighting, Quantity, scaled
from invrender.estimate.solution import Solution, unexplained, unless_misfit
from invrender.estimate.textured.fit import TexturedFit
from invrender.estimate.textured.textures import FittedTextures
from invrender.estimate.uncertainty import NUMERICAL
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]


def textured_solution(
    photoset: PhotoSet,
    lightings: Mapping[str, Lighting],
    fit: TexturedFit,
    textures: FittedTextures,
    fields: Mapping[str, LightField],
    residuals: Mapping[str, Floats],
    unsure: Mapping[str, Floats],
    moved: Mapping[str, Floats],
) -> Solution:
    """The solution in the terms of those of one BRDF: Kd and Ks are means over the surface.

    fields, residuals : of each photograph by its label, samples where the texture is known, and what is left of them.
    unsure : by cause, (6,), the shares of themselves by which Kd and Ks are uncertain all over, besides. moved : by
    cause, as of `moved_by_calibration`.
    """
    labels = [photo.label for photo in photoset.fitted]
    left = [residuals[label] for label in labels]
    weights = [
        photo_weights(fit.noise, fields[label].radiance - residuals[label], residuals[label])
        for label in labels
    ]
    trusted = [np.sqrt(own.trust) * residual for own, residual in zip(weights, left, strict=True)]
    structured = structured_share([fields[label] for label in labels], trusted)
    candidate = fit.candidates[fit.chosen]
    kd, ks = textures.mean(textures.kd), textures.mean(textures.ks)
    estimate = replace(candidate.estimate, brdf=replace(fit.brdf, kd=kd, ks=ks))
    candidates = tuple(
        replace(r, estimate=estimate) if k == fit.chosen else r for k, r in enumerate(fit.candidates)
    )
    found = _Numbers.of(fit, textures, estimate.brdf, structured, unsure, moved)
    return Solution(
        estimate=estimate,
        candidates=candidates,
        chosen=fit.chosen,
        noise=fit.noise,
        weights=tuple(weights),
        structured=structured,
        quantities=unless_misfit(found.quantities(lightings, fields), candidate.error),
        lightings=tuple(
            FittedLighting(lighting, np.zeros_like(lighting.irradiances), None, None)
            for lighting in lightings.values()
        ),
        covariance=found.covariance,
        covariance_names=found.names,
        gauge="absolute: the given lighting fixes the scale of Kd and Ks in each channel",
    )


@dataclass(frozen=True, eq=False)
class _Numbers:
    """Sigma and mu, as far as a fit has them, mean Kd and, of a specular one, mean Ks.

    values : (p,), with their names. parts : by cause, (p, p), what makes up their covariance. fragility : of sigma and
    mu, as of `Scalar`.
    """

    brdf: Microfacet
    names: tuple[str, ...]
    values: Floats
    parts: Mapping[str, Floats]
    fragility: Floats

    @classmethod
    def of(
        cls,
        fit: TexturedFit,
        textures: FittedTextures,
        mean: Microfacet,
        structured: float,
        unsure: Mapping[str, Floats],
        moved: Mapping[str, Floats],
    ) -> _Numbers:
        """Of textures with these means; unsure, moved : as of `textured_solution`.

        Whatever is structured in the residuals counts as a share of each number, as of one BRDF.
        """
        found = {"sigma": mean.sigma, "mu": mean.mu}
        scalars = {name: number for name, number in found.items() if number is not None}
        none, linear = np.zeros(len(scalars)), np.concatenate([mean.kd, mean.ks])
        values = np.concatenate([list(scalars.values()), linear])
        # The search's coordinates are logarithms, of mu - 1 in the case of mu.
        spans = np.concatenate([[own - (name == "mu") for name, own in scalars.items()], np.ones(6)])
        ks_std = textures.mean_std(textures.ks_std) if textures.ks_varies else fit.common_ks_std
        means_std = np.concatenate([textures.mean_std(textures.kd_std), ks_std])
        sizes = np.concatenate([list(scalars.values()), *[mean.kd + mean.ks] * 2])
        six = np.zeros((6, 6))
        parts = {
            cause: block_diag(own, six) * np.outer(spans, spans) for cause, own in fit.covariances.items()
        }
        parts["noise"] = parts["noise"] + np.diag(np.concatenate([none, means_std]) ** 2)
        parts["misfit"] = parts["misfit"] + np.diag((np.hypot(structured, NUMERICAL) * sizes) ** 2)
        for cause, shares in unsure.items():
            parts[cause] = np.diag(np.concatenate([none, shares * linear]) ** 2)
        stated = {cause: own @ own.T * np.outer(spans, spans) for cause, own in moved.items()}
        names = (*scalars, *(f"{name}.{channel}" for name in ("kd", "ks") for channel in "rgb"))
        # A matte model has no lobe.
        kept = len(names) if fit.model.specular else 3
        whole = {**unexplained(parts, stated), **stated}
        parts = {cause: own[:kept, :kept] for cause, own in whole.items()}
        return cls(mean, names[:kept], values[:kept], parts, spans[: len(scalars)] * fit.fragility)

    @cached_property
    def covariance(self) -> Floats:
        return np.asarray(sum(self.parts.values()))

    def quantities(
        self, lightings: Mapping[str, Lighting], fields: Mapping[str, LightField]
    ) -> dict[str, Quantity]:
        """What is reported; fields : as of `textured_solution`."""
        mean, count = self.brdf, len(self.fragility)
        scale = mean.kd + mean.ks
        each = np.eye(len(self.names))
        by_kd, by_ks = each[count : count + 3], each[count + 3 :]
        quantities = {"kd": self._split(by_kd, partial(assess_linear, mean.kd, scale=scale, name="Kd"))}
        quantities["albedo"] = scaled(quantities["kd"], np.pi)
        if len(self.names) == 3:
            return quantities
        quantities["ks"] = self._split(by_ks, partial(assess_linear, mean.ks, scale=scale, name="Ks"))
        total = np.where(scale > 0, scale, 1)
        # Of the two shares one falls by as much as the other rises.
        by_share = (mean.ks[:, None] * by_kd - mean.kd[:, None] * by_ks) / total[:, None] ** 2
        for name, own in (("kd", mean.kd), ("ks", mean.ks)):
            judged = partial(assess_linear, own / total, scale=np.ones(3), name=name.capitalize())
            quantities[f"{name}_normalised"] = self._split(by_share, judged)
        ks_share, degree = float(np.mean(mean.ks / total)), lighting_degree(list(lightings.values()))
        judges = {
            "sigma": lambda scalar: assess_sigma(scalar, degree, ks_share),
            "mu": lambda scalar: assess_mu(scalar, list(fields.values()), ks_share),
        }
        for k, name in enumerate(self.names[:count]):
            place = float(self.values[k]), float(self.fragility[k])
            judged = partial(_assessed_scalar, judges[name], *place)
            quantities[name] = self._split(each[k : k + 1], judged)
        return quantities

    def _split(self, way: Floats, assessed: Callable[[Floats], Quantity]) -> Quantity:
        """What `assessed` makes of a standard deviation, of combinations (q, p) of the numbers, with what causes it."""
        variances = {cause: np.diag(way @ own @ way.T) for cause, own in self.parts.items()}
        std = np.sqrt(np.maximum(sum(variances.values()), 0))
        return assessed(std).with_shares(variances)


def _assessed_scalar(
    judge: Callable[[Scalar], Quantity], value: float, fragility: float, std: Floats
) -> Quantity:
    return judge(Scalar(value, float(std[0]), fragility))
