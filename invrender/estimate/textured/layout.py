"""Where a texture has its values: texels of a map over texture coordinates, or the mesh's vertices."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from recon.mesh.atlas import atlas_within
from recon.mesh.bodies import MeshBody, blended
from recon.mesh.trianglemesh import TriangleMesh, area_vectors

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Pixels along a map's side at most; four times as many are solved for.
LARGEST = 1024
_SMALLEST = 16
# Seconds that texture coordinates may take to find.
_PATIENCE_S = 180.0
# Share of the covered texels that may lie in two triangles (where charts touch), and of the surface that may have no
# texture coordinates of any area.
_OVERLAP, _BARE = 0.01, 0.01
# Within this of a triangle's edge a texel's centre counts as on it, not inside.
_EDGE = 1e-3
# Texels side by side in the map are neighbours on the surface within so many times the median distance.
_APART = 5.0
# Texels of triangles' boxes that are looked at together.
_AT_A_TIME = 2_000_000


@dataclass(frozen=True, eq=False)
class SurfacePoints:
    """Points of a mesh in the world. positions (n, 3) metres; normals, facets (n, 3) unit, as of `SurfaceHits`."""

    positions: Floats
    normals: Floats
    facets: Floats

    def __len__(self) -> int:
        return len(self.positions)

    def where(self, chosen: NDArray[np.integer] | NDArray[np.bool_]) -> SurfacePoints:
        """Some of them, by a mask or by their numbers."""
        return SurfacePoints(self.positions[chosen], self.normals[chosen], self.facets[chosen])


def scattered(body: MeshBody, count: int, rng: np.random.Generator) -> SurfacePoints:
    """So many points of a mesh, evenly over its surface by chance."""
    mesh, areas = body.mesh, _areas(body.mesh)
    faces = rng.choice(len(areas), count, p=areas / areas.sum())
    weights, at = rng.dirichlet(np.ones(3), count), mesh.faces[faces]
    return SurfacePoints(blended(mesh.vertices, at, weights), _smooth(mesh, at, weights), body.facets[faces])


def _smooth(mesh: TriangleMesh, corners: Ints, weights: Floats) -> Floats:
    normals = blended(mesh.normals, corners, weights)
    return np.asarray(normals / np.linalg.norm(normals, axis=1, keepdims=True))


class Layout(Protocol):
    """Points of a surface, and how values at them lie between and in files."""

    def __len__(self) -> int:
        """How many points there are, n."""

    @property
    def points(self) -> SurfacePoints:
        """The points, computed anew whenever they are asked for."""

    @property
    def areas(self) -> Floats:
        """Of the surface, how much each point stands for, (n,), in any unit."""

    def places(self, faces: Ints, corner_weights: Floats) -> tuple[Ints, Floats]:
        """Points (m, k) around places in faces, (m,) and (m, 3), -1 where there is none, and their weights (m, k)."""

    def pairs(self) -> Ints:
        """Points that lie side by side on the surface, (m, 2), each pair once."""

    def finer(self) -> tuple[Layout, Ints]:
        """A layout of points half as far apart, and the point (m,) of this one that each belongs to, -1 for none."""

    def image(self, values: NDArray[np.floating]) -> NDArray[np.float32]:
        """Values (n, ...) at the points as a picture (h, w, ...); zero where there is no point."""

    @property
    def made(self) -> TriangleMesh | None:
        """The mesh in the world, with the texture coordinates that were made for it; None if none were."""


@dataclass(frozen=True, eq=False)
class VertexLayout:
    """A value at each vertex: for meshes without usable texture coordinates. As a picture one row, in their order."""

    body: MeshBody
    made: TriangleMesh | None = None

    def __len__(self) -> int:
        return len(self.body.mesh.vertices)

    @property
    def points(self) -> SurfacePoints:
        mesh = self.body.mesh
        return SurfacePoints(mesh.vertices, mesh.normals, mesh.normals)

    @property
    def areas(self) -> Floats:
        faces = self.body.mesh.faces
        return np.asarray(np.bincount(faces.ravel(), np.repeat(_areas(self.body.mesh), 3), len(self)), float)

    def places(self, faces: Ints, corner_weights: Floats) -> tuple[Ints, Floats]:
        return self.body.mesh.faces[faces], corner_weights

    def pairs(self) -> Ints:
        faces = self.body.mesh.faces
        sides = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
        return np.unique(sides, axis=0)

    def finer(self) -> tuple[Layout, Ints]:
        return self, np.arange(len(self))

    def image(self, values: NDArray[np.floating]) -> NDArray[np.float32]:
        return values[None].astype(np.float32)


@dataclass(frozen=True, eq=False)
class TexelLayout:
    """A value at each texel whose centre lies on the surface.

    body : the mesh. corners : (f, 3, 2), u and v of its faces' corners. side : pixels along the square map; its first
    row is at v = 1, its first column at u = 0. rows, columns : (n,) of the texels on the surface; faces, weights : (n,)
    and (n, 3), where on it. made : the mesh with the texture coordinates that were made for it; None if it had its own.
    """

    body: MeshBody
    corners: Floats
    side: int
    rows: Ints
    columns: Ints
    faces: Ints
    weights: Floats
    made: TriangleMesh | None = None

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def points(self) -> SurfacePoints:
        mesh = self.body.mesh
        at = mesh.faces[self.faces]
        normals = _smooth(mesh, at, self.weights)
        return SurfacePoints(blended(mesh.vertices, at, self.weights), normals, self.body.facets[self.faces])

    @property
    def areas(self) -> Floats:
        charts = np.abs(_doubled(self.corners))[self.faces]
        return np.asarray(_areas(self.body.mesh)[self.faces] / charts)

    def places(self, faces: Ints, corner_weights: Floats) -> tuple[Ints, Floats]:
        uv = np.einsum("mk,mkc->mc", corner_weights, self.corners[faces])
        # u goes around, v ends at the edges.
        x, y = uv[:, 0] * self.side - 0.5, np.clip((1 - uv[:, 1]) * self.side - 0.5, 0, self.side - 1)
        number = self._numbers
        left, top = np.floor(x).astype(int), np.floor(y).astype(int)
        across, down = x - left, y - top
        found, weights = [], []
        for row, row_weight in ((top, 1 - down), (np.minimum(top + 1, self.side - 1), down)):
            for column, column_weight in ((left, 1 - across), (left + 1, across)):
                found.append(number[row, column % self.side])
                weights.append(row_weight * column_weight)
        return np.stack(found, axis=1), np.stack(weights, axis=1)

    def pairs(self) -> Ints:
        number, mesh = self._numbers, self.body.mesh
        beside = [
            (number.ravel(), np.roll(number, -1, axis=1).ravel()),
            (number[:-1].ravel(), number[1:].ravel()),
        ]
        pairs = np.concatenate(
            [np.column_stack([one, other])[(one >= 0) & (other >= 0)] for one, other in beside]
        )
        # Charts may touch in the map that don't on the surface.
        square = np.zeros(len(pairs))
        for axis in mesh.vertices.T:
            at = np.einsum("nk,nk->n", axis[mesh.faces[self.faces]], self.weights)
            square += (at[pairs[:, 0]] - at[pairs[:, 1]]) ** 2
        return pairs[square < _APART**2 * np.median(square)]

    def finer(self) -> tuple[TexelLayout, Ints]:
        finer = _rastered(self.body, self.corners, 2 * self.side)
        assert isinstance(finer, TexelLayout)
        return finer, self._numbers[finer.rows // 2, finer.columns // 2].astype(np.int64)

    @cached_property
    def _numbers(self) -> NDArray[np.int32]:
        """The map (side, side) of the texels' numbers, -1 where there is no surface."""
        number = np.full((self.side, self.side), -1, np.int32)
        number[self.rows, self.columns] = np.arange(len(self))
        return number

    def image(self, values: NDArray[np.floating]) -> NDArray[np.float32]:
        picture = np.zeros((self.side, self.side, *values.shape[1:]), np.float32)
        picture[self.rows, self.columns] = values
        return picture


