"""Light that bounces between the parts of a textured object, each of its own Kd, and Ks.

What bounces is predicted from the textures, and these are solved for with it, in turns, on a subset of the points, at
one mu and sigma. All parts send light as the seen point next to them does. In folds it may outshine the lighting
itself: so it is added to a point's transfers, and is taken off its radiance only once it is known.

Photographs say less of it here. Under one light, what bounces onto a matte point is the same in all of them and passes
for albedo. So the prediction stands unless they speak against it, in two ways: by what the points leave unexplained,
each with the Kd and Ks that suit it best; and by how bright the albedo would be where little but bounced light arrives,
since the albedo doesn't depend on shadows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from invrender.brdf.microfacet import Microfacet
from invrender.estimate.interreflection.correction import corrected, settled
from invrender.estimate.interreflection.statement import Interreflection, asked_for, of_all, stated
from invrender.estimate.textured.fit import TexturedFit
from invrender.estimate.textured.layout import SurfacePoints
from invrender.estimate.textured.search import solved
from invrender.estimate.textured.seen import Seen
from invrender.estimate.textured.texel_equations import PointValues, TexelEquations, determined, products
from invrender.transport.radiosity import Bounced, ConcaveMesh
from invrender.transport.transfer import LightElement
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Ints = NDArray[np.int64]

# How many times likelier photographs must make it that nothing bounces than the prediction, for it to be left in:
# rendered without, as real ones never are.
_ODDS = 10.0
# Share of the irradiance by the lighting itself up to which a point lies in shadow. How near the albedo there comes to
# that elsewhere, in so many pieces of photographs at least.
_SHADOW, _ALBEDO_NEAR, _PIECES = 0.3, 0.1, 4
# Share of the determined points whose Kd, or Ks, bounds that of the others.
_BRIGHT = 0.9
# Points whose normals are opposite are as far apart as others at this share of the object's size: a thin wall's sides
# may differ in albedo.
_SIDES = 0.1


@dataclass(frozen=True, eq=False)
class CorrectedTextures:
    """A fit with bounced light accounted for.

    bounced : per lighting, what was taken off; nothing if it wasn't. unsure_at : by what shares of themselves Kd and Ks
    of points, (n, 6), aren't certain for it.
    """

    fit: TexturedFit
    found: Interreflection
    bounced: Mapping[str, Bounced]
    unsure_at: Callable[[SurfacePoints], Floats]


@dataclass(frozen=True, eq=False)
class _Sent:
    """What parts send each other under each lighting; as transfers, and as radiance, (r, 3) each, of the rows."""

    bounced: Mapping[str, Bounced]
    transfers: Sequence[Floats]
    radiance: Floats


@dataclass(frozen=True, eq=False)
class _TexturedEvidence:
    """What photographs as they are show of points, in rows of all photographs.

    direct : diffuse and specular transfers, (r, 3) each, by the lighting itself, at the first fit's mu and sigma.
    fits : to photographs as they are; then that without what bounces.
    """

    parts: ConcaveMesh
    elements: Mapping[str, Sequence[LightElement]]
    photos: Sequence[Seen]
    points: SurfacePoints
    direct: Sequence[Floats]
    fits: list[TexturedFit]

    @cached_property
    def at(self) -> Ints:
        """The point (r,) of each row."""
        return np.concatenate([seen.points.points for seen in self.photos])

    @cached_property
    def shown(self) -> Sequence[Floats]:
        return [np.concatenate([seen.radiance for seen in self.photos])]

    @cached_property
    def weight(self) -> Floats:
        noise = self.fits[0].noise
        return np.concatenate(
            [1 / (noise.variance(seen.brightness) * seen.share[:, None]) for seen in self.photos]
        )

    @cached_property
    def tiles(self) -> Ints:
        """The tile (r,) of a photograph that each row is in."""
        firsts = np.cumsum([0, *(seen.tiles.max(initial=-1) + 1 for seen in self.photos)])
        return np.concatenate([seen.tiles + k for seen, k in zip(self.photos, firsts[:-1], strict=True)])

    @cached_property
    def values(self) -> PointValues:
        """Kd and Ks of all points by the lighting itself."""
        return self.solved([np.zeros_like(of) for of in self.direct])

    @cached_property
    def known(self) -> NDArray[np.bool_]:
        """Which points that determines."""
        return determined(self.values)

    @cached_property
    def next_to(self) -> Ints:
        """The known point (f,) next to the middle of each face, on its side of a wall."""
        body, known = self.parts.body, np.flatnonzero(self.known)
        apart = _SIDES * float(np.ptp(body.mesh.vertices, axis=0).max()) / 2
        middles = body.mesh.vertices[body.mesh.faces].mean(axis=1)
        tree = cKDTree(np.column_stack([self.points.positions, apart * self.points.facets])[known])
        return known[tree.query(np.column_stack([middles, apart * body.facets]))[1]]

    def sent(self, values: PointValues) -> _Sent:
        """What bounces by Kd and Ks of the points."""
        brdf = self.fits[0].brdf
        of_faces = replace(brdf, kd=values.kd[self.next_to], ks=values.ks[self.next_to])
        bounced = {
            name: self.parts.bounced(of, np.ones((len(of), 3)), of_faces)
            for name, of in self.elements.items()
        }
        rays = [bounced[seen.lighting].reflected(seen.pixels, brdf) for seen in self.photos]
        d, s = _in_rows(
            (seen, [seen.pixels.mean_over_rays(of) for of in both])
            for seen, both in zip(self.photos, rays, strict=True)
        )
        kd, ks = (no_brighter(of, self.known)[self.at] for of in (values.kd, values.ks))
        return _Sent(bounced, (d, s), kd * d + ks * s)

    def solved(self, by_mesh: Sequence[Floats]) -> PointValues:
        """Kd and Ks of all points, lit by parts of the mesh, too."""
        d, s = _sum(self.direct, by_mesh)
        added = np.zeros((len(self.points), 18))
        np.add.at(added, self.at, products(d, s, self.shown[0], self.weight))
        count = np.bincount(self.at, minlength=len(self.points)).astype(float)
        return solved(self.fits[0].model, TexelEquations.of(added, count))

    def radiance(self, light: _Sent) -> Sequence[Floats]:
        return [light.radiance]

    def agreed(self) -> _Sent | None:
        fit = settled(self.values, lambda values: list(self.sent(values).transfers), self.solved, self.direct)
        return None if fit is None else self.sent(fit)

    def judged(self, light: _Sent) -> Interreflection:
        values = self.solved(light.transfers)
        # What has a Kd and Ks only with bounced light, or only without it, is evidence for neither.
        known = self.known & determined(values)
        asked, std = _together(
            asked_for(
                [self.tiles],
                [self.weight * known[self.at, None]],
                [self._residual(self.values, self.direct)],
                [self._residual(values, _sum(self.direct, light.transfers))],
            ),
            self._asked_in_shadow(light, known),
        )
        pairs = (self.fits[0], self.values), (self.fits[-1], values)
        before, after = (
            replace(fit.brdf, kd=of.kd[known].mean(axis=0), ks=of.ks[known].mean(axis=0)) for fit, of in pairs
        )
        as_they_are, better = (fit.candidates[fit.chosen].error for fit, _ in pairs)
        found = stated(self.shown, [light.radiance], (asked, std), (as_they_are, better), (before, after))
        return replace(found, taken_off=bool((asked - 1) ** 2 - asked**2 < 2 * np.log(_ODDS) * std**2))

    def _residual(self, values: PointValues, transfers: Sequence[Floats]) -> Floats:
        d, s = transfers
        return self.shown[0] - (values.kd[self.at] * d + values.ks[self.at] * s)

    def _asked_in_shadow(self, light: _Sent, known: NDArray[np.bool_]) -> tuple[float, float]:
        """How many times the bounced light makes the albedo in shadow as bright as elsewhere, and its deviation.

        Infinite where the photographs show too little of it: pieces are tiles of photographs.
        """
        kd, ks = (np.median(of[known], axis=0) for of in (self.values.kd, self.values.ks))
        (d, s), (by_mesh, mirrored) = self.direct, light.transfers
        dark = d.max(axis=1) < _SHADOW * (d + by_mesh).max(axis=1)
        lacking = self.shown[0] - kd * d - ks * (s + mirrored)
        times = lacking[dark].sum(axis=1) / np.maximum((kd * by_mesh)[dark].sum(axis=1), 1e-300)
        tiles = self.tiles[dark]
        found = [float(np.median(times[tiles == tile])) for tile in np.unique(tiles)]
        if len(found) < _PIECES:
            return 1.0, np.inf
        spread = float(np.std(found, ddof=1)) / np.sqrt(len(found))
        return max(float(np.mean(found)), 0.0), float(np.hypot(spread, _ALBEDO_NEAR))


def correct_textures(
    parts: ConcaveMesh,
    photos: Sequence[Seen],
    points: SurfacePoints,
    elements: Mapping[str, Sequence[LightElement]],
    direct: Callable[[str, LightField, Microfacet], tuple[Singles, Singles]],
    fit: TexturedFit,
    fitted: Callable[[Sequence[Seen]], TexturedFit],
) -> CorrectedTextures | None:
    """`correction.corrected` on what photographs show of points; None, too, where no point is known.

    direct : what Kd = 1 and what Ks = 1 would show under a lighting, as `transfers_of` has it. fit : to the photographs
    as they are. fitted : to what they show without what bounces.
    """
    by_light = _in_rows((seen, direct(seen.lighting, seen.pixels, fit.brdf)) for seen in photos)
    rows = _TexturedEvidence(parts, elements, photos, points, by_light, [fit])
    if not rows.known.any():
        return None

    def solved_without(light: _Sent, _: TexturedFit | None) -> tuple[TexturedFit, _TexturedEvidence]:
        ends = np.cumsum([len(seen.points) for seen in photos])[:-1]
        less = np.split(light.radiance, ends)
        better = fitted([replace(seen, bounced=off) for seen, off in zip(photos, less, strict=True)])
        shown = [seen.radiance for seen in photos]
        whole = of_all(better.candidates, shown, [np.ones_like(of) for of in shown], less)
        rows.fits.append(replace(better, candidates=whole))
        return rows.fits[-1], rows

    correction = corrected(fit, rows, rows.sent(rows.values), solved_without)
    if correction is None:
        return None
    own, without, known = rows.solved(correction.light.transfers), rows.values, rows.known
    moved = [
        np.abs(after - before)[known] / np.maximum(after[known], 1e-300)
        for after, before in ((own.kd, without.kd), (own.ks, without.ks))
    ]
    unsure = np.minimum(correction.found.doubt * np.concatenate(moved, axis=1), 1)
    near = cKDTree(points.positions[known])
    return CorrectedTextures(
        correction.solution,
        correction.found,
        {} if correction.taken is None else correction.taken.bounced,
        lambda others: unsure[near.query(others.positions)[1]],
    )


def _in_rows(
    photos: Iterable[tuple[Seen, Sequence[NDArray[np.floating]]]],
) -> tuple[Floats, Floats]:
    """Diffuse and specular transfers of photographs' samples (n, 3), in rows of points, (r, 3)."""
    d, s = zip(
        *([seen.points.at_points(of.astype(float)) for of in both] for seen, both in photos), strict=True
    )
    return np.concatenate(d), np.concatenate(s)


def _sum(direct: Sequence[Floats], by_mesh: Sequence[Floats]) -> list[Floats]:
    return [own + more for own, more in zip(direct, by_mesh, strict=True)]


def no_brighter(values: Floats, known: NDArray[np.bool_]) -> Floats:
    """Kd or Ks of points (n, 3); of those that photographs don't determine no brighter than of nearly all others."""
    return np.where(known[:, None], values, np.minimum(values, np.quantile(values[known], _BRIGHT, axis=0)))


def _together(*answers: tuple[float, float]) -> tuple[float, float]:
    """The mean of independent answers with their standard deviations, by these."""
    weights = np.array([1 / max(std, 1e-6) ** 2 for _, std in answers])
    return float(weights @ [value for value, _ in answers] / weights.sum()), float(weights.sum() ** -0.5)
