"""Which pixels of a photograph are sampled, and what is known of each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture.camera import Camera
from capture.lighting import seen_from
from capture.radiance import RadianceImage
from recon.mesh.bodies import Body, PixelGeometry, SurfaceHits, body_window, sees
from recon.sampling.highlights import small_highlights
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
# How informative pixels are, (n,), by their normals and views, (n, 3) unit.
Importance = Callable[[Floats, Floats], Floats]

# Exitant angles beyond 81 degrees are left out: the microfacet model grows without bound there
# (RH01 section 5.2: grazing observations "are usually assigned low confidence anyway").
MIN_COS_EXITANT = 0.15
# From this cosine on (73 degrees) a pixel has its full weight; in between it rises evenly.
_FULL_COS = 0.3
# Weight of a pixel that isn't clear of edges, of the mask's border and of saturated pixels.
_UNCLEAR = 0.5
# Pixels around a sample in which the mask must be whole, for it to be taken; and for it to be clear.
_BORDER, _CLEARANCE = 1, 3
# A pixel across which the normal turns by more than a quarter of a radian says nothing of one angle.
_MAX_TURN = 0.25
# Coverage from which on a pixel counts as wholly the object's: renderers' alpha and JPEG masks are hardly ever quite
# white. Next to the border, where less would matter, neighbours must be as white.
WHOLE = 0.98
# (turn, rays per side): a pixel across which the normal turns by less than the first is one ray through its
# centre; others are grids of 2-point Gauss rules. One rule in all would make 1 / cos theta_o, as the model
# has it, 2.6% too small at cos theta_o = 0.15 on a sphere of 53 px.
_RAYS_PER_SIDE = ((0.02, 1), (0.08, 2), (np.inf, 4))
# In highlights of sources, which may be as narrow as 0.005 radians; and how far from the mirror direction these reach.
_RAYS_OF_HIGHLIGHTS = ((0.004, 1), (0.008, 2), (0.016, 4), (np.inf, 8))
_GLINT = 0.02
# Rays along a pixel's side at most: where a source's highlight is, and where one may be.
_FINEST, _FINE = 8, 4
# Part of the budget that is drawn by the information in pixels, and rounds in which probabilities that reach 1 are set
# aside.
_TELLING, _ROUNDS = 0.4, 8
# Of a budget, what of small highlights is taken beside it at most.
_HIGHLIGHTS = 0.2
# How many times the budget is looked at in choosing it.
_SPARE = 8
# Bands of latitude by which normals are grouped; twice as many sectors in each, all of one solid angle.
_BANDS = 16
# Cosine to a facet below which it is seen edge on: a pixel's footprint on its plane says nothing of the surface.
_EDGE_ON = 0.05
# For who asks for no source's visibility.
NO_SOURCES = np.zeros((0, 3))


def sample_body(
    body: Body,
    camera: Camera,
    image: RadianceImage,
    coverage: NDArray[np.float32] | None,
    sources: Floats,
    budget: int | None,
    rng: np.random.Generator,
    importance: Importance | None = None,
    highlights: bool = False,
) -> LightField:
    """Samples of a body in one photograph, at most `budget` of them, spread over its normals.

    coverage : (h, w) mask in 0 to 1, or None to trust the shape alone. sources : (k, 3), or (k, 4) where some are near.
    importance : how informative pixels are, by which a part of the budget is drawn; None spreads all of it evenly.
    highlights : whether, where no importance is known, all of small highlights is taken beside the budget, up to a
    fifth of it, and seen through finer rays.
    Pixels are usable when they show one smooth piece of surface, a pixel away from the mask's border, are not
    saturated and not too grazing.
    """
    rows, columns = _candidates(body, camera, image, coverage, budget, rng)
    geometry = body.pixel_geometry(camera, rows, columns)
    usable = np.flatnonzero(geometry.whole & (geometry.cos >= MIN_COS_EXITANT) & (geometry.turn <= _MAX_TURN))
    shares, bright = None, np.zeros(len(usable), bool)
    if highlights:
        at = rows[usable], columns[usable]
        bright = small_highlights(*at, image.radiance[at].astype(np.float64))
        shares = np.ones(len(usable))
    if budget is None or len(usable) <= budget:
        pass
    elif importance is None:
        drawn = spread(geometry.normals[usable], budget, rng)
        if highlights:
            drawn, shares = _with_highlights(drawn, bright, _cells(geometry.normals[usable]), rng)
        usable, bright = usable[drawn], bright[drawn]
    else:
        telling = importance(geometry.normals[usable], _views(camera, rows[usable], columns[usable]))
        drawn, shares = draw(geometry.normals[usable], telling, budget, rng)
        usable, bright = usable[drawn], bright[drawn]
    rows, columns = rows[usable], columns[usable]
    clear = geometry.clear[usable] & ~_any_within(image.saturated, rows, columns, _CLEARANCE)
    if coverage is not None:
        clear &= ~_any_within(coverage < WHOLE, rows, columns, _CLEARANCE)
    grazing = (geometry.cos[usable] - MIN_COS_EXITANT) / (_FULL_COS - MIN_COS_EXITANT)
    weight = np.clip(grazing, 0, 1) * np.where(clear, 1, _UNCLEAR)
    near = _near_mirror(geometry, _views(camera, rows, columns), sources, usable)
    finest = np.where(near, _FINEST, np.where(bright, _FINE, 0))
    field, complete = _gather(
        body, camera, image, rows, columns, geometry.turn[usable], weight, sources, finest
    )
    return field if shares is None else replace(field, stands_for=shares[complete])


def samples_at(
    body: Body,
    camera: Camera,
    image: RadianceImage,
    rows: Ints,
    columns: Ints,
    sources: Floats,
    glints: Floats = NO_SOURCES,
) -> LightField:
    """The samples of given pixels that lie wholly on the body, usable for a fit or not; their weight is 1.

    glints : (k, 3) or (k, 4), sources whose highlights are seen through finer rays.
    """
    geometry = body.pixel_geometry(camera, rows, columns)
    near = _near_mirror(geometry, _views(camera, rows, columns), glints)
    finest = np.where(near, _FINEST, 0)
    return _gather(body, camera, image, rows, columns, geometry.turn, np.ones(len(rows)), sources, finest)[0]


def _views(camera: Camera, rows: Ints, columns: Ints) -> Floats:
    """Unit vectors (n, 3) from pixels' centres to the camera."""
    return np.asarray(-camera.rays(np.column_stack([columns, rows]) + 0.5)[1])


