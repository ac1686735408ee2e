"""Spherical harmonic coefficients of the lighting by weighted linear least squares [RH01, eq. 25].

What is known of a coefficient before any photograph is that light is positive: the coefficients of one degree then have
a root mean square of |L_00| at most, which a single directional source reaches. That is the prior. It leaves alone what
the photographs determine, and of the rest it says so: there the posterior stays as wide as the prior.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isqrt

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from invrender.brdf.microfacet import Microfacet
from invrender.estimate.clusters import structured_rms
from invrender.estimate.noise import NoiseModel, fit_noise
from invrender.inverse_lighting.correlated import cluster_shifts, shift_without, widening_of
from invrender.theory.conditioning import Information, information
from invrender.transport.harmonic_rows import PhotoRows
from recon.harmonics.basis import check_degree, degree_of, degrees

Floats = NDArray[np.float64]

# Degrees that are looked at: the lobe leaves exp(-(2.6)^2) = 0.1% of the last; a diffuse surface, A_8 = 1% of A_0.
_DEGREES_PER_ROUGHNESS, HIGHEST_DEGREE, _DIFFUSE_DEGREE = 2.6, 30, 8
# A degree of which less than this is determined isn't worth its coefficients.
_WORTH = 0.1
# A posterior a tenth of the prior's width counts as determined, beyond half of it as no better than the prior.
DETERMINED, UNDETERMINED = 1 - 0.1**2, 1 - 0.5**2
_PASSES = 4
# The noise, floor and relative, that the first pass takes for granted.
_FIRST_NOISE = 0.01


@dataclass(frozen=True, eq=False)
class LightCoefficients:
    """Lighting as harmonics, with what is known of it.

    degree : up to which light is reported. full_values : ((l_max + 1)^2, 3), l_max >= degree, the posterior's mean; the
    light above `degree` is estimated as well, so that it is not taken for light below. posterior : (3, K, K), the
    covariance that noise and prior imply. widening : (K, 3), >= 1, by which correlated residuals raise deviations.
    shift : (K, 3), what light above the rows' degree may move besides.
    prior_std : (3,), of every coefficient of a channel up to `degree`. rank : (3,), how many combinations of these the
    samples determine. noise : of the residuals. hidden_power : (3,), mean squared coefficient that light above `degree`
    is taken to have. weights : per photograph, inverse variances (n, 3) of its samples. structured : residual, relative
    to the radiance, that is correlated over tiles of the photographs.
    """

    degree: int
    full_values: Floats
    posterior: Floats
    widening: Floats
    shift: Floats
    prior_std: Floats
    rank: Floats
    noise: NoiseModel
    hidden_power: Floats
    weights: tuple[Floats, ...]
    structured: float

    @property
    def values(self) -> Floats:
        """Coefficients ((degree + 1)^2, 3)."""
        return self.full_values[: (self.degree + 1) ** 2]

    @property
    def covariance(self) -> Floats:
        """Of `values`, (3, k, k), widened."""
        return np.stack([self.full_covariance(channel, self.degree) for channel in range(3)])

    def full_covariance(self, channel: int, degree: int | None = None) -> Floats:
        """Of a channel's `full_values` up to a degree, all if None, widened."""
        first = slice(None if degree is None else (degree + 1) ** 2)
        wider = self.widening[first, channel]
        shift = self.shift[first, channel]
        return np.asarray(
            self.posterior[channel, first, first] * np.outer(wider, wider) + np.outer(shift, shift)
        )

    @property
    def std(self) -> Floats:
        """(k, 3)."""
        first = slice((self.degree + 1) ** 2)
        by_noise = np.diagonal(self.posterior, axis1=1, axis2=2).T * self.widening**2
        return np.asarray(np.sqrt(by_noise + self.shift**2)[first])

    @property
    def shares(self) -> Floats:
        """How much of what is known of each coefficient comes from the samples, (k, 3), 0 to 1."""
        return np.maximum(1 - (self.std / self.prior_std) ** 2, 0)

    @property
    def share_per_degree(self) -> Floats:
        """Mean share of each degree over orders and channels, (degree + 1,)."""
        l = degrees(self.degree)
        return np.bincount(l, self.shares.mean(axis=1)) / np.bincount(l)


