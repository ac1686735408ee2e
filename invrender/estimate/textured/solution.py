"""What a textured fit says of its numbers: in the terms of one BRDF, whose Kd and Ks are the texture's means."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from capture.lighting import Lighting
from capture.photoset import PhotoSet
from invrender.brdf.microfacet import Microfacet
from invrender.estimate.clusters import structured_share
from invrender.estimate.identifiability import Scalar, assess_linear, assess_mu, assess_sigma, lighting_degree
from invrender.estimate.noise import photo_weights
from invrender.estimate.quantities import FittedLighting, Quantity, scaled
from invrender.estimate.solution import Solution, unless_misfit
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
    unsure: Floats,
) -> Solution:
    """The solution in the terms of those of one BRDF: Kd and Ks are means over the surface.

    fields, residuals : of each photograph by its label, samples where the texture is known, and what is left of them.
    unsure : (6,), the shares of themselves by which Kd and Ks are uncertain all over, besides.
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
    quantities, names, std = _quantities(lightings, fit, textures, fields, estimate.brdf, structured, unsure)
    return Solution(
        estimate=estimate,
        candidates=candidates,
        chosen=fit.chosen,
        noise=fit.noise,
        weights=tuple(weights),
        structured=structured,
        quantities=unless_misfit(quantities, candidate.error),
        lightings=tuple(
            FittedLighting(lighting, np.zeros_like(lighting.irradiances), None, None)
            for lighting in lightings.values()
        ),
        covariance=np.diag(std**2),
        covariance_names=names,
        gauge="absolute: the given lighting fixes the scale of Kd and Ks in each channel",
    )


def _quantities(
    lightings: Mapping[str, Lighting],
    fit: TexturedFit,
    textures: FittedTextures,
    fields: Mapping[str, LightField],
    mean: Microfacet,
    structured: float,
    unsure: Floats,
) -> tuple[dict[str, Quantity], tuple[str, ...], Floats]:
    """What is reported, and names and standard deviations of the BRDF's numbers.

    Whatever is structured in the residuals counts as a share of each number, as of one BRDF.
    """
    share = np.hypot(structured, NUMERICAL)
    scale = mean.kd + mean.ks

    def of_mean(deviations: Floats) -> Floats:
        return np.hypot(textures.mean_std(deviations), share * scale)

    kd_std = np.hypot(of_mean(textures.kd_std), unsure[:3] * mean.kd)
    quantities = {"kd": assess_linear(mean.kd, kd_std, scale, "Kd")}
    quantities["albedo"] = scaled(quantities["kd"], np.pi)
    if not fit.model.specular:
        return quantities, ("kd.r", "kd.g", "kd.b"), kd_std
    ks_std = of_mean(textures.ks_std) if textures.ks_varies else np.hypot(fit.common_ks_std, share * scale)
    ks_std = np.hypot(ks_std, unsure[3:] * mean.ks)
    quantities["ks"] = assess_linear(mean.ks, ks_std, scale, "Ks")
    total = np.where(scale > 0, scale, 1)
    shares_std = np.hypot(mean.kd * ks_std, mean.ks * kd_std) / total**2
    for name, value in (("kd_normalised", mean.kd / total), ("ks_normalised", mean.ks / total)):
        quantities[name] = assess_linear(value, shares_std, np.ones(3), name[:2].capitalize())
    ks_share = float(np.mean(mean.ks / total))
    # The search's coordinates are logarithms, of mu - 1 in the case of mu.
    found = {"sigma": mean.sigma, "mu": mean.mu}
    scalars: dict[str, Scalar] = {}
    for k, (name, number) in enumerate(
        (name, number) for name, number in found.items() if number is not None
    ):
        span = number - 1 if name == "mu" else number
        deviation = float(np.hypot(span * np.sqrt(fit.covariance[k, k]), share * number))
        scalars[name] = Scalar(number, deviation, float(span * fit.fragility[k]))
    quantities["sigma"] = assess_sigma(scalars["sigma"], lighting_degree(list(lightings.values())), ks_share)
    if "mu" in scalars:
        quantities["mu"] = assess_mu(scalars["mu"], list(fields.values()), ks_share)
    order = [str(name) for name in ("mu", "sigma") if name in scalars]
    std = np.concatenate([[scalars[name].std for name in order], kd_std, ks_std])
    return quantities, (*order, *(f"{name}.{channel}" for name in ("kd", "ks") for channel in "rgb")), std
