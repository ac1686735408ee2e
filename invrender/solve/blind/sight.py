"""What the samples of a photograph see of unknown lighting: rows of the linear problem, and their slopes.

    B = sum_k L_k [(1 - kappa) D_k + kappa F(mu, theta_o) M_k(sigma)]
      + sum_j E_j [(1 - kappa) max(n.d_j, 0) + kappa F(mu, theta_o) T(sigma, d_j)]     [RH01, eq. 15, 20, 23]

per channel, in the gauge Kd + Ks = 1. A pixel is the mean over its rays, Fresnel factor included.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from dataclasses import field as defaulted

import numpy as np
from numpy.typing import NDArray

from invrender.model.fresnel import normalised_fresnel
from invrender.model.lobetable import specular_rows
from invrender.model.transfer import LightElement, specular_transfer
from invrender.solve.blind.state import State, turn
from invrender.theory.operator import irradiance_operator
from recon.lightfield import LightField

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

# Between roughnesses this far apart in log sigma, rows are interpolated by cubics through values and slopes.
_SPACING = 0.1
# Steps of the differences that stand for derivatives: sources' directions and log sigma, radians; log(mu - 1).
_STEP = 1e-4


@dataclass(frozen=True, eq=False)
class Sight:
    """A photograph with what doesn't change while the BRDF is searched.

    field : the photograph. l_max : of the lighting. rays : the same as one sample per ray. cos : (m,) exitant, of
    rays. diffuse : (n, (l_max + 1)^2), irradiance. lighting : number of the lighting that it is under.
    """

    field: LightField
    l_max: int
    rays: LightField
    cos: Floats
    diffuse: Singles
    lighting: int = 0
    _nodes: dict[int, tuple[Singles, Singles]] = defaulted(default_factory=dict, repr=False)

    @staticmethod
    def of(samples: LightField, l_max: int, lighting: int = 0) -> Sight:
        """Prepare a photograph for lighting of degree l_max."""
        diffuse = samples.mean_over_rays(irradiance_operator(samples.normals, l_max))
        rays = _one_sample_per_ray(samples)
        cos = np.einsum("nk,nk->n", samples.normals, samples.views)
        return Sight(samples, l_max, rays, cos, diffuse.astype(np.float32), lighting)

    def lobe(self, sigma: float) -> tuple[Singles, Singles, Singles]:
        """Lobe rows at the two roughnesses around sigma, and weights that make of them rows and slopes at sigma.

        Returns (4, m, k) rows and slopes of both, (4,) weights of the rows at sigma, and (4,) of their slopes in log
        sigma. Few roughnesses are computed in a whole search, since it ends between two of them.
        """
        position = np.log(sigma) / _SPACING
        low = int(np.floor(position))
        for node in (low, low + 1):
            if node not in self._nodes:
                self._nodes[node] = specular_rows(self.rays, self.l_max, float(np.exp(node * _SPACING)))
        for node in [node for node in self._nodes if node not in (low, low + 1)]:
            del self._nodes[node]
        t = position - low
        # Hermite's cubics, of values and slopes at both ends.
        value = np.array([(1 + 2 * t) * (1 - t) ** 2, t * (1 - t) ** 2, t**2 * (3 - 2 * t), t**2 * (t - 1)])
        slope = np.array([6 * t * (t - 1), (1 - t) * (1 - 3 * t), 6 * t * (1 - t), t * (3 * t - 2)])
        units = np.array([1, _SPACING, 1, _SPACING])
        return (
            np.stack([*self._nodes[low], *self._nodes[low + 1]]),
            (value * units).astype(np.float32),
            (slope * units / _SPACING).astype(np.float32),
        )


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows of a photograph's samples over the coefficients and then the sources, (n, k + j) each.

    per_diffuse : what a diffuse body of unit Kd sends. per_specular : a specular one of unit Ks; zero without.
    """

    per_diffuse: Floats
    per_specular: Floats

    def of_channel(self, kappa: float) -> Floats:
        """Rows (n, k + j) of one channel."""
        return (1 - kappa) * self.per_diffuse + kappa * self.per_specular


