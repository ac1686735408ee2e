"""What samples of photographs see of unknown lighting: rows of the linear problem, and their slopes.

    B = sum_k L_k [(1 - kappa) D_k + kappa M_k(mu, sigma)]
      + sum_j E_j [(1 - kappa) max(n.d_j, 0) + kappa T(mu, sigma, d_j)]     [RH01, eq. 15, 20, 23]

per channel, in the gauge Kd + Ks = 1; above a base under an interface D_k and the cosine hold what that lets in and out
(`base`), and what a mesh hides of the sky is taken to come in as light from all sides does. M and T are the lobe with
its Fresnel factor, which RH01's form has at theta_o and so outside of all sums over light. A pixel is the mean over its
rays. What a mesh keeps from itself is left out of all of these, by `visibility`'s three rules.
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

from invrender.model.base import base_share, let_through, sky_factors
from invrender.model.formtable import mean_form_rows
from invrender.model.fresnel import normalised_fresnel
from invrender.model.lobes import PRINTED, Angles, LobeForm, part_width
from invrender.model.lobetable import Transfer, lobe_table, mean_lobe_rows, specular_rows
from invrender.model.visibility import Shadows
from invrender.solve.blind.places import less_in_common
from invrender.solve.blind.state import State, turns
from invrender.theory.operator import irradiance_operator
from recon.harmonics import degree_of, evaluate_harmonics
from recon.lightfield import LightField, blocks, joined

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Mask = NDArray[np.bool_]

# Between roughnesses this far apart in log sigma, rows are interpolated by cubics through values and slopes.
_SPACING = 0.1
# Up to so many numbers of rays: 64 MB.
_MOST_NUMBERS = 2**24
# What takes up more of each ray is made of so many at a time.
_RAYS_AT_A_TIME = 16384
# So far along log sigma and log(mu - 1), rows of other forms follow their slopes: to about 1e-6 of the largest.
_ALONG = 1e-3
# Steps of the differences that stand for derivatives: sources' directions, radians; log sigma; log(mu - 1).
_STEP = 1e-6
# Turn of a source, radians, after which what sees it must still see it to count as clear of its shadows' borders; and
# less than that, within which sources cast the same shadows. These are kept of so many directions: a search goes back
# and forth.
_PENUMBRA, _ALIKE, _KEPT_DIRECTIONS = 0.02, 0.01, 100
# Distances from the mirrored ray, in sigma, at which edges are looked for: most of the lobe, up to so many radians.
_LOBE, _WIDEST = (1.0, 2.5), 0.8


# Form, degree, mu and sigma that rows of other forms belong to.
_Shape = tuple[LobeForm, int, float | None, float]


@dataclass(frozen=True, eq=False)
class Sight:
    """Photographs under one lighting with what doesn't change while the BRDF is searched.

    photos : one or more. field : their samples as one's, which is what all arrays go by. l_max : of the lighting.
    transfer : of the lobe, for all but the sources. cos : (m,) exitant, of rays.
    diffuse : (n, (l_max + 1)^2), irradiance, which a Lambertian base sends. lighting : number of the lighting that they
    are under. shadows : of a mesh on itself; None of what has none. settled : whether searches begin near their end:
    then rows of RH01's lobe, too, are kept of samples near one state, not of rays between two roughnesses, which take
    up several times as much; so they are where that would be too much.
    """

    photos: tuple[LightField, ...]
    field: LightField
    l_max: int
    transfer: Transfer
    cos: Floats
    diffuse: Singles
    lighting: int = 0
    shadows: Shadows | None = None
    settled: bool = False
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
    ) -> Sight:
        """Prepare photographs for lighting of degree l_max."""
        samples = joined(photos)
        diffuse = [_irradiance(part, l_max, shadows) for _, part in blocks(samples, _RAYS_AT_A_TIME)]
        cos = np.einsum("nk,nk->n", samples.normals, samples.views)
        single = np.concatenate(diffuse)
        return Sight(tuple(photos), samples, l_max, transfer, cos, single, lighting, shadows, settled)

    def like(self, photos: Sequence[LightField], l_max: int, settled: bool = False) -> Sight:
        """Prepare other samples under the same lighting for another degree."""
        return Sight.of(photos, l_max, self.lighting, self.transfer, self.shadows, settled)

    @cached_property
    def radiance(self) -> Floats:
        """What samples (n, 3) show, as `within` leaves it."""
        return self.within(self.field.radiance)

    def brightness(self, prediction: Floats) -> Floats:
        """Radiance (n, 3) by which noise is judged: as predicted, or as photographed of a painted body."""
        return prediction if self.field.place is None else np.maximum(self.field.radiance, 0)

    def within(self, values: NDArray[np.floating]) -> NDArray[Any]:
        """Values (n, ...) less what photographs of a place have in common on a painted body; as they are on others."""
        if self.field.place is None:
            return values
        left = self._less_in_common.astype(values.dtype) @ values.reshape(len(values), -1)
        return np.asarray(left.reshape(values.shape))

    @cached_property
    def _less_in_common(self) -> csr_array:
        assert self.field.place is not None
        return less_in_common(self.field.place)

    def forget_rows(self) -> None:
        """Leave the memory of rows that are kept from step to step."""
        self._nodes.clear()
        self._last.clear()

    def split(self, values: NDArray[Any]) -> list[NDArray[Any]]:
        """What belongs to samples (n, ...), photograph by photograph."""
        return np.split(values, np.cumsum([len(photo) for photo in self.photos])[:-1])

    def free(self, directions: Floats) -> Mask:
        """Which rays (m, k) see sources in unit directions (k, 3); all do that of what has no shadows.

        Directions nearly alike are taken for one, so that the last steps of a search don't stumble over pixels at the
        borders of shadows, which count for nothing in the end.
        """
        result = np.ones((len(self.cos), len(directions)), bool)
        if self.shadows is None:
            return result
        for k, near in enumerate(np.round(directions / _ALIKE) * _ALIKE):
            key = near.tobytes()
            if key not in self._free:
                while len(self._free) >= _KEPT_DIRECTIONS:
                    del self._free[next(iter(self._free))]
                self._free[key] = self.shadows.free(self.field, near / np.linalg.norm(near))
            result[:, k] = self._free[key]
        return result

    def base_rows(self, state: State, l_max: int) -> NDArray[np.floating]:
        """Rows (n, (l_max + 1)^2) of samples over the lighting, of the base per unit of Kd."""
        size = (l_max + 1) ** 2
        if not state.form.interface and state.form.coat is None:
            return self.diffuse[:, :size]
        out = let_through(state.form, state.mu, self.exitant)
        factors = sky_factors(state.form, state.mu, l_max)
        mean = self.field.mean_over_rays
        clear = mean(self._harmonics[:, :size], out) * factors
        return np.asarray(clear - mean(out)[:, None] * self._hidden[:, :size])

    def base_slope(self, state: State, light: Floats) -> Floats:
        """Derivative (n, c) of what samples see of lighting ((l_max + 1)^2, c) in the base, by log(mu - 1)."""
        if not state.form.interface or state.mu is None:
            return np.zeros((len(self.field), light.shape[1]))
        l_max, mus = degree_of(len(light)), (state.mu, _denser(state.mu))
        out, more = (let_through(state.form, mu, self.exitant)[:, None] for mu in mus)
        factors, further = (sky_factors(state.form, mu, l_max)[:, None] for mu in mus)
        both = np.hstack([factors * light, (further - factors) / _STEP * light]).astype(np.float32)
        falling, change = np.hsplit((self._harmonics[:, : len(light)] @ both).astype(float), 2)
        opened = (more - out) / _STEP
        mean = self.field.mean_over_rays
        return np.asarray(
            mean(out * change + opened * falling) - mean(opened) * (self._hidden[:, : len(light)] @ light)
        )

    @cached_property
    def exitant(self) -> Floats:
        """Cosines (m,) of rays, none below the horizon."""
        return np.clip(self.cos, 0, 1)

    @cached_property
    def _harmonics(self) -> Singles:
        """Harmonics (m, (l_max + 1)^2) at the normals of rays."""
        return evaluate_harmonics(self.field.normals, self.l_max).astype(np.float32)

    @cached_property
    def _hidden(self) -> Singles:
        """Rows (n, (l_max + 1)^2) of the irradiance that a mesh keeps off; one row of zeros of what has no shadows."""
        if self.shadows is None:
            return np.zeros((1, (self.l_max + 1) ** 2), np.float32)
        parts = blocks(self.field, _RAYS_AT_A_TIME)
        hidden = [self.shadows.hidden_rows(part, self.l_max).astype(np.float32) for _, part in parts]
        return np.concatenate(hidden)

    def lobe_rows(self, state: State, l_max: int) -> Singles:
        """Rows (n, (l_max + 1)^2) of samples over the lighting, of the specular part per unit of Ks."""
        if not self._between(state):
            parts = state.form.parts
            return np.asarray(
                sum(share * self._at(state, l_max, factor) for share, factor in parts), np.float32
            )
        nodes, weights, _ = self._printed(state.roughness)
        size = (l_max + 1) ** 2
        both = zip(weights, nodes, strict=True)
        rows = np.asarray(sum(np.tensordot(own, node[:, :, :size], 1) for own, node in both))
        rows *= normalised_fresnel(state.mu, self.cos)[:, None].astype(np.float32)
        return np.asarray(self.field.mean_over_rays(rows))

    def _between(self, state: State) -> bool:
        """Whether rows are interpolated between two roughnesses, which takes four of each ray."""
        large = 4 * len(self.cos) * (self.l_max + 1) ** 2 > _MOST_NUMBERS
        return state.form is PRINTED and not ((self.settled or large) and self.transfer == "exact")

    def lobe_slopes(self, state: State, light: Floats) -> tuple[Floats, Floats]:
        """Derivatives (n, c) of what samples see of lighting ((l_max + 1)^2, c) by log sigma and by log(mu - 1)."""
        single = light.astype(np.float32)
        if not self._between(state):
            by_sigma, by_mu = np.zeros((2, len(self.field), light.shape[1]))
            for share, factor in state.form.parts:
                (_, of_sigma, of_mu), *_ = self._form(state, degree_of(len(light)), factor)
                by_sigma += share * _widens(factor, state.roughness) * (of_sigma @ single)
                by_mu += share * (of_mu @ single)
            return by_sigma, by_mu
        nodes, *weights = self._printed(state.roughness)
        parts = [node[:, :, : len(light)] @ single for node in nodes]
        seen, widened = (np.einsum("nj,njmc->mc", w, parts).astype(float) for w in weights)
        fresnel, change = _fresnel(state.mu, self.cos)
        mean = self.field.mean_over_rays
        return np.asarray(mean(fresnel[:, None] * widened)), np.asarray(mean(change[:, None] * seen))

    def number_slope(self, state: State, light: Floats, name: str) -> tuple[Floats, Floats]:
        """Derivatives of what is seen of lighting ((l_max + 1)^2, c) by one of the form's numbers, as `State` has it.

        Of the base and of the lobe, (n, c) each.
        """
        l_max, base, lobe = degree_of(len(light)), np.zeros((1, 1)), np.zeros((1, 1))
        if name == "coat":
            more = replace(state, form=_more(state.form, name))
            base = (self.base_rows(more, l_max) - self.base_rows(state, l_max)) @ light / _STEP
        elif name == "haze":
            core, haze = (self._at(state, l_max, factor) for _, factor in state.form.parts)
            lobe = (haze - core) @ light
        else:
            _, (share, factor) = state.form.parts
            (_, wider, _), *_ = self._form(state, l_max, factor)
            lobe = share * _widens(factor, state.roughness) * (wider @ light)
        return base, lobe

    def off_borders(self, directions: Floats) -> Mask:
        """Which samples (n,) are clear of the borders of the shadows that sources (k, 3) cast; all without shadows."""
        steady = np.ones(len(self.cos), bool)
        if self.shadows is not None:
            for direction, sees in zip(directions, self.free(directions).T, strict=True):
                for seen, _ in self.shadows.around(self.field, direction, _PENUMBRA):
                    steady &= seen == sees
        return np.asarray(self.field.mean_over_rays(steady.astype(float)) == 1)

    def off_edges(self, sigma: float) -> Mask:
        """Which samples (n,) have none of the mesh's edges in the lobe, where one ray can't stand for all of it."""
        clear = np.ones(len(self.cos), bool)
        if self.shadows is not None:
            for width in np.minimum(_LOBE, _WIDEST / sigma):
                for seen, rises in self.shadows.around(self.field, self.field.mirrored, width * sigma):
                    clear &= (seen == self.field.reflected_visible) | ~rises
        return np.asarray(self.field.mean_over_rays(clear.astype(float)) == 1)

    def _at(self, state: State, l_max: int, factor: float) -> Singles:
        """Rows (n, (l_max + 1)^2) of samples of one lobe of a form, so many times as wide as sigma."""
        lobes, *way = self._form(state, l_max, factor)
        return np.tensordot(np.array([1, *way], np.float32), lobes, 1)

    def _form(self, state: State, l_max: int, factor: float) -> tuple[Singles, float, float]:
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
        seen = np.ones(1) if self.shadows is None else self.field.reflected_visible
        if lobe is PRINTED:
            lobes = self._printed_near(l_max, state.mu, width, seen)
        else:
            lobes = mean_form_rows(self.field, l_max, lobe, state.mu, width, seen)
        self._last[lobe, l_max, state.mu, width] = lobes
        return lobes, 0.0, 0.0

    def _printed_near(
        self, l_max: int, mu: float | None, sigma: float, seen: NDArray[np.floating] | NDArray[np.bool_]
    ) -> Singles:
        """`mean_form_rows` of RH01's lobe; Fresnel's factor, which goes by the ray alone, is each ray's own."""
        at_angles = lobe_table(l_max).at_angles(sigma)
        fresnel, change = _fresnel(mu, self.cos)
        rows, wider = mean_lobe_rows(self.field, at_angles, fresnel * seen)
        if mu is None:
            return np.stack([rows, wider, np.zeros_like(rows)])
        (denser,) = mean_lobe_rows(self.field, at_angles[:, :1], change * seen)
        return np.stack([rows, wider, denser])

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
            rows = specular_rows(self.field, self.l_max, float(np.exp(node * _SPACING)), self.transfer)
            if self.shadows is not None:
                rows *= self.field.reflected_visible[:, None]
            self._nodes[node] = rows
        return self._nodes[node]


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows of samples over the coefficients and then the sources.

    sky_diffuse, sky_specular : (n, k) over the coefficients: what a base of unit Kd sends, and a specular part of unit
    Ks. Single precision, as lobes have them: all that grows with the degree. lamps_diffuse, lamps_specular : (n, j)
    over the sources. The specular ones have one row of zeros without a lobe, where kappa is zero. All are as
    `Sight.within` leaves them.
    """

    sky_diffuse: Singles
    sky_specular: Singles
    lamps_diffuse: Floats
    lamps_specular: Floats

    @property
    def per_diffuse(self) -> Floats:
        """Rows (n, k + j) of the base per unit of Kd, which take up twice what is kept."""
        return np.hstack([self.sky_diffuse, self.lamps_diffuse])

    @property
    def per_specular(self) -> Floats:
        """Rows (n, k + j) of the specular part per unit of Ks; (1, k + j) zeros without a lobe."""
        return np.hstack([self.sky_specular, self.lamps_specular])

    def of_channel(self, kappa: float) -> Floats:
        """Rows (n, k + j) of one channel."""
        rows, share = self.per_diffuse, np.float64(kappa)
        rows *= 1 - share
        if len(self.sky_specular) == len(rows):
            size = self.sky_specular.shape[1]
            rows[:, :size] += share * self.sky_specular
            rows[:, size:] += share * self.lamps_specular
        return rows

    def parts(self, light: Floats) -> tuple[Floats, Floats]:
        """What samples (n, c) see of light (k + j, c) in a base of unit Kd, and in a specular part of unit Ks."""
        sky, lamps = np.split(light, [self.sky_diffuse.shape[1]])
        return (
            self.sky_diffuse @ sky + self.lamps_diffuse @ lamps,
            self.sky_specular @ sky + self.lamps_specular @ lamps,
        )

    def radiance(self, kappa: Floats, light: Floats) -> Floats:
        """What samples (n, 3) see of light (k + j, 3)."""
        diffuse, specular = self.parts(light)
        return (1 - kappa) * diffuse + kappa * specular

    def sums(self, kappa: Floats, values: Floats) -> Floats:
        """Sums (3, k + j, t) over samples of channels' rows times values (3, n, t)."""
        abreast = np.hstack(list(values))
        split = (-1, *values.shape[::2])

        def summed(sky: Singles, lamps: Floats) -> Floats:
            if len(sky) != len(abreast):
                return np.zeros(1)
            both = np.vstack([sky.T @ abreast, lamps.T @ abreast])
            return np.moveaxis(both.reshape(split), 1, 0)

        diffuse = summed(self.sky_diffuse, self.lamps_diffuse)
        specular = summed(self.sky_specular, self.lamps_specular)
        share = kappa[:, None, None]
        return np.asarray((1 - share) * diffuse + share * specular)


