"""Light and BRDF, both unknown [RH01, section 6.3]: a simplex over Ks and mu; the light solved linearly within.

The inner solve is the dual one of section 6.2, as for the paper's spheres. Its light is as the lobe blurs it. It
assumes that there is no source, B_s,fast = 0, although the highlight of one is brighter by 1 / cos theta_o and narrower
at grazing angles [eq. 23] than a mirror shows it [eq. 22]. So pixels that mirror the source's region add to the light,
but the error that Ks and mu are fitted by is of the others. sigma follows from the source's peak [eq. 26].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from capture.source_region import SourceRegion
from invrender.estimate.rh01.direct import DIRECT_DEGREE, DirectLighting
from invrender.estimate.rh01.dual import DUAL_DEGREE, DualLighting
from invrender.estimate.rh01.roughness import Peak, find_peak, highlights_near_normal, without_source
from invrender.estimate.rh01.samples import Reflections, Samples
from invrender.estimate.rh01.simplex import MU_BOUNDS, simplex
from invrender.transport.visibility import Shadows
from recon.harmonics.basis import degree_of
from recon.harmonics.latlong import map_coefficients
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]

# Degree of the light less its source, which is slow.
_SLOW_DEGREE = 12
_SHARES = (0.005, 0.995)
# The first light is made at the first start; a simplex from one place alone may stay where mu ends.
_START_SHARES, _START_MU = (0.3, 0.1), 1.5
# Rows of the map: so that about eight samples meet at each node, within what shows a lobe of 0.1 rad.
_SAMPLES_PER_NODE, _HEIGHTS = 8, (24, 64)


@dataclass(frozen=True, eq=False)
class PublishedFactors:
    """What section 6.3 finds, in the gauge Kd + Ks = 1.

    share : (3,) Ks. mu : None where no Fresnel factor was fitted. light : (H, 2H, 3), lat-long, as the lobe blurs it,
    the source included; noise and ringing leave it negative here and there. coefficients : (k, 3), of the same light,
    which the diffuse part goes by. peak : the source, with sigma in radians; None where the light has no peak. rms :
    relative, of the residuals that the search minimised. direct : whether the coefficients are all of the light, or the
    map shows more of it to mirrored rays.
    """

    share: Floats
    mu: float | None
    light: Floats
    coefficients: Floats
    peak: Peak | None
    rms: float
    direct: bool

    @property
    def nine(self) -> Floats:
        """The light's first coefficients (9, 3)."""
        return self.coefficients[:9]

    @property
    def sigma(self) -> float | None:
        return None if self.peak is None else self.peak.sigma

    def slow_and_source(self) -> tuple[Floats, Floats, Floats]:
        """The light as slow coefficients (169, 3), up to degree 12, sources' directions (k, 3) and irradiances (k, 3).

        The blurred source is taken off the light and put back sharp; k is 1, or 0 without.
        """
        if self.peak is None:
            return map_coefficients(self.light, _SLOW_DEGREE), np.zeros((0, 3)), np.zeros((0, 3))
        slow, irradiance = without_source(self.light, self.peak)
        return map_coefficients(slow, _SLOW_DEGREE), self.peak.direction[None], irradiance[None]

    def radiance(self, field: LightField, shadows: Shadows | None = None) -> Floats:
        """Radiance (n, 3) of a photograph's samples, as predicted; shadows : of a mesh on itself."""
        seen = Reflections.of(field, len(self.light), degree_of(len(self.coefficients)), shadows)
        if self.direct:
            mirrored = seen.mirrored_harmonics @ self.coefficients
        else:
            mirrored = seen.mirrored @ self.light.reshape(-1, 3)
        highlight = seen.fresnel(self.mu)[:, None] * mirrored
        return np.asarray((1 - self.share) * (seen.diffuse @ self.coefficients) + self.share * highlight)


class InverseLighting(Protocol):
    """An inner solve: the light of samples at shares (3,) of Ks and a mu."""

    @property
    def samples(self) -> Samples: ...

    @property
    def fresnel(self) -> bool: ...

    def judging(self, judged: NDArray[np.bool_]) -> InverseLighting:
        """The same, with the error of the marked samples (n,) only."""
        ...

    def error(self, share: Floats, position: float) -> float:
        """Relative RMS at log(mu - 1) [RH01, ObjFun]."""
        ...

    def light(self, share: Floats, mu: float | None) -> tuple[Floats, Floats]:
        """The light's coefficients (k, 3), and the light as a map (H, 2H, 3)."""
        ...