def _near_mirror(
    geometry: PixelGeometry, views: Floats, sources: Floats, which: Ints | slice = slice(None)
) -> NDArray[np.bool_]:
    """Pixels (n,) in which a highlight of some source may be narrower than they are wide; which : of the geometry's."""
    normals, turn = geometry.normals[which], geometry.turn[which]
    near = np.zeros(len(normals), bool)
    directions, _ = seen_from(sources, geometry.positions[which])
    for k in range(len(sources)):
        half = views + directions[..., k, :]
        half /= np.maximum(np.linalg.norm(half, axis=1, keepdims=True), 1e-12)
        near |= np.linalg.norm(np.cross(half, normals), axis=1) < _GLINT + 2 * turn
    return near


def samples_around(
    body: Body, camera: Camera, image: RadianceImage, places: Floats, across: bool = True
) -> tuple[LightField, NDArray[np.bool_]]:
    """What pixels around places (n, 2), pixels, would show, and which of them (n,) lie wholly on the body.

    Radiance is that of the pixel which a place is in; no source's visibility is asked for. across : False takes the
    places themselves, a ray each, for their pixels.
    """
    columns, rows = places.T - 0.5
    turn = body.pixel_geometry(camera, rows, columns).turn if across else np.zeros(len(places))
    return _gather(body, camera, image, rows, columns, turn, np.ones(len(places)), NO_SOURCES)


