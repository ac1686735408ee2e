"""Light that bounces between the parts of a textured object, each of its own Kd, and Ks.

As of one BRDF (`invrender.estimate.interreflection`): what bounces is predicted from the textures, and these are solved
for with it, in turns, on a subset of the points. All parts send light as the seen point next to them does. With it
taken off the model is fitted anew.

Photographs say less of it here. Under one light, what bounces onto a matte point is the same in all of them and passes
for albedo. So the prediction stands unless they speak against it, in two ways: by what the points leave unexplained,
each with the Kd and Ks that suit it best; and by how bright the albedo would be where little but bounced light arrives,
since the albedo doesn't depend on shadows. How many times as much of it they ask for is then weighed against what is
known beforehand, that it is about right.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from invrender.brdf.microfacet import Microfacet
from invrender.estimate.interreflection import (
    MATTERS,
    ROUNDS,
    STILL,
    Interreflection,
    asked_for,
    highest_share,
    relaxed,
    rms,
)
from invrender.estimate.textured.fit import TexturedFit
from invrender.estimate.textured.joint import determined
from invrender.estimate.textured.layout import SurfacePoints
from invrender.estimate.textured.search import solved
from invrender.estimate.textured.seen import Seen, transfers_of
from invrender.estimate.textured.texel_equations import PointValues, TexelEquations, products
from invrender.transport.radiosity import Bounced, ConcaveMesh
from invrender.transport.transfer import LightElement
from recon.mesh.bodies import MeshBody

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# How many times the prediction there may be, before photographs were asked: 1, give or take this.
_BEFOREHAND = 0.2
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

    bounced : per lighting, what was taken off; nothing if it wasn't. points : those it was judged by. unsure : (p, 6),
    by what shares of themselves Kd and Ks of each of them aren't certain for it.
    """

    fit: TexturedFit
    found: Interreflection
    bounced: Mapping[str, Bounced]
    points: SurfacePoints
    unsure: Floats

    def unsure_at(self, points: SurfacePoints) -> Floats:
        """By what shares of themselves Kd and Ks of other points, (n, 6), aren't certain."""
        return self.unsure[cKDTree(self.points.positions).query(points.positions)[1]]


@dataclass(frozen=True, eq=False)
class _Shown:
    """A photograph's points with transfers (r, 3), by the lighting itself, at a fit's mu and sigma."""

    seen: Seen
    diffuse: Floats
    specular: Floats
    weight: Floats

    def sums(self, points: int, by_mesh: tuple[Floats, Floats]) -> TexelEquations:
        """Normal equations of all points, parts of the mesh lighting them too."""
        d, s, y, w = self.diffuse + by_mesh[0], self.specular + by_mesh[1], self.seen.radiance, self.weight
        at, added, count = self.seen.points.points, np.zeros((points, 18)), np.zeros(points)
        added[at], count[at] = products(d, s, y, w), 1
        return TexelEquations.of(added, count)

    def residual(self, values: PointValues, by_mesh: tuple[Floats, Floats]) -> Floats:
        at = self.seen.points.points
        predicted = values.kd[at] * (self.diffuse + by_mesh[0]) + values.ks[at] * (self.specular + by_mesh[1])
        return self.seen.radiance - predicted


