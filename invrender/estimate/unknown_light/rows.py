"""Rows of the linear problem: what samples see of the coefficients of their lighting and of its sources, and slopes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from capture.lighting import cosines
from invrender.brdf.form import Angles
from invrender.estimate.unknown_light.derivatives import STEP, denser, fresnel_with_slope, further
from invrender.estimate.unknown_light.lighting_design import LightingDesign
from invrender.estimate.unknown_light.state import BlindState, turns
from invrender.transport.diffuse_base import base_share

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Ints = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class LightingRows:
    """Rows of samples over the coefficients and then the sources.

    sky_diffuse, sky_specular : (n, k) over the coefficients: what a base of unit Kd sends, and a specular part of unit
    Ks. Single precision, as lobes have them: all that grows with the degree. lamps_diffuse, lamps_specular : (n, j)
    over the sources. The specular ones have one row of zeros without a lobe, where the specular share is zero. All are
    as `LightingDesign.within` leaves them.
    """

    sky_diffuse: Singles
    sky_specular: Singles
    lamps_diffuse: Floats
    lamps_specular: Floats

    def of_channel(self, specular_share: float, times: Floats | None = None) -> Floats:
        """Rows (n, k + j) of one channel, each times its own factor, (n,), if there are any."""
        times = np.ones(1) if times is None else times
        shares = [(share * times)[:, None] for share in (1 - specular_share, specular_share)]
        # All of the sky in its own precision: numpy takes four times as long over products of two.
        base, lobe = (share.astype(np.float32) for share in shares)
        sky = base * self.sky_diffuse + lobe * self.sky_specular
        return np.hstack([sky, shares[0] * self.lamps_diffuse + shares[1] * self.lamps_specular])

    def of_channels(self, specular_share: Floats) -> Floats:
        """Rows (3, n, k + j) of all channels."""
        return np.stack([self.of_channel(share) for share in specular_share])

    def where(self, chosen: NDArray[np.bool_]) -> LightingRows:
        """Rows of some samples (n,)."""
        lobe = chosen if len(self.sky_specular) == len(chosen) else slice(None)
        return LightingRows(
            self.sky_diffuse[chosen],
            self.sky_specular[lobe],
            self.lamps_diffuse[chosen],
            self.lamps_specular[lobe],
        )

    def parts(self, light: Floats) -> tuple[Floats, Floats]:
        """What samples (n, c) see of light (k + j, c) in a base of unit Kd, and in a specular part of unit Ks."""
        sky, lamps = np.split(light, [self.sky_diffuse.shape[1]])
        return (
            self.sky_diffuse @ sky + self.lamps_diffuse @ lamps,
            self.sky_specular @ sky + self.lamps_specular @ lamps,
        )

    def radiance(self, specular_share: Floats, light: Floats) -> Floats:
        """What samples (n, 3) see of light (k + j, 3)."""
        diffuse, specular = self.parts(light)
        return (1 - specular_share) * diffuse + specular_share * specular

    def sums(self, specular_share: Floats, values: Floats) -> Floats:
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
        share = specular_share[:, None, None]
        return np.asarray((1 - share) * diffuse + share * specular)


def rows_of(design: LightingDesign, state: BlindState, l_max: int) -> LightingRows:
    """Rows at a state, over lighting of degree l_max <= the design's."""
    base = design.within(np.asarray(design.base_rows(state, l_max), np.float32))
    lobe: Singles = np.zeros((1, base.shape[1]), np.float32)
    if state.sigma is not None:
        lobe = design.within(design.lobe_rows(state, l_max))
    return LightingRows(base, lobe, *_lamp_rows(design, state))


def source_rows(design: LightingDesign, state: BlindState) -> LightingRows:
    """`rows_of` over the state's sources alone, (n, j) each."""
    falling, highlights = _lamp_rows(design, state)
    none = np.zeros((len(falling), 0), np.float32)
    return LightingRows(none, none[: len(highlights)], falling, highlights)


def _lamp_rows(design: LightingDesign, state: BlindState) -> tuple[Floats, Floats]:
    """Rows (n, j) over a state's sources, of the base and of the specular part; (1, j) zeros of this without a lobe."""
    mean, free = design.field.mean_over_rays, design.free(state.sources)
    lamps = _Lamps.of(design, state.sources)
    falling = design.within(mean(lamps.falling(state) * free))
    if state.sigma is None:
        return falling, np.zeros((1, falling.shape[1]))
    return falling, design.within(mean(lamps.highlights(state) * free))