def find_layout(body: MeshBody, footprint: float) -> tuple[TexelLayout | VertexLayout, list[str]]:
    """Where a texture on a mesh has its values, and sentences on what stood in the way of better ones.

    footprint : metres, about which a texel is to be large. The mesh's own texture coordinates are used if it has them
    and no two of its triangles share texels; otherwise others are looked for; without success each vertex has a value.
    """
    warnings: list[str] = []
    mesh = body.mesh
    if mesh.uv is not None:
        corners = mesh.uv[mesh.faces]
        fault = _fault(mesh, corners)
        layout = None if fault else _texels(body, corners, footprint)
        if isinstance(layout, TexelLayout):
            return layout, warnings
        warnings.append(
            f"the mesh's own texture coordinates can't be used: {fault or layout}; others were made"
        )
    try:
        found = atlas_within(mesh, _PATIENCE_S)
        assert found.uv is not None
        layout = _texels(body, found.uv[found.faces], footprint)
    except ValueError as error:
        layout = str(error)
    if isinstance(layout, TexelLayout):
        return replace(layout, made=found), warnings
    warnings.append(f"the texture is given at the mesh's vertices: {layout}")
    return VertexLayout(body), warnings


def texel_layout(body: MeshBody, side: int) -> TexelLayout | str:
    """The layout of a map of so many texels a side over a mesh's own texture coordinates, or what is wrong."""
    assert body.mesh.uv is not None
    return _rastered(body, body.mesh.uv[body.mesh.faces], side)