def candidate_degree(brdf: Microfacet, samples: int) -> int:
    """The highest degree at which a BRDF may show anything of the light, no more than so many samples can determine."""
    by_lobe = _DIFFUSE_DEGREE
    if brdf.sigma is not None and brdf.ks.any():
        by_lobe = max(_DIFFUSE_DEGREE, int(np.ceil(_DEGREES_PER_ROUGHNESS / brdf.sigma)))
    return min(by_lobe, HIGHEST_DEGREE, isqrt(max(samples, 1)) - 1)


def check_samples(degree: int, samples: int) -> None:
    """ValueError for a degree below 0 or above 30, and for more unknowns than samples."""
    check_degree(degree, "degree")
    if degree > HIGHEST_DEGREE:
        raise ValueError(f"degree is {degree}; degrees up to {HIGHEST_DEGREE} are fitted")
    unknowns = (degree + 1) ** 2
    if samples < unknowns:
        raise ValueError(
            f"light of degree {degree} has {unknowns} unknown coefficients per channel, but there are only {samples}"
            " samples; lower the degree, or take more samples or photographs"
        )


def estimate_coefficients(
    photos: Sequence[PhotoRows], brdf: Microfacet, degree: int | None = None
) -> LightCoefficients:
    """Lighting coefficients from photographs under one lighting, of an object of known BRDF.

    photos : rows up to `degree` at least. Without `degree`, rows up to `candidate_degree`: it is then the highest
    degree of which the samples, with their noise, determine a tenth. Radiance is fitted per channel; the noise is read
    off the residuals. Light above the degree is fitted too, as far as the rows go: left out, it would lean on what is
    reported, and alike in all samples of a direction. It is taken to be as strong as in the upper half of the degrees
    below, and nothing of it where the light is smooth. What degrees above the rows' may send to a sample counts as its
    noise: at grazing angles, where a highlight is narrow, that is much. Standard deviations are the larger of what all
    that implies and of what residuals imply that are correlated within clusters; to that comes what half of the degrees
    above move. Raises ValueError for fewer samples
    than coefficients and for radiance that isn't positive.
    """
    samples = sum(len(photo.field) for photo in photos)
    known = degree_of(photos[0].diffuse.shape[1])
    top = min(candidate_degree(brdf, samples), known) if degree is None else degree
    check_samples(top, samples)
    found = _fit(photos, brdf, top)
    if degree is None:
        worth = np.flatnonzero(found.share_per_degree >= _WORTH)
        highest = int(worth[-1]) if len(worth) else 0
        if highest < top:
            found = _fit(photos, brdf, highest)
    return found


