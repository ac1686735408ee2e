"""Which pixels of a photograph are sampled, and what is known of each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture.camera import Camera
from capture.lighting import seen_from
from capture.radiance import RadianceImage
from recon.mesh.bodies import Body, PixelGeometry, SurfaceHits, sees
from recon.sampling.budget import draw, spread_with_highlights
from recon.sampling.candidates import WHOLE, any_within, candidates
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Exitant angles beyond 81 degrees are left out: the microfacet model grows without bound there
# (RH01 section 5.2: grazing observations "are usually assigned low confidence anyway").
MIN_COS_EXITANT = 0.15
# From this cosine on (73 degrees) a pixel has its full weight; in between it rises evenly.
_FULL_COS = 0.3
# Weight of a pixel that isn't clear of edges, of the mask's border and of saturated pixels.
_UNCLEAR = 0.5
# Pixels around a sample in which the mask must be whole for it to be clear.
_CLEARANCE = 3
# A pixel across which the normal turns by more than a quarter of a radian says nothing of one angle.
_MAX_TURN = 0.25
# (turn, rays per side): a pixel across which the normal turns by less than the first is one ray through its
# centre; others are grids of 2-point Gauss rules. One rule in all would make 1 / cos theta_o, as the model
# has it, 2.6% too small at cos theta_o = 0.15 on a sphere of 53 px.
_RAYS_PER_SIDE = ((0.02, 1), (0.08, 2), (np.inf, 4))
# In highlights of sources, which may be as narrow as 0.005 radians.
_RAYS_OF_HIGHLIGHTS = ((0.0005, 1), (0.008, 2), (0.016, 4), (np.inf, 8))
# How far from the mirror direction a source's highlight and its flanks reach, radians; rays along a pixel's side there
# at most, and where small highlights are seen. One ray at the flanks would make sigma 0.015 too large by 0.2% on a
# sphere of 450 px.
_GLINT, _FLANKS = 0.02, 0.06
_FINEST, _FINE, _FLANK = 8, 4, 2
# A pixel across which the normal turns by less, in parts of sigma, makes a lobe too wide by less than 0.1% as one ray.
_SMOOTH = 0.1
# Where highlights may be anywhere, a pixel across which the normal turns by more is two rays a side, not to make a lobe
# too wide: at 0.01 radians one of sigma 0.15 by 0.05%.
_BLUNT = 0.005
# Cosine to a facet below which it is seen edge on: a pixel's footprint on its plane says nothing of the surface.
_EDGE_ON = 0.05
# For who asks for no source's visibility.
NO_SOURCES = np.zeros((0, 3))


@dataclass(frozen=True)
class Importance:
    """How informative pixels are, (n,), by their normals and views, (n, 3) unit; and sigma as it seems, radians."""

    of: Callable[[Floats, Floats], Floats]
    sigma: float | None = None


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
    looked_at = candidates(body, camera, image, coverage, budget, highlights or importance is not None, rng)
    rows, columns = looked_at.rows, looked_at.columns
    geometry = body.pixel_geometry(camera, rows, columns)
    usable = _usable(geometry)
    normals, stands_for = geometry.normals[usable], looked_at.stands_for[usable]
    shares = stands_for / stands_for.mean() if len(usable) else stands_for
    if budget is not None and len(usable) > budget:
        if importance is not None:
            telling = importance.of(normals, _views(camera, rows[usable], columns[usable]))
            drawn, shares = draw(normals, telling, budget, rng, stands_for)
        else:
            drawn, shares = spread_with_highlights(normals, looked_at.where(usable), budget, rng)
        usable = usable[drawn]
    rows, columns = rows[usable], columns[usable]
    weight = _weight(geometry, usable, image, coverage, rows, columns)
    sigma = None if importance is None else importance.sigma
    finest = _finest(geometry, _views(camera, rows, columns), sources, usable, sigma)
    if highlights:
        blunt = np.where(geometry.turn[usable] > _BLUNT, _FLANK, 0)
        finest = np.maximum(finest, np.where(looked_at.bright[usable], _FINE, blunt))
    field, complete = _gather(
        body, camera, image, rows, columns, geometry.turn[usable], weight, sources, finest
    )
    return field if (shares == 1).all() else replace(field, stands_for=shares[complete])


def usable_among(
    body: Body,
    camera: Camera,
    image: RadianceImage,
    coverage: NDArray[np.float32] | None,
    rows: Ints,
    columns: Ints,
    sources: Floats,
) -> LightField:
    """The samples of those among given `candidates` (n,) that are usable, in their order; as of `sample_body`."""
    geometry = body.pixel_geometry(camera, rows, columns)
    usable = _usable(geometry)
    rows, columns = rows[usable], columns[usable]
    weight = _weight(geometry, usable, image, coverage, rows, columns)
    finest = _finest(geometry, _views(camera, rows, columns), sources, usable)
    return _gather(body, camera, image, rows, columns, geometry.turn[usable], weight, sources, finest)[0]


def _usable(geometry: PixelGeometry) -> Ints:
    """The numbers of pixels that show one smooth piece of surface, not too grazing."""
    return np.flatnonzero(geometry.whole & (geometry.cos >= MIN_COS_EXITANT) & (geometry.turn <= _MAX_TURN))


def _weight(
    geometry: PixelGeometry,
    usable: Ints,
    image: RadianceImage,
    coverage: NDArray[np.float32] | None,
    rows: Ints,
    columns: Ints,
) -> Floats:
    """How far the usable pixels of a geometry, (n,) rows and columns, are trusted: 0 to 1."""
    clear = geometry.clear[usable] & ~any_within(image.saturated, rows, columns, _CLEARANCE)
    if coverage is not None:
        clear &= ~any_within(coverage < WHOLE, rows, columns, _CLEARANCE)
    grazing = (geometry.cos[usable] - MIN_COS_EXITANT) / (_FULL_COS - MIN_COS_EXITANT)
    return np.asarray(np.clip(grazing, 0, 1) * np.where(clear, 1, _UNCLEAR))


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
    finest = _finest(geometry, _views(camera, rows, columns), glints)
    return _gather(body, camera, image, rows, columns, geometry.turn, np.ones(len(rows)), sources, finest)[0]


def _views(camera: Camera, rows: Ints, columns: Ints) -> Floats:
    """Unit vectors (n, 3) from pixels' centres to the camera."""
    return np.asarray(-camera.rays(np.column_stack([columns, rows]) + 0.5)[1])


def _finest(
    geometry: PixelGeometry,
    views: Floats,
    sources: Floats,
    which: Ints | slice = slice(None),
    sigma: float | None = None,
) -> Ints:
    """Rays along the side of each pixel (n,) at most, where sources' highlights may be; 0 elsewhere.

    which : of the geometry's pixels. sigma : as it seems, radians; flanks of wide lobes are smooth over a pixel.
    """
    normals, turn = geometry.normals[which], geometry.turn[which]
    offset = np.full(len(normals), np.inf)
    directions, _ = seen_from(sources, geometry.positions[which])
    for k in range(len(sources)):
        half = views + directions[..., k, :]
        half /= np.maximum(np.linalg.norm(half, axis=1, keepdims=True), 1e-12)
        offset = np.minimum(offset, np.linalg.norm(np.cross(half, normals), axis=1))
    offset -= 2 * turn
    flanks = (offset < _FLANKS) & (turn > (0 if sigma is None else _SMOOTH * sigma))
    return np.where(offset < _GLINT, _FINEST, np.where(flanks, _FLANK, 0))


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