def slopes_of(design: LightingDesign, state: BlindState, rows: LightingRows, light: Floats) -> Floats:
    """Derivatives (n, 3, parameters of a channel) of radiance, in the order of `BlindState.own`.

    light : (k + j, 3), coefficients and the sources' irradiances. What sees a source is taken to see it after a small
    move, too.
    """
    mean, specular_share = design.field.mean_over_rays, state.specular_share
    free = design.free(state.sources)
    coefficients, irradiances = np.split(light, [len(light) - len(state.directions)])
    lamps, columns = _Lamps.of(design, state.sources), []
    falling = lamps.falling(state)
    if state.sigma is not None:
        diffuse, specular = rows.parts(light)
        columns.append(specular - diffuse)
        by_sigma, by_mu = design.lobe_slopes(state, coefficients)
        highlights, of_sigma, of_mu = lamps.with_slopes(state)
        by_sigma += mean((of_sigma * free) @ irradiances)
        by_mu += mean((of_mu * free) @ irradiances)
        if state.mu is not None:
            by_base = (lamps.falling(state, denser(state.mu)) - falling) / STEP
            base = design.base_slope(state, coefficients) + mean(by_base * free) @ irradiances
            columns.append(design.within(specular_share * by_mu + (1 - specular_share) * base))
        columns.append(design.within(specular_share * by_sigma))
        for name in state.form.numbers:
            base, lobe = design.number_slope(state, coefficients, name)
            more = replace(state, form=further(state.form, name))
            # A coat changes the base alone, all else the lobe.
            if name == "coat":
                base = base + mean((lamps.falling(more) - falling) / STEP * free) @ irradiances
            else:
                lobe = lobe + mean(((lamps.highlights(more) - highlights) / STEP * free) @ irradiances)
            columns.append(design.within(specular_share * lobe + (1 - specular_share) * base))
    else:
        highlights = np.zeros((1, 1))

    def moved(ends: Floats, of: Ints) -> Floats:
        """Derivatives (n, 3, e) by what moves sources to others, (e, 3) or (e, 4); of : (e,), which they are."""
        there, sees = _Lamps.of(design, ends), free[:, of]
        by_move = (1 - specular_share) * mean((there.falling(state) - falling[:, of]) / STEP * sees)[
            ..., None
        ]
        if state.sigma is not None:
            change = (there.highlights(state) - highlights[:, of]) / STEP
            # At the horizon a highlight ends abruptly: a ray there says nothing of a small move.
            same_side = sees & ((there.cosines > 0) == (lamps.cosines > 0)[:, of])
            by_move = by_move + specular_share * mean(np.where(same_side, change, 0))[..., None]
        return np.moveaxis(by_move * irradiances[of], -1, 1)

    ends = turns(state.directions, STEP).reshape(-1, 3)
    turned = np.repeat(np.arange(len(state.directions)), 2)
    if state.closeness is not None:
        ends = np.column_stack([ends, state.closeness[turned]])
    of_sources = [moved(ends, turned)]
    if state.near:
        of_sources.append(moved(state.sources[state.near] + [0, 0, 0, STEP], np.array(state.near)))
    of_sources = [design.within(part) for part in of_sources]
    return np.concatenate([*(column[..., None] for column in columns), *of_sources], axis=-1)


@dataclass(frozen=True, eq=False)
class _Lamps:
    """Sources of unit irradiance at the object's centre, as rays see them.

    directions : (j, 3) or (m, j, 3) unit, and factors : (j,) or (m, j), of irradiance.
    """

    design: LightingDesign
    directions: Floats
    factors: Floats

    @staticmethod
    def of(design: LightingDesign, sources: Floats) -> _Lamps:
        return _Lamps(design, *design.towards(sources))

    @cached_property
    def cosines(self) -> Floats:
        """Of incidence (m, j), negative below the horizon."""
        return cosines(self.design.field.normals, self.directions)

    @cached_property
    def angles(self) -> Angles:
        """With the views, (m, j)."""
        field = self.design.field
        return Angles.between(field.normals[:, None], self.directions, field.views[:, None])

    def falling(self, state: BlindState, mu: float | None = None) -> Floats:
        """Radiance (m, j) of rays per unit of Kd; mu : in place of the state's."""
        cos = np.clip(self.cosines, 0, 1)
        if not state.form.interface and state.form.coat is None:
            return cos * self.factors
        return cos * self.factors * base_share(state.form, mu or state.mu, cos, self.design.exitant[:, None])

    def highlights(self, state: BlindState) -> Floats:
        """Radiance (m, j) of rays per unit of Ks."""
        lobe = state.form.reflected(self.angles, state.mu, state.roughness) * self.factors
        return self.design.field.filtered(lobe)

    def with_slopes(self, state: BlindState) -> tuple[Floats, Floats, Floats]:
        """`highlights` (m, j), and their derivatives by log sigma and by log(mu - 1)."""
        shape, wider = (
            state.form.shape(self.angles, state.roughness * np.exp(way)) * self.factors for way in (0, STEP)
        )
        cos = np.clip(state.form.fresnel_cosine(self.angles), 0, 1)
        fresnel, by_mu = fresnel_with_slope(state.mu, cos)
        filtered = self.design.field.filtered
        return (
            filtered(fresnel * shape),
            filtered(fresnel * (wider - shape) / STEP),
            filtered(by_mu * shape),
        )
