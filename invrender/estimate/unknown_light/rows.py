"""Rows of the linear problem: what samples see of the coefficients of their lighting and of its sources, and slopes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.form import Angles
from invrender.estimate.unknown_light.derivatives import STEP, denser, fresnel_with_slope, further
from invrender.estimate.unknown_light.lighting_design import LightingDesign
from invrender.estimate.unknown_light.state import BlindState, turns
from invrender.transport.diffuse_base import base_share

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]


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

    @property
    def per_diffuse(self) -> Floats:
        """Rows (n, k + j) of the base per unit of Kd, which take up twice what is kept."""
        return np.hstack([self.sky_diffuse, self.lamps_diffuse])

    @property
    def per_specular(self) -> Floats:
        """Rows (n, k + j) of the specular part per unit of Ks; (1, k + j) zeros without a lobe."""
        return np.hstack([self.sky_specular, self.lamps_specular])

    def of_channel(self, specular_share: float) -> Floats:
        """Rows (n, k + j) of one channel."""
        rows, share = self.per_diffuse, np.float64(specular_share)
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
    mean, free = design.field.mean_over_rays, design.free(state.directions)
    falling = design.within(mean(_falling(design, state.directions, state) * free))
    if state.sigma is None:
        return falling, np.zeros((1, falling.shape[1]))
    return falling, design.within(mean(_highlights(design, state.directions, state) * free))


def slopes_of(design: LightingDesign, state: BlindState, rows: LightingRows, light: Floats) -> Floats:
    """Derivatives (n, 3, parameters of a channel) of radiance, in the order of `BlindState.own`.

    light : (k + j, 3), coefficients and the sources' irradiances. What sees a source is taken to see it after a small
    turn, too.
    """
    normals, mean, specular_share = design.field.normals, design.field.mean_over_rays, state.specular_share
    free = design.free(state.directions)
    coefficients, irradiances = np.split(light, [len(light) - len(state.directions)])
    ends = turns(state.directions, STEP).reshape(2 * len(state.directions), 3)
    cosines, turned = normals @ state.directions.T, (normals @ ends.T).reshape(*free.shape, 2)
    falling = _falling(design, state.directions, state)
    slopes = (
        (_falling(design, ends, state).reshape(turned.shape) - falling[..., None]) / STEP * free[..., None]
    )
    by_turn = (1 - specular_share) * mean(slopes)[..., None]
    columns = []
    if state.sigma is not None:
        diffuse, specular = rows.parts(light)
        columns.append(specular - diffuse)
        by_sigma, by_mu = design.lobe_slopes(state, coefficients)
        angles = _angles(design, state.directions)
        highlights, of_sigma, of_mu = _with_slopes(angles, state)
        by_sigma += mean((of_sigma * free) @ irradiances)
        by_mu += mean((of_mu * free) @ irradiances)
        if state.mu is not None:
            by_base = (_falling(design, state.directions, state, denser(state.mu)) - falling) / STEP
            base = design.base_slope(state, coefficients) + mean(by_base * free) @ irradiances
            columns.append(design.within(specular_share * by_mu + (1 - specular_share) * base))
        columns.append(design.within(specular_share * by_sigma))
        for name in state.form.numbers:
            base, lobe = design.number_slope(state, coefficients, name)
            more = replace(state, form=further(state.form, name))
            lit = (_falling(design, state.directions, more) - falling) / STEP * free
            shown = (more.form.reflected(angles, more.mu, more.roughness) - highlights) / STEP * free
            of_lobe = lobe + mean(shown @ irradiances)
            columns.append(
                design.within(
                    specular_share * of_lobe + (1 - specular_share) * (base + mean(lit) @ irradiances)
                )
            )
        slopes = (_highlights(design, ends, state).reshape(turned.shape) - highlights[..., None]) / STEP
        # At the horizon a highlight ends abruptly: a ray there says nothing of a small turn.
        same_side = free[..., None] & ((turned > 0) == (cosines > 0)[..., None])
        by_turn = by_turn + specular_share * mean(np.where(same_side, slopes, 0))[..., None]
    of_sources = np.moveaxis(by_turn * irradiances[:, None], -1, 1).reshape(len(design.field), 3, len(ends))
    return np.concatenate([*(column[..., None] for column in columns), design.within(of_sources)], axis=-1)


def _falling(
    design: LightingDesign, directions: Floats, state: BlindState, mu: float | None = None
) -> Floats:
    """Radiance (m, j) of rays from sources of unit irradiance in directions (j, 3), per unit of Kd.

    mu : in place of the state's.
    """
    cos = np.clip(design.field.normals @ directions.T, 0, 1)
    if not state.form.interface and state.form.coat is None:
        return cos
    return cos * base_share(state.form, mu or state.mu, cos, design.exitant[:, None])


def _highlights(design: LightingDesign, directions: Floats, state: BlindState) -> Floats:
    """Radiance (m, j) of rays from sources of unit irradiance in directions (j, 3), per unit of Ks."""
    return state.form.reflected(_angles(design, directions), state.mu, state.roughness)


def _with_slopes(angles: Angles, state: BlindState) -> tuple[Floats, Floats, Floats]:
    """`_highlights` (m, j) of a state's sources, and their derivatives by log sigma and by log(mu - 1)."""
    shape, wider = (state.form.shape(angles, state.roughness * np.exp(way)) for way in (0, STEP))
    fresnel, by_mu = fresnel_with_slope(state.mu, np.clip(state.form.fresnel_cosine(angles), 0, 1))
    return fresnel * shape, fresnel * (wider - shape) / STEP, by_mu * shape


def _angles(design: LightingDesign, directions: Floats) -> Angles:
    return Angles.between(design.field.normals[:, None], directions, design.field.views[:, None])