def _irradiance(field: LightField, l_max: int, shadows: Shadows | None) -> Singles:
    """Irradiance (n, (l_max + 1)^2) of samples."""
    rows = field.mean_over_rays(irradiance_operator(field.normals, l_max))
    if shadows is not None:
        rows = rows - shadows.hidden_rows(field, l_max)
    return rows.astype(np.float32)


def rows_of(sight: Sight, state: State, l_max: int) -> Rows:
    """Rows at a state, over lighting of degree l_max <= the sight's."""
    base = sight.within(np.asarray(sight.base_rows(state, l_max), np.float32))
    lobe: Singles = np.zeros((1, base.shape[1]), np.float32)
    if state.sigma is not None:
        lobe = sight.within(sight.lobe_rows(state, l_max))
    return Rows(base, lobe, *_lamp_rows(sight, state))


def source_rows(sight: Sight, state: State) -> Rows:
    """`rows_of` over the state's sources alone, (n, j) each."""
    falling, highlights = _lamp_rows(sight, state)
    none = np.zeros((len(falling), 0), np.float32)
    return Rows(none, none[: len(highlights)], falling, highlights)


def _lamp_rows(sight: Sight, state: State) -> tuple[Floats, Floats]:
    """Rows (n, j) over a state's sources, of the base and of the specular part; (1, j) zeros of this without a lobe."""
    mean, free = sight.field.mean_over_rays, sight.free(state.directions)
    falling = sight.within(mean(_falling(sight, state.directions, state) * free))
    if state.sigma is None:
        return falling, np.zeros((1, falling.shape[1]))
    return falling, sight.within(mean(_highlights(sight, state.directions, state) * free))