def account_for_bounces(
    parts: ConcaveMesh,
    photos: Sequence[Seen],
    points: SurfacePoints,
    elements: Mapping[str, Sequence[LightElement]],
    fit: TexturedFit,
    refit: Callable[[Sequence[Seen]], TexturedFit],
) -> CorrectedTextures | None:
    """Take light that bounces off what photographs show of points, if it matters and they bear it out.

    fit : to the photographs as they are. refit : to what they show without it. None where it doesn't matter, or no
    point is known.
    """
    shown = [_shown(seen, elements, fit, parts) for seen in photos]
    nothing = [(np.zeros_like(one.diffuse), np.zeros_like(one.diffuse)) for one in shown]
    without = _values(shown, nothing, fit, len(points))
    known = determined(without)
    if not known.any():
        return None
    next_to = _nearest(parts.body, points, known)
    scale = rms([seen.radiance for seen in photos])
    values, lacking, share = without, None, np.ones(3)
    for _ in range(ROUNDS):
        kd, ks = (of[next_to] for of in (values.kd, values.ks))
        textured = replace(fit.brdf, kd=kd, ks=ks)
        bounced = {name: parts.bounced(of, np.ones((len(of), 3)), textured) for name, of in elements.items()}
        by_mesh = [_by_mesh(one.seen, bounced[one.seen.lighting], fit.brdf) for one in shown]
        less = _less(shown, by_mesh, values, known)
        if lacking is None:
            once = by_mesh, less
            if rms(less) < MATTERS * scale:
                return None
        solved_for = _values(shown, by_mesh, fit, len(points))
        before, lacking = lacking, _both(solved_for)[np.tile(known, 2)] - _both(values)[np.tile(known, 2)]
        if before is not None:
            share = relaxed(share, before, lacking)
        values = replace(
            solved_for,
            kd=values.kd + share * (solved_for.kd - values.kd),
            ks=values.ks + share * (solved_for.ks - values.ks),
        )
        if rms([lacking]) < STILL * rms([_both(values)]):
            break
    better = refit([replace(one.seen, bounced=off) for one, off in zip(shown, less, strict=True)])
    # Errors are shares of photographs as they are.
    whole = [seen.radiance for seen in photos]
    left = rms([of - off for of, off in zip(whole, less, strict=True)]) / rms(whole)
    candidates = tuple(
        replace(candidate, photo_errors=left * candidate.photo_errors) for candidate in better.candidates
    )
    better = replace(better, candidates=candidates)
    found = _judged(shown, (nothing, by_mesh), (without, values), less, (fit, better))
    if not found.taken_off:
        # The albedo of the fit that stands predicts what would bounce, not what followed from taking it off.
        by_mesh, less = once
        values = _values(shown, by_mesh, fit, len(points))
        found = _judged(shown, (nothing, by_mesh), (without, values), less, (fit, better))
        found = replace(found, taken_off=False)
    doubt = _doubt(found)
    pairs = ((values.kd, without.kd), (values.ks, without.ks))
    moved = [np.abs(own - other)[known] / np.maximum(own[known], 1e-300) for own, other in pairs]
    return CorrectedTextures(
        better if found.taken_off else fit,
        found,
        bounced if found.taken_off else {},
        points.where(known),
        np.minimum(doubt * np.concatenate(moved, axis=1), 1),
    )


def _shown(
    seen: Seen, elements: Mapping[str, Sequence[LightElement]], fit: TexturedFit, parts: ConcaveMesh
) -> _Shown:
    transfers = transfers_of(elements[seen.lighting], seen.pixels, fit.brdf, parts.shadows)
    diffuse, specular = (seen.points.at_points(one.astype(float)) for one in transfers)
    weight = 1 / (fit.noise.variance(seen.brightness) * seen.share[:, None])
    return _Shown(seen, diffuse, specular, weight)


def _by_mesh(seen: Seen, bounced: Bounced, brdf: Microfacet) -> tuple[Floats, Floats]:
    rays = bounced.reflected(seen.pixels, brdf)
    diffuse, specular = (seen.points.at_points(seen.pixels.mean_over_rays(one)) for one in rays)
    return diffuse, specular


def _values(
    shown: Sequence[_Shown], by_mesh: Sequence[tuple[Floats, Floats]], fit: TexturedFit, points: int
) -> PointValues:
    total = TexelEquations.zeros(points)
    for one, of in zip(shown, by_mesh, strict=True):
        total = total + one.sums(points, of)
    return solved(fit.model, total)


def _less(
    shown: Sequence[_Shown],
    by_mesh: Sequence[tuple[Floats, Floats]],
    values: PointValues,
    known: NDArray[np.bool_],
) -> list[Floats]:
    """Radiance (r, 3) of the points by what bounces.

    A point that photographs don't determine may have any albedo: it is taken no brighter than nearly all others.
    """
    kd, ks = (
        np.where(known[:, None], of, np.minimum(of, np.quantile(of[known], _BRIGHT, axis=0)))
        for of in (values.kd, values.ks)
    )
    return [
        kd[one.seen.points.points] * diffuse + ks[one.seen.points.points] * specular
        for one, (diffuse, specular) in zip(shown, by_mesh, strict=True)
    ]


def _both(values: PointValues) -> Floats:
    return np.concatenate([values.kd, values.ks])


