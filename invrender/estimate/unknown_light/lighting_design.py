"""What samples of photographs see of unknown lighting, and how that changes with the BRDF (`rows`).

    B = sum_k L_k [(1 - s) D_k + s M_k(mu, sigma)]
      + sum_j E_j [(1 - s) max(n.d_j, 0) + s T(mu, sigma, d_j)]     [RH01, eq. 15, 20, 23]

per channel, in the gauge Kd + Ks = 1; above a base under an interface D_k and the cosine hold what that transmits
(`diffuse_base`), and what a mesh hides of the sky is taken to come in as light from all sides does. M and T are the
lobe with its Fresnel factor, which RH01's form has at theta_o and so outside of all sums over light. A pixel is the
mean over its rays. What a mesh keeps from itself is left out of all of these, by `visibility`'s three rules.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from dataclasses import field as defaulted
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from capture.lighting import seen_from
from invrender.brdf.form import LobeForm, part_width
from invrender.brdf.fresnel import normalised_fresnel
from invrender.brdf.lobes import RH01_FORM
from invrender.estimate.unknown_light.albedo_whitening import albedo_whitening
from invrender.estimate.unknown_light.derivatives import STEP, denser, fresnel_with_slope, further
from invrender.estimate.unknown_light.lamp_frame import ANYWHERE, LampFrame
from invrender.estimate.unknown_light.state import BlindState
from invrender.theory.operator import irradiance_operator
from invrender.transport.diffuse_base import interface_transmittance, sky_factors
from invrender.transport.form_table import mean_form_rows
from invrender.transport.lobe_table import Transfer, lobe_table, mean_lobe_rows, specular_rows
from invrender.transport.visibility import Shadows
from recon.harmonics.basis import degree_of, evaluate_harmonics
from recon.sampling.lightfield import LightField, blocks, joined, pools

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Mask = NDArray[np.bool_]

# Turn of the normal, radians, across squares of a pixel that one ray stands for in light of a degree: the first, and
# less of a high degree, by the second over it.
_EVEN, _EVEN_OF_DEGREE = 0.06, 0.3
# Between roughnesses this far apart in log sigma, rows are interpolated by cubics through values and slopes.
_SPACING = 0.1
# Up to so many numbers of rays: 64 MB.
_MOST_NUMBERS = 2**24
# What takes up more of each ray is made of so many at a time.
_RAYS_AT_A_TIME = 16384
# So far along log sigma and log(mu - 1), rows of other forms follow their slopes: to about 1e-6 of the largest.
_ALONG = 1e-3
# Turn of a source, radians, after which what sees it must still see it to count as clear of its shadows' borders; and
# less than that, within which sources cast the same shadows. These are kept of so many directions: a search goes back
# and forth.
_PENUMBRA, _ALIKE, _KEPT_DIRECTIONS = 0.02, 0.01, 100
# Distances from the mirrored ray, in sigma, at which edges are looked for: most of the lobe, up to so many radians.
_LOBE, _WIDEST = (1.0, 2.5), 0.8


# Form, degree, mu and sigma that rows of other forms belong to.
_Shape = tuple[LobeForm, int, float | None, float]


@dataclass(frozen=True, eq=False)
class LightingDesign:
    """Photographs under one lighting with what doesn't change while the BRDF is searched.

    photos : one or more. field : their samples as one's. sky : the same with as few rays as light of the degree takes;
    highlights of sources take more. l_max : of the lighting. transfer : of the lobe, for all but the sources.
    diffuse : (n, (l_max + 1)^2), irradiance, which a Lambertian base sends. lighting : number of the lighting that they
    are under. shadows : of a mesh on itself; None of what has none. settled : whether searches begin near their end:
    then rows of RH01's lobe, too, are kept of samples near one state, not of rays between two roughnesses, which take
    up several times as much; so they are where that would be too much. frame : of near sources.
    """

    photos: tuple[LightField, ...]
    field: LightField
    sky: LightField
    l_max: int
    transfer: Transfer
    diffuse: Singles
    lighting: int = 0
    shadows: Shadows | None = None
    settled: bool = False
    frame: LampFrame = ANYWHERE
    _nodes: dict[int, Singles] = defaulted(default_factory=dict, repr=False)
    _last: dict[_Shape, Singles] = defaulted(default_factory=dict, repr=False)
    _free: dict[bytes, Mask] = defaulted(default_factory=dict, repr=False)

    @staticmethod
    def of(
        photos: Sequence[LightField],
        l_max: int,
        lighting: int = 0,
        transfer: Transfer = "exact",
        shadows: Shadows | None = None,
        settled: bool = False,
        frame: LampFrame = ANYWHERE,
    ) -> LightingDesign:
        """Prepare photographs for lighting of degree l_max."""
        samples = joined(photos)
        sky = samples.merged(min(_EVEN, _EVEN_OF_DEGREE / max(l_max, 1)))
        diffuse = [_irradiance(part, l_max, shadows) for _, part in blocks(sky, _RAYS_AT_A_TIME)]
        single = np.concatenate(diffuse)
        return LightingDesign(
            tuple(photos), samples, sky, l_max, transfer, single, lighting, shadows, settled, frame
        )

    def like(self, photos: Sequence[LightField], l_max: int, settled: bool = False) -> LightingDesign:
        """Prepare other samples under the same lighting for another degree."""
        return LightingDesign.of(
            photos, l_max, self.lighting, self.transfer, self.shadows, settled, self.frame
        )

    @cached_property
    def radiance(self) -> Floats:
        """What samples (n, 3) show, as `within` leaves it."""
        return self.within(self.field.radiance)

    def brightness(self, prediction: Floats) -> Floats:
        """Radiance (n, 3) by which noise is judged: as predicted, or as photographed of a textured body."""
        return prediction if self.field.place is None else np.maximum(self.field.radiance, 0)

    def within(self, values: NDArray[np.floating]) -> NDArray[Any]:
        """Values (n, ...) less what photographs of a place have in common on a textured body; as they are on others."""
        if self.field.place is None:
            return values
        left = self._whitening.astype(values.dtype) @ values.reshape(len(values), -1)
        return np.asarray(left.reshape(values.shape))

    @cached_property
    def _whitening(self) -> csr_array:
        assert self.field.place is not None
        return albedo_whitening(self.field.place)

    def forget_rows(self) -> None:
        """Leave the memory of rows that are kept from step to step."""
        self._nodes.clear()
        self._last.clear()

    def split(self, values: NDArray[Any]) -> list[NDArray[Any]]:
        """What belongs to samples (n, ...), photograph by photograph."""
        return np.split(values, np.cumsum([len(photo) for photo in self.photos])[:-1])

    def towards(self, sources: Floats) -> tuple[Floats, Floats]:
        """Where rays see sources, as `seen_from` has it; sources : (k, 3) or (k, 4), as a state has them."""
        return seen_from(self.frame.world(sources), self.field.positions)

    def free(self, sources: Floats) -> Mask:
        """Which rays (m, k) see sources, as a state has them, (k, 3) or (k, 4); all do that of what has no shadows.

        Sources nearly alike are taken for one, so that the last steps of a search don't stumble over pixels at the
        borders of shadows, which count for nothing in the end.
        """
        result = np.ones((len(self.field.ray_sample), len(sources)), bool)
        if self.shadows is None:
            return result
        for k, near in enumerate(np.round(sources / _ALIKE) * _ALIKE):
            key = near.tobytes()
            if key not in self._free:
                while len(self._free) >= _KEPT_DIRECTIONS:
                    del self._free[next(iter(self._free))]
                near[:3] /= np.linalg.norm(near[:3])
                self._free[key] = self.shadows.free(self.field, self.frame.world(near[None])[0])
            result[:, k] = self._free[key]
        return result

    def base_rows(self, state: BlindState, l_max: int) -> NDArray[np.floating]:
        """Rows (n, (l_max + 1)^2) of samples over the lighting, of the base per unit of Kd."""
        size = (l_max + 1) ** 2
        if not state.form.interface and state.form.coat is None:
            return self.diffuse[:, :size]
        out = interface_transmittance(state.form, state.mu, self._sky_exitant)
        factors = sky_factors(state.form, state.mu, l_max)
        mean = self.sky.mean_over_rays
        clear = mean(self._harmonics[:, :size], out) * factors
        return np.asarray(clear - mean(out)[:, None] * self._hidden[:, :size])

    def base_slope(self, state: BlindState, light: Floats) -> Floats:
        """Derivative (n, c) of what samples see of lighting ((l_max + 1)^2, c) in the base, by log(mu - 1)."""
        if not state.form.interface or state.mu is None:
            return np.zeros((len(self.field), light.shape[1]))
        l_max, mus = degree_of(len(light)), (state.mu, denser(state.mu))
        out, more = (interface_transmittance(state.form, mu, self._sky_exitant)[:, None] for mu in mus)
        factors, further = (sky_factors(state.form, mu, l_max)[:, None] for mu in mus)
        both = np.hstack([factors * light, (further - factors) / STEP * light]).astype(np.float32)
        falling, change = np.hsplit((self._harmonics[:, : len(light)] @ both).astype(float), 2)
        opened = (more - out) / STEP
        mean = self.sky.mean_over_rays
        return np.asarray(
            mean(out * change + opened * falling) - mean(opened) * (self._hidden[:, : len(light)] @ light)
        )

    @cached_property
    def exitant(self) -> Floats:
        """Cosines (m,) of the field's rays, none below the horizon."""
        return np.clip(self.field.ray_cosines, 0, 1)

    @cached_property
    def _sky_exitant(self) -> Floats:
        """The same of the sky's rays."""
        return np.clip(self.sky.ray_cosines, 0, 1)

    @cached_property
    def _harmonics(self) -> Singles:
        """Harmonics (m, (l_max + 1)^2) at the normals of the sky's rays."""
        return evaluate_harmonics(self.sky.normals, self.l_max).astype(np.float32)

    @cached_property
    def _hidden(self) -> Singles:
        """Rows (n, (l_max + 1)^2) of the irradiance that a mesh keeps off; one row of zeros of what has no shadows."""
        if self.shadows is None:
            return np.zeros((1, (self.l_max + 1) ** 2), np.float32)
        parts = blocks(self.sky, _RAYS_AT_A_TIME)
        hidden = [self.shadows.hidden_rows(part, self.l_max).astype(np.float32) for _, part in parts]
        return np.concatenate(hidden)

    def lobe_rows(self, state: BlindState, l_max: int) -> Singles:
        """Rows (n, (l_max + 1)^2) of samples over the lighting, of the specular part per unit of Ks."""
        if not self._between(state):
            parts = state.form.parts
            rows = sum(share * self._at(state, l_max, factor) for share, factor in parts)
            return self.field.filtered(np.asarray(rows, np.float32))
        nodes, weights, _ = self._printed(state.roughness)
        size = (l_max + 1) ** 2
        both = zip(weights, nodes, strict=True)
        rows = np.asarray(sum(np.tensordot(own, node[:, :, :size], 1) for own, node in both))
        rows *= normalised_fresnel(state.mu, self.sky.ray_cosines)[:, None].astype(np.float32)
        return self.field.filtered(self.sky.mean_over_rays(rows))

    def _between(self, state: BlindState) -> bool:
        """Whether rows are interpolated between two roughnesses, which takes four of each ray."""
        large = 4 * len(self.sky.ray_sample) * (self.l_max + 1) ** 2 > _MOST_NUMBERS
        return state.form is RH01_FORM and not ((self.settled or large) and self.transfer == "exact")

    def lobe_slopes(self, state: BlindState, light: Floats) -> tuple[Floats, Floats]:
        """Derivatives (n, c) of what samples see of lighting ((l_max + 1)^2, c) by log sigma and by log(mu - 1)."""
        single = light.astype(np.float32)
        if not self._between(state):
            by_sigma, by_mu = np.zeros((2, len(self.field), light.shape[1]))
            for share, factor in state.form.parts:
                (_, of_sigma, of_mu), *_ = self._form(state, degree_of(len(light)), factor)
                by_sigma += share * _widens(factor, state.roughness) * (of_sigma @ single)
                by_mu += share * (of_mu @ single)
            return self.field.filtered(by_sigma), self.field.filtered(by_mu)
        nodes, *weights = self._printed(state.roughness)
        parts = [node[:, :, : len(light)] @ single for node in nodes]
        seen, widened = (np.einsum("nj,njmc->mc", w, parts).astype(float) for w in weights)
        fresnel, change = fresnel_with_slope(state.mu, self.sky.ray_cosines)
        mean, filtered = self.sky.mean_over_rays, self.field.filtered
        return filtered(mean(fresnel[:, None] * widened)), filtered(mean(change[:, None] * seen))

    def number_slope(self, state: BlindState, light: Floats, name: str) -> tuple[Floats, Floats]:
        """Derivatives of what is seen of lighting ((l_max + 1)^2, c) by one of the form's numbers.

        Of the base and of the lobe, (n, c) each.
        """
        l_max, base, lobe = degree_of(len(light)), np.zeros((1, 1)), np.zeros((1, 1))
        if name == "coat":
            more = replace(state, form=further(state.form, name))
            base = (self.base_rows(more, l_max) - self.base_rows(state, l_max)) @ light / STEP
        elif name == "haze":
            core, haze = (self._at(state, l_max, factor) for _, factor in state.form.parts)
            lobe = self.field.filtered((haze - core) @ light)
        else:
            _, (share, factor) = state.form.parts
            (_, wider, _), *_ = self._form(state, l_max, factor)
            lobe = self.field.filtered(share * _widens(factor, state.roughness) * (wider @ light))
        return base, lobe

    def off_borders(self, sources: Floats) -> Mask:
        """Which samples (n,) are clear of the borders of the shadows that sources cast; all without shadows.

        sources : (k, 3) or (k, 4), as a state has them.
        """
        steady = np.ones(len(self.field.ray_sample), bool)
        if self.shadows is not None:
            towards = np.moveaxis(self.towards(sources)[0], -2, 0)
            for direction, sees in zip(towards, self.free(sources).T, strict=True):
                for seen, _ in self.shadows.around(self.field, direction, _PENUMBRA):
                    steady &= seen == sees
        return np.asarray(self.field.mean_over_rays(steady.astype(float)) == 1)

    def off_edges(self, sigma: float) -> Mask:
        """Which samples (n,) have none of the mesh's edges in the lobe, where one ray can't stand for all of it."""
        clear = np.ones(len(self.field.ray_sample), bool)
        if self.shadows is not None:
            for width in np.minimum(_LOBE, _WIDEST / sigma):
                for seen, rises in self.shadows.around(self.field, self.field.mirrored, width * sigma):
                    clear &= (seen == self.field.reflected_visible) | ~rises
        return np.asarray(self.field.mean_over_rays(clear.astype(float)) == 1)

    def _at(self, state: BlindState, l_max: int, factor: float) -> Singles:
        """Rows (n, (l_max + 1)^2) of samples of one lobe of a form, so many times as wide as sigma."""
        lobes, *way = self._form(state, l_max, factor)
        return np.tensordot(np.array([1, *way], np.float32), lobes, 1)

    def _form(self, state: BlindState, l_max: int, factor: float) -> tuple[Singles, float, float]:
        """Rows of samples and their slopes, (3, n, k), near a state, and the way to it in log sigma and in log(mu - 1).

        factor : width of the lobe over sigma. The last are kept: who solves at a state asks for slopes there, and most
        steps of a search are its last, tiny ones.
        """
        width = float(part_width(factor, state.roughness))
        for (form, degree, mu, sigma), lobes in self._last.items():
            if (form, degree) == (state.form.lobe, l_max) and (mu is None) == (state.mu is None):
                wider = np.log(width / sigma)
                denser = 0.0 if mu is None or state.mu is None else np.log((state.mu - 1) / (mu - 1))
                if max(abs(wider), abs(denser)) <= _ALONG:
                    return lobes, float(wider), float(denser)
        while len(self._last) >= len(state.form.parts):
            del self._last[next(iter(self._last))]
        self._nodes.clear()
        lobe = state.form.lobe
        seen = np.ones(1) if self.shadows is None else self.sky.reflected_visible
        if lobe is RH01_FORM:
            lobes = self._printed_near(l_max, state.mu, width, seen)
        else:
            lobes = mean_form_rows(self.sky, l_max, lobe, state.mu, width, seen)
        self._last[lobe, l_max, state.mu, width] = lobes
        return lobes, 0.0, 0.0

    def _printed_near(
        self, l_max: int, mu: float | None, sigma: float, seen: NDArray[np.floating] | NDArray[np.bool_]
    ) -> Singles:
        """`mean_form_rows` of RH01's lobe; Fresnel's factor, which goes by the ray alone, is each ray's own."""
        at_angles = lobe_table(l_max).at_angles(sigma)
        fresnel, change = fresnel_with_slope(mu, self.sky.ray_cosines)
        # Fresnel's factor changes rows alone.
        factors = [(0, fresnel * seen), (1, fresnel * seen), *([] if mu is None else [(0, change * seen)])]
        rows = mean_lobe_rows(self.sky, at_angles, factors)
        return rows if mu is not None else np.concatenate([rows, np.zeros_like(rows[:1])])

    def _printed(self, sigma: float) -> tuple[list[Singles], Singles, Singles]:
        """RH01's lobe at the two roughnesses around sigma, and weights that make of them rows and slopes at sigma.

        Returns rows and slopes (2, m, k) of both, (2, 2) weights of theirs for the rows at sigma, and (2, 2) for the
        slopes in log sigma, without Fresnel's factor. Few roughnesses are computed in a whole search, since it ends
        between two.
        """
        position = np.log(sigma) / _SPACING
        low = int(np.floor(position))
        for node in self._nodes.keys() - {low, low + 1}:
            del self._nodes[node]
            self._last.clear()
        nodes = [self._node(low), self._node(low + 1)]
        t = position - low
        # Hermite's cubics, of values and slopes at both ends.
        value = np.array(
            [[(1 + 2 * t) * (1 - t) ** 2, t * (1 - t) ** 2], [t**2 * (3 - 2 * t), t**2 * (t - 1)]]
        )
        slope = np.array([[6 * t * (t - 1), (1 - t) * (1 - 3 * t)], [6 * t * (1 - t), t * (3 * t - 2)]])
        units = np.array([1, _SPACING])
        return nodes, (value * units).astype(np.float32), (slope * units / _SPACING).astype(np.float32)

    def _node(self, node: int) -> Singles:
        """Rows and slopes (2, m, k) at a roughness, zero where a mesh stands in the mirror direction of the view."""
        if node not in self._nodes:
            rows = specular_rows(self.sky, self.l_max, float(np.exp(node * _SPACING)), self.transfer)
            if self.shadows is not None:
                rows *= self.sky.reflected_visible[:, None]
            self._nodes[node] = rows
        return self._nodes[node]


def pooled(
    photos: Sequence[LightField], numbers: Sequence[int], transfer: Transfer, shadows: Shadows | None
) -> tuple[list[list[int]], list[LightingDesign]]:
    """Photographs as designs for uniform light, many with few samples in one, and which of them each holds.

    numbers : of their lightings.
    """
    together, frame = pools(photos, numbers), LampFrame.of(photos)
    designs = [
        LightingDesign.of([photos[k] for k in pool], 0, numbers[pool[0]], transfer, shadows, frame=frame)
        for pool in together
    ]
    return together, designs


def _irradiance(field: LightField, l_max: int, shadows: Shadows | None) -> Singles:
    """Irradiance (n, (l_max + 1)^2) of samples."""
    rows = field.mean_over_rays(irradiance_operator(field.normals, l_max))
    if shadows is not None:
        rows = rows - shadows.hidden_rows(field, l_max)
    return rows.astype(np.float32)


def _widens(factor: float, sigma: float) -> float:
    """1 where a part of a form widens with sigma and its factor, 0 where it is as wide as can be."""
    return float(part_width(factor, sigma) == factor * sigma)