def _fit(photos: Sequence[PhotoRows], brdf: Microfacet, degree: int) -> LightCoefficients:
    prior = _uniform_light(photos, brdf)
    radiances = [photo.field.radiance for photo in photos]
    scale = float(np.sqrt(np.mean(np.concatenate(radiances) ** 2)))
    count = sum(len(seen) for seen in radiances)
    l_max, size = degree_of(photos[0].diffuse.shape[1]), (degree + 1) ** 2
    above = degrees(l_max) > degree
    beyond = [photo.power_beyond(brdf, l_max) for photo in photos]
    noise, hidden = NoiseModel(_FIRST_NOISE * scale, _FIRST_NOISE), prior**2
    variances = [noise.variance(seen) + hidden * power for seen, power in zip(radiances, beyond, strict=True)]
    for _ in range(_PASSES):
        weights = [
            photo.field.weight[:, None] / variance for photo, variance in zip(photos, variances, strict=True)
        ]
        priors = np.where(above[:, None], np.sqrt(hidden), prior)
        posteriors = [_posterior(photos, weights, brdf, channel, priors[:, channel]) for channel in range(3)]
        values = np.stack([mean for mean, _ in posteriors], axis=1)
        stds = np.stack([np.sqrt(np.diagonal(covariance)) for _, covariance in posteriors], axis=1)
        predictions = [photo.predict(brdf, values) for photo in photos]
        residuals = [seen - found for seen, found in zip(radiances, predictions, strict=True)]
        # Shares add up to the rank. Residuals are smaller than the noise by what the fit has taken up of it.
        shares = 1 - (stds / np.where(priors > 0, priors, 1)) ** 2
        left_over = np.sqrt(max(count - shares.sum(axis=0).mean(), 1.0) / count)
        rank = shares[:size].sum(axis=0)
        hidden = _mean_power(values[:size], stds[:size], degree)
        noise = _noise(predictions, [residual / left_over for residual in residuals], beyond, hidden)
        variances = [
            noise.variance(found) + hidden * power for found, power in zip(predictions, beyond, strict=True)
        ]
        prior = np.maximum(prior, values[0])
    widening, shifts = [], []
    # What half the degrees above move is a witness of what those beyond the rows would.
    half = ((degree + l_max) // 2 + 1) ** 2
    for channel, (mean, covariance) in enumerate(posteriors):
        clusters = cluster_shifts(photos, weights, residuals, brdf, channel, covariance)
        widening.append(widening_of(covariance, clusters, priors[:, channel]))
        room = priors[:, channel] ** 2 - np.diagonal(covariance) * widening[-1] ** 2
        limit = np.sqrt(np.maximum(room, 0))
        shifts.append(np.clip(shift_without(mean, covariance, half), -limit, limit))
    trust = [weight * noise.variance(found) for weight, found in zip(weights, predictions, strict=True)]
    counted = [residual * np.sqrt(share) for residual, share in zip(residuals, trust, strict=True)]
    return LightCoefficients(
        degree=degree,
        full_values=values,
        posterior=np.stack([covariance for _, covariance in posteriors]),
        widening=np.stack(widening, axis=1),
        shift=np.stack(shifts, axis=1),
        prior_std=prior,
        rank=rank,
        noise=noise,
        hidden_power=hidden,
        weights=tuple(weights),
        structured=structured_rms([photo.field for photo in photos], counted) / scale,
    )


def _uniform_light(photos: Sequence[PhotoRows], brdf: Microfacet) -> Floats:
    """L_00 (3,) of uniform light under which the object would be as bright in the mean."""
    mean = np.mean(np.concatenate([photo.field.radiance for photo in photos]), axis=0)
    if not (mean > 0).all():
        raise ValueError(
            f"the mean radiance of the samples is {mean.tolist()}; it must be > 0 in each channel: check the black"
            " level, and expose longer"
        )
    return np.sqrt(4 * np.pi) * mean / (np.pi * brdf.kd + brdf.ks)


def _mean_power(values: Floats, stds: Floats, degree: int) -> Floats:
    """Mean squared coefficient (3,) of the upper half of the degrees, less what noise adds."""
    upper = degrees(degree) > degree // 2
    upper[-1] = True
    return np.maximum((values**2 - stds**2)[upper].mean(axis=0), 0)


def _noise(
    predictions: Sequence[Floats], residuals: Sequence[Floats], beyond: Sequence[Floats], hidden: Floats
) -> NoiseModel:
    """The noise of that half of the samples in which light of higher degrees shows least."""
    predicted, residual = np.concatenate(predictions), np.concatenate(residuals)
    shown = (np.concatenate(beyond) * hidden).mean(axis=1)
    half = shown <= np.median(shown)
    return fit_noise([predicted[half]], [residual[half]])


def _posterior(
    photos: Sequence[PhotoRows], weights: Sequence[Floats], brdf: Microfacet, channel: int, priors: Floats
) -> tuple[Floats, Floats]:
    """Mean (K,) and covariance (K, K) of one channel. priors : (K,), standard deviations >= 0."""
    degree = degree_of(len(priors))
    found, pull = Information(np.zeros((len(priors), len(priors)))), np.zeros(len(priors))
    for photo, weight in zip(photos, weights, strict=True):
        rows = photo.of_channel(brdf, channel, degree)
        found += information(rows, weight[:, channel] ** -0.5)
        pull += rows.T @ (weight[:, channel] * photo.field.radiance[:, channel])
    scale = np.outer(priors, priors)
    # In units of the prior, where no eigenvalue is below 1.
    factor = cho_factor(scale * found.matrix + np.eye(len(priors)))
    covariance = scale * cho_solve(factor, np.eye(len(priors)))
    return covariance @ pull, covariance