def _nearest(body: MeshBody, points: SurfacePoints, known: NDArray[np.bool_]) -> Ints:
    """The known point (f,) next to the middle of each face, on its side of a wall."""
    mesh = body.mesh
    apart = _SIDES * float(np.ptp(mesh.vertices, axis=0).max()) / 2
    middles = mesh.vertices[mesh.faces].mean(axis=1)
    tree = cKDTree(np.column_stack([points.positions, apart * points.facets])[known])
    return np.flatnonzero(known)[tree.query(np.column_stack([middles, apart * body.facets]))[1]]


def _judged(
    shown: Sequence[_Shown],
    by_mesh: tuple[Sequence[tuple[Floats, Floats]], Sequence[tuple[Floats, Floats]]],
    values: tuple[PointValues, PointValues],
    less: Sequence[Floats],
    fits: tuple[TexturedFit, TexturedFit],
) -> Interreflection:
    """What photographs say of bounced light (r, 3); pairs are without it taken off, and with."""
    residuals = [
        [one.residual(own, of) for one, of in zip(shown, each, strict=True)]
        for own, each in zip(values, by_mesh, strict=True)
    ]
    # What has a Kd and Ks only with bounced light, or only without it, is evidence for neither.
    known = determined(values[0]) & determined(values[1])
    weights = [one.weight * known[one.seen.points.points, None] for one in shown]
    asked, asked_std = _together(
        asked_for([one.seen.tiles for one in shown], weights, *residuals),
        _asked_in_shadow(shown, by_mesh[1], values[0], known),
    )
    whole = [one.seen.radiance for one in shown]
    errors = [fit.candidates[fit.chosen].error for fit in fits]
    before, after = (
        replace(fits[1].brdf, kd=of.kd[known].mean(axis=0), ks=of.ks[known].mean(axis=0)) for of in values
    )
    before = replace(before, mu=fits[0].brdf.mu, sigma=fits[0].brdf.sigma, form=fits[0].brdf.form)
    return Interreflection(
        relative=rms(less) / rms(whole),
        highest=highest_share(less, whole),
        taken_off=bool((asked - 1) ** 2 - asked**2 < 2 * np.log(_ODDS) * asked_std**2),
        asked=asked,
        asked_std=asked_std,
        error_with=errors[1],
        error_without=errors[0],
        without=before,
        corrected=after,
    )


def _doubt(found: Interreflection) -> float:
    """How far from 1 the share that there is of the prediction may be; of what is left in, from 0."""
    if not found.taken_off:
        return found.doubt
    variance = 1 / (1 / _BEFOREHAND**2 + 1 / max(found.asked_std, 1e-6) ** 2)
    return float(np.hypot(variance / max(found.asked_std, 1e-6) ** 2 * (found.asked - 1), np.sqrt(variance)))


def _asked_in_shadow(
    shown: Sequence[_Shown],
    by_mesh: Sequence[tuple[Floats, Floats]],
    without: PointValues,
    known: NDArray[np.bool_],
) -> tuple[float, float]:
    """How many times the bounced light makes the albedo in shadow as bright as elsewhere, and its standard deviation.

    Infinite where the photographs show too little of it: pieces are tiles of photographs.
    """
    kd, ks = (np.median(of[known], axis=0) for of in (without.kd, without.ks))
    found = []
    for one, (diffuse, specular) in zip(shown, by_mesh, strict=True):
        dark = np.flatnonzero(one.diffuse.max(axis=1) < _SHADOW * (one.diffuse + diffuse).max(axis=1))
        lacking = one.seen.radiance - kd * one.diffuse - ks * (one.specular + specular)
        times = lacking[dark].sum(axis=1) / np.maximum((kd * diffuse)[dark].sum(axis=1), 1e-300)
        tiles = one.seen.tiles[dark]
        found += [float(np.median(times[tiles == tile])) for tile in np.unique(tiles)]
    if len(found) < _PIECES:
        return 1.0, np.inf
    spread = float(np.std(found, ddof=1)) / np.sqrt(len(found))
    return max(float(np.mean(found)), 0.0), float(np.hypot(spread, _ALBEDO_NEAR))


def _together(*answers: tuple[float, float]) -> tuple[float, float]:
    """The mean of independent answers with their standard deviations, by these."""
    weights = np.array([1 / max(std, 1e-6) ** 2 for _, std in answers])
    return float(weights @ [value for value, _ in answers] / weights.sum()), float(weights.sum() ** -0.5)