def _fault(mesh: TriangleMesh, corners: Floats) -> str:
    """What is wrong with texture coordinates (f, 3, 2) before looking for overlaps; empty if nothing is."""
    if corners.min() < -_EDGE or corners.max() > 1 + _EDGE:
        low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
        return f"they run from {low.round(3).tolist()} to {high.round(3).tolist()}, beyond 0 to 1"
    areas = _areas(mesh)
    bare = float(areas[np.abs(_doubled(corners)) < 1e-12].sum() / areas.sum())
    if bare > _BARE:
        return f"{bare:.0%} of the surface has none of any area"
    return ""


def _texels(body: MeshBody, corners: Floats, footprint: float) -> TexelLayout | str:
    """The layout of texture coordinates, or what is wrong with them."""
    mesh = body.mesh
    surface = _areas(mesh).sum()
    chart = np.abs(_doubled(corners)).sum() / 2
    return _rastered(body, corners, int(np.clip(np.sqrt(surface / chart) / footprint, _SMALLEST, LARGEST)))


def _rastered(body: MeshBody, corners: Floats, side: int) -> TexelLayout | str:
    """The layout of a map of so many texels a side, or what is wrong with the coordinates."""
    # A texel on an edge that two triangles share is the one's or the other's; inside both it is nobody's.
    owner = np.full(side * side, -1)
    weights = np.zeros((side * side, 3))
    inside = np.zeros(side * side, np.int64)
    for texels, faces, inner in _covered(corners, side):
        owner[texels], weights[texels] = faces, inner
        np.add.at(inside, texels[inner.min(axis=1) > _EDGE], 1)
    covered = np.flatnonzero(owner >= 0)
    if not len(covered):
        return "they cover no texel"
    overlapping = float((inside[covered] > 1).mean())
    if overlapping > _OVERLAP:
        return f"{overlapping:.0%} of the texels lie in more than one triangle"
    rows, columns = np.divmod(covered, side)
    weights = np.clip(weights[covered], 0, 1)
    weights /= weights.sum(axis=1, keepdims=True)
    return TexelLayout(body, corners, side, rows, columns, owner[covered], weights)


def _covered(corners: Floats, side: int) -> Iterator[tuple[Ints, Ints, Floats]]:
    """Numbers of texels, the faces in which their centres lie, and where in them (n, 3), some faces at a time."""
    # In texels, x to the right and y down, centres at integers.
    x, y = corners[:, :, 0] * side - 0.5, (1 - corners[:, :, 1]) * side - 0.5
    left, right = (np.clip(edge, 0, side - 1).astype(int) for edge in (np.ceil(x.min(1)), np.floor(x.max(1))))
    top, bottom = (np.clip(edge, 0, side - 1).astype(int) for edge in (np.ceil(y.min(1)), np.floor(y.max(1))))
    width, height = np.maximum(right - left + 1, 0), np.maximum(bottom - top + 1, 0)
    doubled = (x[:, 1] - x[:, 0]) * (y[:, 2] - y[:, 0]) - (x[:, 2] - x[:, 0]) * (y[:, 1] - y[:, 0])
    counts = np.where(np.abs(doubled) > 1e-9, width * height, 0)
    for part in np.split(
        np.arange(len(counts)), np.flatnonzero(np.diff(np.cumsum(counts) // _AT_A_TIME)) + 1
    ):
        faces = np.repeat(part, counts[part])
        if not len(faces):
            continue
        starts = np.repeat(np.cumsum(counts[part]) - counts[part], counts[part])
        down, along = np.divmod(np.arange(len(faces)) - starts, width[faces])
        column, row = left[faces] + along, top[faces] + down
        weights = np.empty((len(faces), 3))
        for k in range(3):
            one, other = (k + 1) % 3, (k + 2) % 3
            weights[:, k] = (
                (x[faces, one] - column) * (y[faces, other] - row)
                - (x[faces, other] - column) * (y[faces, one] - row)
            ) / doubled[faces]
        within = weights.min(axis=1) >= -1e-9
        yield row[within] * side + column[within], faces[within], weights[within]


def _areas(mesh: TriangleMesh) -> Floats:
    """The areas (f,) of a mesh's faces."""
    return np.linalg.norm(area_vectors(mesh.vertices, mesh.faces), axis=1)


def _doubled(corners: Floats) -> Floats:
    """Twice the signed area (f,) of triangles (f, 3, 2)."""
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return np.asarray(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0])
