"""What is not known beforehand, as one vector: the BRDF's numbers, then those of a lighting that is not given.

All are counted in standard deviations of a weak prior, so that the prior's precision is the identity and the share
of a number that photographs determine is 1 less its variance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.microfacet import Microfacet
from invrender.estimate.uncertainty import PRIOR_STD
from invrender.plan.experiment import PlannedLight
from recon.harmonics.basis import check_degree

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Kd and Ks beforehand: up to so many times their sum.
_WEIGHT_PRIOR = 10.0
# Of a source's direction along either tangent, radians: from anywhere.
_DIRECTION_PRIOR = 1.0
# The scale that light and BRDF share is taken for known to this.
_GAUGE_STD = 1e-4


@dataclass(frozen=True, eq=False)
class Unknowns:
    """The layout of the vector, of p numbers in all, for photographs under one lighting.

    brdf : "kd", "ks" (3 each), "mu", "sigma", as the BRDF has them -> their places; `shared` numbers in all.
    harmonics : ((l_max + 1)^2, 3), irradiance : (k, 3) and direction : (k, 2) places of an unknown lighting's
        coefficients, of its sources' irradiances and of their directions along two tangents; none where it is known.
    scale : (p,), the prior's standard deviations.
    gauge : (g, p), what is taken for known to one part in `_GAUGE_STD`: the total of each channel's light, or nothing.
    """

    brdf: dict[str, Ints]
    harmonics: Ints
    irradiance: Ints
    direction: Ints
    scale: Floats
    gauge: Floats

    @property
    def size(self) -> int:
        return len(self.scale)

    @property
    def shared(self) -> int:
        return sum(len(places) for places in self.brdf.values())

    @property
    def places(self) -> Ints:
        """(3, q), of what each channel depends on: Kd, Ks, mu, sigma, coefficients, irradiances, directions."""
        return np.stack([self._of_channel(channel) for channel in range(3)])

    @property
    def precision(self) -> Floats:
        """The prior's precision of the lighting's own numbers, (p - shared, p - shared)."""
        own = self.gauge[:, self.shared :] / _GAUGE_STD
        return np.eye(self.size - self.shared) + own.T @ own

    def _of_channel(self, channel: int) -> Ints:
        brdf = [places[channel] if len(places) == 3 else places[0] for places in self.brdf.values()]
        return np.concatenate(
            [brdf, self.harmonics[:, channel], self.irradiance[:, channel], self.direction.ravel()]
        ).astype(np.int64)


def unknowns_of(brdf: Microfacet, light: PlannedLight, degree: int, is_gauge: bool) -> Unknowns:
    """The unknowns of photographs under a light; degree : the highest of an unknown one's coefficients, >= 0.

    A priori a coefficient of any degree is as large as that of degree 0 of all the light: no light of this
    total has larger ones in the mean, and a single source has such. is_gauge : the light's total sets the scale.
    """
    check_degree(degree, "degree")
    blocks: dict[str, Floats] = {}
    weight = np.maximum(brdf.kd + brdf.ks, 1e-3 * (brdf.kd + brdf.ks).max())
    blocks["kd"] = _WEIGHT_PRIOR * weight
    if brdf.sigma is not None:
        blocks["ks"] = _WEIGHT_PRIOR * weight
        if brdf.mu is not None:
            blocks["mu"] = np.array([PRIOR_STD["mu"]])
        blocks["sigma"] = np.array([PRIOR_STD["sigma"]])
    names = tuple(blocks)
    count, sources = (0, 0) if light.known else ((degree + 1) ** 2, len(light.lighting.directions))
    total = np.maximum(light.total, 1e-3 * light.total.max())
    blocks["harmonics"] = np.tile(total / np.sqrt(4 * np.pi), count)
    blocks["irradiance"] = np.tile(total, sources)
    blocks["direction"] = np.full(2 * sources, _DIRECTION_PRIOR)
    places, start = {}, 0
    for name, values in blocks.items():
        places[name] = np.arange(start, start + len(values))
        start += len(values)
    scale = np.concatenate(list(blocks.values()))
    harmonics, irradiance = places["harmonics"].reshape(-1, 3), places["irradiance"].reshape(-1, 3)
    gauge = np.zeros((3 if is_gauge and not light.known else 0, start))
    for channel in range(len(gauge)):
        gauge[channel, harmonics[0, channel]] = np.sqrt(4 * np.pi) / total[channel]
        gauge[channel, irradiance[:, channel]] = 1 / total[channel]
    return Unknowns(
        brdf={name: places[name] for name in names},
        harmonics=harmonics,
        irradiance=irradiance,
        direction=places["direction"].reshape(-1, 2),
        scale=scale,
        gauge=gauge * scale,
    )