def published_factors(
    photos: Sequence[LightField],
    fresnel: bool = True,
    region: SourceRegion | None = None,
) -> PublishedFactors:
    """Light and BRDF of a convex body, both unknown, by the nested procedure of [RH01, section 6.3] with dual lighting.

    fresnel : False leaves mu out, as the paper does for metals. region : around the source, which the paper marks by
    hand; None takes the sharpest peak of the recovered light, as far out as it gets darker. Raises ValueError for too
    few samples.
    """
    return _factored(DualLighting(Samples.of(photos, _height(photos), DUAL_DEGREE), fresnel), region, 0.0)


def published_factors_direct(
    photos: Sequence[LightField],
    fresnel: bool = True,
    region: SourceRegion | None = None,
    shadows: Shadows | None = None,
    degree: int = DIRECT_DEGREE,
) -> PublishedFactors:
    """The same with direct recovery of the light's coefficients, as RH01 did for their cat [sections 6.2 and 6.4].

    shadows : of a mesh on itself; None of a convex body. degree : l*, of the order of 1 / sigma; higher ones are
    noisier. On a mesh all pixels count, and sigma is read off the recovered light. The rest as of `published_factors`.
    """
    # As many rows as harmonics of that degree take.
    height = max(_height(photos), 2 * degree + 1)
    inner = DirectLighting(Samples.of(photos, height, degree, shadows), fresnel)
    if shadows is None:
        # Harmonics up to l* spread a source's edge by their resolution, pi / l*.
        return _factored(inner, region, np.pi / degree)
    # On a mesh the borders of a source's shadows, which harmonics up to l* can't follow, weigh more than highlights do;
    # without the source's highlights nothing is left that determines mu.
    found = _search(inner)
    return replace(found, peak=find_peak(found.light, region))


def _height(photos: Sequence[LightField]) -> int:
    """Rows of the map; ValueError for too few samples."""
    samples = sum(len(photo) for photo in photos)
    low, high = _HEIGHTS
    if samples < 2 * low**2:
        raise ValueError(
            f"there are {samples} samples; RH01's procedure fills a map of light from them, which takes"
            f" {2 * low**2} at least"
        )
    return int(np.clip(np.sqrt(samples / (2 * _SAMPLES_PER_NODE)), low, high))


def _factored(inner: InverseLighting, region: SourceRegion | None, margin: float) -> PublishedFactors:
    """The search by samples that mirror nothing within margin, radians, of the source; its peak from all of them."""
    samples = inner.samples

    def specular(share: Floats, coefficients: Floats) -> Floats:
        return np.asarray((samples.radiance - (1 - share) * (samples.diffuse @ coefficients)) / share)

    share, mu = np.full(3, _START_SHARES[0]), _START_MU if inner.fresnel else None
    first = samples.mirror_map(specular(share, inner.light(share, mu)[0]), mu)
    peak = find_peak(first.reshape(samples.height, -1, 3), region)
    if peak is None:
        return _search(inner)
    found = _search(inner.judging(samples.looking_outside(peak.region, margin)))
    highlights = specular(found.share, found.coefficients)
    light, exitance = highlights_near_normal(samples, highlights, found.mu)
    return replace(found, peak=find_peak(light, region, exitance))


def _search(inner: InverseLighting) -> PublishedFactors:
    def error(point: Floats) -> float:
        return inner.error(point[:3], point[-1])

    bounds = np.array([_SHARES] * 3 + [MU_BOUNDS] * inner.fresnel)
    starts = [np.array([share] * 3 + [np.log(_START_MU - 1)] * inner.fresnel) for share in _START_SHARES]
    best = min((simplex(error, start, bounds) for start in starts), key=error)
    mu = 1 + float(np.exp(best[3])) if inner.fresnel else None
    coefficients, light = inner.light(best[:3], mu)
    return PublishedFactors(
        best[:3], mu, light, coefficients, None, error(best), isinstance(inner, DirectLighting)
    )