def slopes_of(sight: Sight, state: State, rows: Rows, light: Floats) -> Floats:
    """Derivatives (n, 3, parameters of a channel) of radiance, in the order of `State.own`.

    light : (k + j, 3), coefficients and the sources' irradiances. What sees a source is taken to see it after a small
    turn, too.
    """
    normals, mean, kappa = sight.field.normals, sight.field.mean_over_rays, state.kappa
    free = sight.free(state.directions)
    coefficients, irradiances = np.split(light, [len(light) - len(state.directions)])
    ends = turns(state.directions, _STEP).reshape(2 * len(state.directions), 3)
    cosines, turned = normals @ state.directions.T, (normals @ ends.T).reshape(*free.shape, 2)
    falling = _falling(sight, state.directions, state)
    slopes = (
        (_falling(sight, ends, state).reshape(turned.shape) - falling[..., None]) / _STEP * free[..., None]
    )
    by_turn = (1 - kappa) * mean(slopes)[..., None]
    columns = []
    if state.sigma is not None:
        diffuse, specular = rows.parts(light)
        columns.append(specular - diffuse)
        by_sigma, by_mu = sight.lobe_slopes(state, coefficients)
        highlights, of_sigma, of_mu = _with_slopes(sight, state)
        by_sigma += mean((of_sigma * free) @ irradiances)
        by_mu += mean((of_mu * free) @ irradiances)
        if state.mu is not None:
            denser = (_falling(sight, state.directions, state, _denser(state.mu)) - falling) / _STEP
            base = sight.base_slope(state, coefficients) + mean(denser * free) @ irradiances
            columns.append(sight.within(kappa * by_mu + (1 - kappa) * base))
        columns.append(sight.within(kappa * by_sigma))
        for name in state.form.numbers:
            base, lobe = sight.number_slope(state, coefficients, name)
            more = replace(state, form=_more(state.form, name))
            lit = (_falling(sight, state.directions, more) - falling) / _STEP * free
            shown = (_highlights(sight, state.directions, more) - highlights) / _STEP * free
            of_lobe = lobe + mean(shown @ irradiances)
            columns.append(sight.within(kappa * of_lobe + (1 - kappa) * (base + mean(lit) @ irradiances)))
        slopes = (_highlights(sight, ends, state).reshape(turned.shape) - highlights[..., None]) / _STEP
        # At the horizon a highlight ends abruptly: a ray there says nothing of a small turn.
        same_side = free[..., None] & ((turned > 0) == (cosines > 0)[..., None])
        by_turn = by_turn + kappa * mean(np.where(same_side, slopes, 0))[..., None]
    of_sources = np.moveaxis(by_turn * irradiances[:, None], -1, 1).reshape(len(sight.field), 3, len(ends))
    return np.concatenate([*(column[..., None] for column in columns), sight.within(of_sources)], axis=-1)