def rows_of(sight: Sight, state: State, l_max: int) -> Rows:
    """Rows at a state, over lighting of degree l_max <= the sight's."""
    size = (l_max + 1) ** 2
    rays, mean = sight.field, sight.field.mean_over_rays
    cosines = mean(np.maximum(rays.normals @ state.directions.T, 0))
    diffuse = np.hstack([sight.diffuse[:, :size], cosines])
    if state.sigma is None:
        return Rows(diffuse, np.zeros((1, 1)))
    fresnel = normalised_fresnel(state.mu, sight.cos)
    nodes, weights, _ = sight.lobe(state.sigma)
    lobe = np.einsum("j,jmk->mk", weights, nodes[:, :, :size]) * fresnel[:, None].astype(np.float32)
    sources = [_source(sight, direction, [state.sigma])[:, 0] * fresnel for direction in state.directions]
    specular = np.hstack([mean(lobe), *(mean(source)[:, None] for source in sources)])
    return Rows(diffuse, specular.astype(float))


def slopes_of(sight: Sight, state: State, rows: Rows, light: Floats) -> Floats:
    """Derivatives (n, 3, parameters of a channel) of radiance, in the order of `State.own`.

    light : (k + j, 3), coefficients and the sources' irradiances.
    """
    rays, mean, kappa = sight.field, sight.field.mean_over_rays, state.kappa
    size = len(light) - len(state.directions)
    columns = []
    fresnel = normalised_fresnel(state.mu, sight.cos)
    if state.sigma is not None:
        columns.append((rows.per_specular - rows.per_diffuse) @ light)
        nodes, weights, slope_weights = sight.lobe(state.sigma)
        parts = nodes[:, :, :size] @ light[:size].astype(np.float32)
        gathered, widened = (np.einsum("j,jmc->mc", w, parts).astype(float) for w in (weights, slope_weights))
        sigmas = state.sigma * np.exp([-_STEP, 0, _STEP])
        for direction, irradiance in zip(state.directions, light[size:], strict=True):
            before, at, after = _source(sight, direction, sigmas).T
            gathered += at[:, None] * irradiance
            widened += ((after - before) / (2 * _STEP))[:, None] * irradiance
        if state.mu is not None:
            ends = [
                normalised_fresnel(1 + (state.mu - 1) * np.exp(way), sight.cos) for way in (-_STEP, _STEP)
            ]
            columns.append(kappa * mean(((ends[1] - ends[0]) / (2 * _STEP))[:, None] * gathered))
        columns.append(kappa * mean(fresnel[:, None] * widened))
    for direction, irradiance in zip(state.directions, light[size:], strict=True):
        for way in np.eye(2):
            ends = [turn(direction, *(sign * _STEP * way)) for sign in (-1, 1)]
            cosines = [rays.normals @ end for end in ends]
            slope = (np.maximum(cosines[1], 0) - np.maximum(cosines[0], 0)) / (2 * _STEP)
            column = (1 - kappa) * mean(slope)[:, None]
            if state.sigma is not None:
                first, last = (_source(sight, end, [state.sigma])[:, 0] for end in ends)
                # At the horizon a highlight ends abruptly: a ray there says nothing of a small turn.
                same_side = (cosines[0] > 0) == (cosines[1] > 0)
                slope = np.where(same_side, (last - first) / (2 * _STEP), 0)
                column = column + kappa * mean(fresnel * slope)[:, None]
            columns.append(column * irradiance)
    return np.stack(columns, axis=-1) if columns else np.zeros((len(sight.field), 3, 0))


def _source(sight: Sight, direction: Floats, sigmas: Floats | list[float]) -> Floats:
    """Specular transfer (m, sigmas) of rays from a source of unit irradiance."""
    unit = LightElement("source", direction[None], np.ones((1, 1)))
    return specular_transfer(unit, sight.rays.normals, sight.rays.views, np.asarray(sigmas))[:, :, 0]


def _one_sample_per_ray(samples: LightField) -> LightField:
    """The same rays, each a sample of its own."""
    names = ("rows", "columns", "radiance", "variance", "weight")
    of_samples = {name: getattr(samples, name)[samples.ray_sample] for name in names}
    return replace(samples, **of_samples, ray_sample=np.arange(len(samples.ray_sample)))
