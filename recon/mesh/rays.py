"""Rays on a triangle mesh, by Embree: what they meet first, and whether they meet anything.

Embree works in single precision. The mesh is therefore moved to the origin and scaled to unit size before it is
handed over, and rays begin near it: what remains is 5e-8 of the mesh's size, a thousandth of a pixel. `embreex` checks
nothing (arrays of the wrong shape are read beyond their end), so everything is checked here. Embree spends some 80 ns
on a ray: to add little, rays are prepared column by column, as many at a time as stay in a core's cache.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from embreex.mesh_construction import TriangleMesh as EmbreeMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import ArrayLike, NDArray

from capture.arrays import frozen_array
from capture.parallel import parallel_map

Floats = NDArray[np.float64]
AnyFloats = NDArray[np.floating]
Singles = NDArray[np.float32]
Ints = NDArray[np.int32]
Mask = NDArray[np.bool_]

# Rays leave a surface from so far above it, in sizes of the mesh: far more than single precision rounds (1e-7), so
# that no facet shadows itself, and less than anything whose shadow is worth having.
_OFFSET = 1e-4
# Rays that are prepared at once, in a core's cache; and how many such parts a thread takes at once.
_RAYS_AT_A_TIME, _PARTS_PER_TASK = 8192, 4


@dataclass(frozen=True, eq=False)
class Hits:
    """What n rays meet first.

    faces : (n,) int32 index, -1 where a ray meets nothing. weights : (n, 3) float64 of the face's corners, sum 1,
    zeros where it meets nothing. The point that they give lies 5e-8 of the mesh's size beside the ray (RMS; at most
    1e-6, and 2e-5 where the ray grazes the face), and interpolated normals are off by 1e-6 rad.
    """

    faces: Ints
    weights: Floats


@dataclass(frozen=True, eq=False)
class RayTracer:
    """A mesh that rays can be traced on, met from both sides of its faces; built anew where it is unpickled.

    vertices : (v, 3) metres. faces : (f, 3) indices of vertices.
    on_all_cores : whether each call spreads its rays over threads, one per core. Leave it False where the callers
        are threads themselves: Embree releases the interpreter, so that they can share a tracer.
    centre : (3,), and size, metres: the middle and the longest side of the box around the faces.
    """

    vertices: Floats
    faces: NDArray[np.integer]
    on_all_cores: bool = False
    centre: Floats = field(init=False)
    size: float = field(init=False)
    _scene: EmbreeScene = field(init=False, repr=False)

    def __post_init__(self) -> None:
        vertices, faces = _checked_mesh(self.vertices, self.faces)
        used = vertices[np.unique(faces)]
        low, high = used.min(axis=0), used.max(axis=0)
        size = float((high - low).max())
        if not size > 0:
            raise ValueError(f"all vertices of the mesh are at {low.tolist()}; its size must be > 0")
        object.__setattr__(self, "vertices", frozen_array(vertices))
        object.__setattr__(self, "faces", frozen_array(faces, np.int32))
        object.__setattr__(self, "centre", frozen_array((low + high) / 2))
        object.__setattr__(self, "size", size)
        scene = EmbreeScene()
        EmbreeMesh(scene, ((self.vertices - self.centre) / size).astype(np.float32), self.faces)
        # The first call builds the tree, which threads must not do at the same time.
        scene.run(*np.zeros((2, 0, 3), np.float32))
        object.__setattr__(self, "_scene", scene)

    def __reduce__(self) -> tuple[type[RayTracer], tuple[Floats, NDArray[np.integer], bool]]:
        return RayTracer, (self.vertices, self.faces, self.on_all_cores)

    def first_hits(self, origins: AnyFloats, directions: AnyFloats, facets: AnyFloats | None = None) -> Hits:
        """What rays from origins (n, 3), metres, in unit directions (n, 3) meet first.

        facets : (n, 3) unit, outward, for origins on the mesh itself: the rays begin as in `occluded`.
        """
        given = {"origins": origins, "directions": directions}
        given |= {} if facets is None else {"facets": facets}
        _check_shapes(given)
        faces = np.empty(len(origins), np.int32)
        weights = np.zeros((3, len(origins)))  # corner by corner: rows are written at one go

        def trace(part: slice) -> None:
            own_facets = None if facets is None else facets[part]
            starts, ways = self._before(origins[part], directions[part], own_facets, given, part)
            found = self._scene.run(_single(starts).T, _single(ways).T, output=1)
            faces[part] = found["primID"]
            hit = faces[part] >= 0
            # Of rays that meet nothing, u and v are anything.
            w, u, v = weights[:, part]
            np.copyto(u, found["u"], where=hit)
            np.copyto(v, found["v"], where=hit)
            np.subtract(hit, u, out=w)
            w -= v

        self._spread(trace, len(origins))
        return Hits(faces, weights.T)

    def met(self, origins: AnyFloats, directions: AnyFloats) -> Mask:
        """Whether rays from origins (n, 3), metres, in unit directions (n, 3) meet anything, (n,): `first_hits` in less
        time."""
        given = {"origins": origins, "directions": directions}
        _check_shapes(given)
        result = np.empty(len(origins), bool)

        def trace(part: slice) -> None:
            starts, ways = self._before(origins[part], directions[part], None, given, part)
            result[part] = self._scene.run(_single(starts).T, _single(ways).T, query="OCCLUDED") >= 0

        self._spread(trace, len(origins))
        return result

    def occluded(
        self,
        positions: AnyFloats,
        facets: AnyFloats,
        directions: AnyFloats,
        distances: AnyFloats | None = None,
    ) -> Mask:
        """Whether rays that leave points of the mesh meet it again, (n,).

        positions : (n, 3) metres. The rays begin 1e-4 of the mesh's size above them, along facets : (n, 3) unit,
        outward. directions : (n, 3) unit; those below the facet count as occluded without a ray.
        distances : (n,) metres, > 0, may be inf: what is further away doesn't count.
        """
        given = {"positions": positions, "facets": facets, "directions": directions}
        _check_shapes(given)
        if distances is not None and (distances.shape != (len(positions),) or not (distances > 0).all()):
            raise ValueError(
                f"distances of shape {distances.shape}, the least {np.min(distances, initial=np.inf)};"
                f" they must be {(len(positions),)} and > 0"
            )
        result = np.empty(len(positions), bool)

        def trace(part: slice) -> None:
            starts, ways = self._starts(positions[part], facets[part]), _columns(directions[part])
            rise = np.einsum("cn,cn->n", ways, _columns(facets[part]))
            _check_finite(starts, given, part)
            _check_finite(rise, given, part)
            # Embree lets a ray of negative length go at once.
            reach = np.inf if distances is None else distances[part] / self.size
            ends = np.where(rise > 0, reach, -1).astype(np.float32)
            met = self._scene.run(_single(starts).T, _single(ways).T, ends, query="OCCLUDED") >= 0
            result[part] = met | (rise <= 0)

        self._spread(trace, len(positions))
        return result

    def occluded_sky(self, positions: AnyFloats, normals: AnyFloats, directions: AnyFloats) -> Mask:
        """Which of k directions, the same for all, each of v points of the mesh doesn't see, (v, k).

        positions : (v, 3) metres. The rays begin 1e-4 of the mesh's size above them, along normals : (v, 3) unit,
        outward. directions : (k, 3) unit; those below a normal's horizon count as occluded without a ray.
        """
        given = {"positions": positions, "normals": normals}
        _check_shapes(given)
        _check_shapes({"directions": directions})
        ways, count = _columns(directions), len(directions)
        _check_finite(ways, {"directions": directions}, slice(None))
        single_ways = _single(ways)
        result = np.empty((len(positions), count), bool)

        def trace(part: slice) -> None:
            starts = self._starts(positions[part], normals[part])
            _check_finite(starts, given, part)
            # Point by point, so that rays that follow each other pass the same parts of the mesh.
            rising = normals[part] @ ways > 0
            chosen = np.flatnonzero(rising)
            met = self._scene.run(
                _single(starts).repeat(rising.sum(axis=1), axis=1).T,
                single_ways.take(chosen % count, axis=1).T,
                query="OCCLUDED",
            )
            result[part] = ~rising
            result[part].ravel()[chosen] = met >= 0

        self._spread(trace, len(positions), rays_each=count)
        return result

    def _before(
        self,
        origins: AnyFloats,
        directions: AnyFloats,
        facets: AnyFloats | None,
        given: dict[str, AnyFloats],
        part: slice,
    ) -> tuple[Floats, Floats]:
        """Starts and ways (3, n) of rays that may come from afar; given, part : as of `_check_finite`."""
        starts, ways = self._starts(origins, facets), _columns(directions)
        # An origin so far that single precision would lose digits moves along its ray to 1 size before the centre.
        beyond = np.einsum("cn,cn->n", starts, ways)
        _check_finite(beyond, given, part)
        beyond += 1
        starts -= np.minimum(beyond, 0, out=beyond) * ways
        return starts, ways

    def _starts(self, points: AnyFloats, facets: AnyFloats | None) -> Floats:
        """Where rays begin, in sizes of the mesh from its centre, (3, n)."""
        starts = np.subtract(points.T, self.centre[:, None], order="C")
        starts *= 1 / self.size
        if facets is not None:
            starts += _OFFSET * _columns(facets)
        return starts

    def _spread(self, trace: Callable[[slice], None], count: int, rays_each: int = 1) -> None:
        """Trace `count` rows of so many rays each, part by part, on all cores if that was asked for."""
        rows = max(_RAYS_AT_A_TIME // max(rays_each, 1), 1)
        parts = range(0, count, rows)

        def trace_all(parts: range) -> None:
            # What is not finite is found in the sums that it spreads to.
            with np.errstate(invalid="ignore", over="ignore"):
                for first in parts:
                    trace(slice(first, first + rows))

        if self.on_all_cores:
            tasks = [parts[i : i + _PARTS_PER_TASK] for i in range(0, len(parts), _PARTS_PER_TASK)]
            for _ in parallel_map(trace_all, tasks):
                pass
        else:
            trace_all(parts)


def _checked_mesh(vertices: ArrayLike, faces: ArrayLike) -> tuple[Floats, NDArray[np.integer]]:
    vertices, faces = np.asarray(vertices, float), np.asarray(faces)
    if vertices.ndim != 2 or vertices.shape[1] != 3 or not np.isfinite(vertices).all():
        raise ValueError(f"vertices of shape {vertices.shape}; they must be (v, 3) and finite")
    if faces.ndim != 2 or faces.shape[1] != 3 or not len(faces) or faces.dtype.kind not in "iu":
        raise ValueError(
            f"faces are {faces.shape} {faces.dtype}; they must be (f, 3) integers, at least one face"
        )
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise ValueError(
            f"faces name vertices {faces.min()} to {faces.max()}; there are 0 to {len(vertices) - 1}"
        )
    return vertices, faces


def _check_shapes(given: dict[str, AnyFloats]) -> None:
    count = len(next(iter(given.values())))
    for name, vectors in given.items():
        if vectors.shape != (count, 3):
            raise ValueError(f"{name} are {vectors.shape}; they must be {(count, 3)}, one for each ray")


def _check_finite(spread_to: Floats, given: dict[str, AnyFloats], part: slice) -> None:
    """Raise ValueError that names the row of the `given` vectors which made numbers computed of them not finite.

    One sum of what is computed anyway costs a fraction of asking each number given.
    """
    if np.isfinite(spread_to.sum()):
        return
    for name, vectors in given.items():
        wrong = ~np.isfinite(vectors[part]).all(axis=1)
        if wrong.any():
            row = (part.start or 0) + int(wrong.argmax())
            raise ValueError(f"{name}[{row}] is {vectors[row]}; all must be finite")


def _columns(vectors: AnyFloats) -> Floats:
    return vectors.T.astype(np.float64, order="C")


def _single(columns: Floats) -> Singles:
    return columns.astype(np.float32)