def _falling(sight: Sight, directions: Floats, state: State, mu: float | None = None) -> Floats:
    """Radiance (m, j) of rays from sources of unit irradiance in directions (j, 3), per unit of Kd.

    mu : in place of the state's.
    """
    cos = np.clip(sight.field.normals @ directions.T, 0, 1)
    if not state.form.interface and state.form.coat is None:
        return cos
    return cos * base_share(state.form, mu or state.mu, cos, sight.exitant[:, None])


def _widens(factor: float, sigma: float) -> float:
    """1 where a part of a form widens with sigma and its factor, 0 where it is as wide as can be."""
    return float(part_width(factor, sigma) == factor * sigma)


def _more(form: LobeForm, name: str) -> LobeForm:
    """A form with one of its numbers a small step further on, as `State` counts it."""
    value = form.numbers[name]
    return form.with_numbers({name: value * np.exp(_STEP) if name == "spread" else value + _STEP})


def _denser(mu: float) -> float:
    """mu a small step further on in log(mu - 1)."""
    return float(1 + (mu - 1) * np.exp(_STEP))


def _highlights(sight: Sight, directions: Floats, state: State) -> Floats:
    """Radiance (m, j) of rays from sources of unit irradiance in directions (j, 3), per unit of Ks."""
    return state.form.reflected(_angles(sight, directions), state.mu, state.roughness)


def _with_slopes(sight: Sight, state: State) -> tuple[Floats, Floats, Floats]:
    """`_highlights` (m, j) of a state's sources, and their derivatives by log sigma and by log(mu - 1)."""
    angles = _angles(sight, state.directions)
    shape, wider = (state.form.shape(angles, state.roughness * np.exp(way)) for way in (0, _STEP))
    fresnel, by_mu = _fresnel(state.mu, np.clip(state.form.fresnel_cosine(angles), 0, 1))
    return fresnel * shape, fresnel * (wider - shape) / _STEP, by_mu * shape


def _angles(sight: Sight, directions: Floats) -> Angles:
    return Angles.between(sight.field.normals[:, None], directions, sight.field.views[:, None])


def _fresnel(mu: float | None, cos: Floats) -> tuple[Floats, Floats]:
    """Fresnel's factor at cosines (m,), and its slope in log(mu - 1)."""
    if mu is None:
        return np.ones_like(cos), np.zeros_like(cos)
    at, more = (normalised_fresnel(each, cos) for each in (mu, _denser(mu)))
    return at, (more - at) / _STEP