def ray_squares(field: LightField) -> tuple[Floats, Floats]:
    """What of its pixel each ray of a field stands for: squares' upper left corners (m, 2) and widths (m,), pixels."""
    counts = np.bincount(field.ray_sample, minlength=len(field))
    side = np.sqrt(counts)[field.ray_sample].round().astype(np.int64)
    which = np.arange(len(side)) - (np.cumsum(counts) - counts)[field.ray_sample]
    within = np.column_stack([which % side, which // side]) / side[:, None]
    return np.column_stack([field.columns, field.rows])[field.ray_sample] + within, 1 / side


def draw(
    normals: Floats, telling: Floats, budget: int, rng: np.random.Generator
) -> tuple[NDArray[np.int64], Floats]:
    """About `budget` of n samples, ascending, and what each stands for: evenly over normals, more where pixels are
    informative.

    normals : (n, 3). telling : (n,) >= 0, in any unit. A part of the budget is spread evenly over normals, the rest
    drawn with probabilities in proportion to the information in pixels (RMB07, section 6: sampling by gradients). A
    sample stands for its probability in an even draw over that in this one [Horvitz and Thompson 1952], so that sums
    stay unbiased.
    """
    even = _inclusion(_cells(normals), budget)
    return by_information(even, telling, budget, rng)


def by_information(
    even: Floats, telling: Floats, budget: float, rng: np.random.Generator
) -> tuple[NDArray[np.int64], Floats]:
    """As `draw`, of samples whose even draw is given; all of them where the budget holds all.

    even : (n,), the probability with which an even draw of the budget takes each sample. telling : (n,) >= 0.
    """
    if budget >= len(even):
        return np.arange(len(even)), np.ones(len(even))
    drawn = 1 - (1 - (1 - _TELLING) * even) * (1 - _proportional(telling, _TELLING * budget))
    # Systematically along a random order: as many as the probabilities add up to, none twice.
    order = rng.permutation(len(even))
    total = np.cumsum(drawn[order]) + rng.random()
    taken = np.sort(order[np.floor(total) > np.floor(total - drawn[order])])
    shares = even[taken] / drawn[taken]
    return taken, shares / shares.mean()


def _with_highlights(
    drawn: Ints, bright: NDArray[np.bool_], cells: Ints, rng: np.random.Generator
) -> tuple[Ints, Floats]:
    """Samples (k,) of n that were drawn, with more of the bright ones (n,), and what each of them stands for, (k,).

    A bright one stands for the chance by which it would be drawn, over that by which it is [Horvitz and Thompson 1952].
    """
    _, place, counts = np.unique(cells, return_inverse=True, return_counts=True)
    chance = (np.bincount(place[drawn], minlength=len(counts)) / counts)[place]
    kept = np.zeros(len(cells), bool)
    kept[drawn] = True
    left = np.flatnonzero(bright & ~kept)
    more = rng.permutation(left)[: int(_HIGHLIGHTS * len(drawn))]
    taken = len(more) / max(len(left), 1)
    kept[more] = True
    # By chance nothing of a highlight's cell may be drawn, nor more of it.
    either = np.maximum(chance + (1 - chance) * taken, 1e-12)
    shares = np.where(bright, chance / either, 1.0)[kept]
    return np.flatnonzero(kept), shares / shares.mean()


def _inclusion(cell: Ints, budget: float) -> Floats:
    """Probabilities (n,) with which an even draw over cells takes samples, given each one's cell."""
    _, place, counts = np.unique(cell, return_inverse=True, return_counts=True)
    if len(cell) <= budget:
        return np.ones(len(cell))
    # The quota that fills the budget: cells with fewer give all that they have.
    ascending = np.sort(counts)
    before = np.cumsum(ascending) - ascending
    quotas = (budget - before) / (len(ascending) - np.arange(len(ascending)))
    quota = quotas[np.argmax(quotas <= ascending)]
    return np.asarray(np.minimum(1, quota / counts)[place])


def _proportional(telling: Floats, budget: float) -> Floats:
    """Probabilities (n,) in proportion to numbers, as far as 1 allows, that add up to a budget where they can."""
    result = np.zeros(len(telling))
    rest = telling > 0
    for _ in range(_ROUNDS):
        if not rest.any() or result.sum() >= budget:
            break
        result[rest] = np.minimum(1, telling[rest] * ((budget - result[~rest].sum()) / telling[rest].sum()))
        rest &= result < 1
    return result


def spread(normals: Floats, budget: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """Which `budget` of n samples to take, ascending, so that all normals (n, 3) count as evenly as can be.

    The sphere of normals is cut into cells of one solid angle; the same number is drawn from each, all from those that
    have fewer. A flat face of a mesh would otherwise take the budget of all that curves.
    """
    cell = _cells(normals)
    # In an order that is random within each cell, a sample's rank says whether its cell's quota takes it.
    order = rng.permutation(len(cell))
    order = order[np.argsort(cell[order], kind="stable")]
    sorted_cell = cell[order]
    first = np.flatnonzero(np.diff(sorted_cell, prepend=-1))
    rank = np.arange(len(order)) - np.repeat(first, np.diff(first, append=len(order)))
    # Ranks in turn: the first of each cell, the second of each ...; within one rank cells in random order.
    turn = np.lexsort((rng.random(len(order)), rank))
    return np.sort(order[turn[:budget]])


def _cells(normals: Floats) -> Ints:
    """The cell (n,) of the sphere of normals that each lies in; all have one solid angle."""
    band = np.minimum(((normals[:, 2] + 1) / 2 * _BANDS).astype(int), _BANDS - 1)
    azimuth = np.arctan2(normals[:, 1], normals[:, 0]) / (2 * np.pi) + 0.5
    sectors = 2 * _BANDS
    return np.asarray(band * sectors + np.minimum((azimuth * sectors).astype(int), sectors - 1))


def _candidates(
    body: Body,
    camera: Camera,
    image: RadianceImage,
    coverage: NDArray[np.float32] | None,
    budget: int | None,
    rng: np.random.Generator,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pixels of the photograph that the body may be sampled at, a few times the budget of them."""
    top, left, bottom, right = body_window(body, camera)
    good = ~image.saturated[top:bottom, left:right]
    if coverage is not None:
        good &= coverage[top:bottom, left:right] >= WHOLE
    chosen = np.flatnonzero(good)
    if budget is not None and len(chosen) > _SPARE * budget:
        chosen = np.sort(rng.choice(chosen, _SPARE * budget, replace=False))
    rows, columns = np.divmod(chosen, max(right - left, 1))
    rows, columns = rows + top, columns + left
    if coverage is not None:
        inside = ~_any_within(coverage < WHOLE, rows, columns, _BORDER)
        rows, columns = rows[inside], columns[inside]
    return rows, columns


def _any_within(marked: NDArray[np.bool_], rows: Ints, columns: Ints, reach: int) -> NDArray[np.bool_]:
    """Whether any pixel within `reach` of given ones, to the sides and corners, is marked; outside none is."""
    height, width = marked.shape
    found = np.zeros(len(rows), bool)
    if not marked.any():
        return found
    for down in range(-reach, reach + 1):
        for along in range(-reach, reach + 1):
            found |= marked[np.clip(rows + down, 0, height - 1), np.clip(columns + along, 0, width - 1)]
    return found


def _gather(
    body: Body,
    camera: Camera,
    image: RadianceImage,
    rows: NDArray[Any],
    columns: NDArray[Any],
    turn: Floats,
    weight: Floats,
    sources: Floats,
    finest: Ints | None = None,
) -> tuple[LightField, NDArray[np.bool_]]:
    """Samples of pixels whose centres are half a pixel right of and below (columns, rows), and which are complete.

    finest : (n,) how many rays along a side those take at most that take the finer ones of highlights; 0 of others.
    """
    per_side = _per_side(_RAYS_PER_SIDE, turn)
    if finest is not None:
        per_side = np.maximum(per_side, np.minimum(_per_side(_RAYS_OF_HIGHLIGHTS, turn), finest))
    ray_sample = np.repeat(np.arange(len(rows)), per_side**2)
    first = np.flatnonzero(np.diff(ray_sample, prepend=-1))
    which = np.arange(len(ray_sample)) - first[ray_sample]
    offsets = np.zeros((len(ray_sample), 2))
    for side in np.unique(per_side).tolist():
        mine = per_side[ray_sample] == side
        nodes = _gauss_nodes(side)
        offsets[mine] = np.column_stack([nodes[which[mine] % side], nodes[which[mine] // side]])
    points = np.column_stack([columns, rows])[ray_sample] + 0.5 + offsets
    rows, columns = (np.rint(of).astype(np.int64) for of in (rows, columns))
    hits = body.hits(camera, points)
    views = hits.views
    reflected = 2 * (hits.normals * views).sum(axis=1)[:, None] * hits.normals - views
    seen = [sees(body, hits.positions, hits.facets, source) for source in sources]
    field = LightField(
        rows=rows,
        columns=columns,
        radiance=image.radiance[rows, columns].astype(np.float64),
        variance=image.variance_at(rows, columns).astype(np.float64),
        weight=weight,
        ray_sample=ray_sample,
        positions=hits.positions,
        normals=hits.normals,
        views=views,
        reflected_visible=body.visible(hits.positions, hits.facets, reflected),
        sources_visible=np.column_stack(seen) if seen else np.zeros((len(views), 0), bool),
        faces=hits.faces,
        corner_weights=hits.weights,
        footprints=_footprints(camera, points, hits, 1 / per_side[ray_sample]),
    )
    # A hole, or a sliver before the surface, may be smaller than the pixel.
    complete = np.ones(len(rows), bool)
    complete[ray_sample[~hits.hit]] = False
    return (field if complete.all() else field.where(complete)), complete


def _per_side(table: Sequence[tuple[float, int]], turn: Floats) -> Ints:
    """Rays (n,) along a pixel's side, by how far the normal turns across it."""
    return np.array([side for _, side in table])[np.searchsorted([limit for limit, _ in table], turn)]


def _footprints(camera: Camera, points: Floats, hits: SurfaceHits, widths: Floats) -> Floats | None:
    """How far facets' planes extend, (m, 2, 3) metres, across squares (m,) pixels wide; None on a sphere."""
    if hits.faces is None:
        return None
    result = np.zeros((len(points), 2, 3))
    for axis, way in enumerate(np.eye(2)):
        origins, directions = camera.rays(points + widths[:, None] * way)
        fall = (hits.facets * directions).sum(axis=1)
        reached = hits.hit & (fall < -_EDGE_ON)
        height = ((hits.positions - origins) * hits.facets).sum(axis=1)
        along = np.where(reached, height / np.where(reached, fall, 1), 0)[:, None]
        result[:, axis] = np.where(reached[:, None], origins + along * directions - hits.positions, 0)
    return result


def _gauss_nodes(count: int) -> Floats:
    """Nodes (count,) of equal weight across a pixel, -0.5 to 0.5: its centre, or 2-point Gauss rules abreast."""
    if count == 1:
        return np.zeros(1)
    rules = count // 2
    centres = (np.arange(rules) + 0.5) / rules - 0.5
    return (centres[:, None] + np.array([-0.5, 0.5]) / np.sqrt(3) / rules).ravel()
