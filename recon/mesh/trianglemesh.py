"""Triangle meshes: what they must hold, whether they are closed, and their files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from capture.arrays import frozen_array

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Positions nearer than this share of a mesh's size are the same.
_SAME = 1e-6
# Normals are unit to this: single precision, in which files hold them, is good to 1e-7.
_UNIT = 1e-6
# Normals of a file whose length is off by more than this were not meant to be unit.
_NEARLY_UNIT = 0.01


@dataclass(frozen=True, eq=False)
class TriangleMesh:
    """A surface of triangles.

    vertices : (v, 3) metres. faces : (f, 3) indices, counterclockwise seen from outside.
    normals : (v, 3) unit, outward, of the smooth surface that the triangles stand for.
    uv : (v, 2) texture coordinates, u to the right and v up, or None. Along a seam of the texture vertices
        are doubled: same position and normal, another uv.
    """

    vertices: Floats
    faces: Ints
    normals: Floats
    uv: Floats | None = None

    def __post_init__(self) -> None:
        faces = np.asarray(self.faces)
        if faces.ndim != 2 or faces.shape[1] != 3 or not np.issubdtype(faces.dtype, np.integer):
            raise ValueError(f"faces are {faces.shape} {faces.dtype}; they must be (f, 3) integers")
        if not len(faces):
            raise ValueError("the mesh has no faces")
        object.__setattr__(self, "faces", frozen_array(faces, np.int64))
        count = len(np.asarray(self.vertices))
        for name, width in (("vertices", 3), ("normals", 3), ("uv", 2)):
            if getattr(self, name) is None and name == "uv":
                continue
            values = frozen_array(getattr(self, name))
            if values.shape != (count, width):
                raise ValueError(f"{name} are {values.shape}; {count} vertices need {(count, width)}")
            if not np.isfinite(values).all():
                row = int(np.flatnonzero(~np.isfinite(values).all(axis=1))[0])
                raise ValueError(f"{name}[{row}] is {values[row]}; all must be finite")
            object.__setattr__(self, name, values)
        low, high = int(faces.min()), int(faces.max())
        if low < 0 or high >= count:
            wrong = low if low < 0 else high
            raise ValueError(f"a face names vertex {wrong}, but the mesh has vertices 0 to {count - 1}")
        lengths = np.linalg.norm(self.normals, axis=1)
        worst = int(np.abs(lengths - 1).argmax())
        if abs(lengths[worst] - 1) > _UNIT:
            raise ValueError(f"normals[{worst}] has length {lengths[worst]:.9g}; normals must be unit")


def area_vectors(vertices: Floats, faces: Ints) -> Floats:
    """Outward normal of each face times its area, (f, 3) square metres."""
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    return np.asarray(np.cross(b - a, c - a) / 2)


def volume(mesh: TriangleMesh) -> float:
    """Volume that a closed mesh encloses, cubic metres; negative where its faces are inside out."""
    first = mesh.vertices[mesh.faces[:, 0]]
    return float((first * area_vectors(mesh.vertices, mesh.faces)).sum() / 3)


def merged_faces(vertices: Floats, faces: Ints) -> Ints:
    """Faces (f, 3) as indices of distinct positions, so that seams of the texture close.

    Positions count as one up to a millionth of the mesh's size: what one modeller wrote for the two sides of a seam, or
    in single precision for the corners of each face, often differs in the last digits.
    """
    distinct, position = np.unique(vertices, axis=0, return_inverse=True)
    size = float(np.ptp(distinct, axis=0).max())
    near = cKDTree(distinct).query_pairs(_SAME * size, output_type="ndarray")
    count = len(distinct)
    pairs = coo_array((np.ones(len(near), np.int8), (near[:, 0], near[:, 1])), shape=(count, count))
    _, place = connected_components(pairs, directed=False)
    return np.asarray(place[position.reshape(-1)][faces], dtype=np.int64)


def _collapsed(faces: Ints) -> NDArray[np.bool_]:
    """Which faces (f,) have a corner twice."""
    return np.asarray((faces == np.roll(faces, -1, axis=1)).any(axis=1))


def is_watertight(mesh: TriangleMesh) -> bool:
    """Whether the surface is closed and consistently oriented, vertices at one position counting as one.

    It is if every edge of a face is run through once in either direction. Faces so small that their corners count as
    one position are left out; one that names a vertex twice is none.
    """
    if _collapsed(mesh.faces).any():
        return False
    faces = merged_faces(mesh.vertices, mesh.faces)
    faces = faces[~_collapsed(faces)]
    if not len(faces):
        return False
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    size = int(faces.max()) + 1
    forward, backward = np.sort(start * size + end), np.sort(end * size + start)
    return bool((np.diff(forward) > 0).all() and np.array_equal(forward, backward))


def smooth_normals(vertices: Floats, faces: Ints) -> Floats:
    """Vertex normals (v, 3): the faces' normals, each weighted by its angle at the vertex.

    Vertices at one position get one normal [Thürmer & Wüthrich 1998, "Computing vertex normals from polygonal
    facets"]: unlike weights of area, angles don't depend on how the surface is cut into triangles.
    """
    merged = merged_faces(vertices, faces)
    facets = area_vectors(vertices, faces)
    facets = facets / np.maximum(np.linalg.norm(facets, axis=1, keepdims=True), np.finfo(float).tiny)
    sums = np.zeros((int(merged.max()) + 1, 3))
    for corner in range(3):
        here = vertices[faces[:, corner]]
        one = vertices[faces[:, corner - 2]] - here
        other = vertices[faces[:, corner - 1]] - here
        angle = np.arctan2(np.linalg.norm(np.cross(one, other), axis=1), (one * other).sum(axis=1))
        for axis in range(3):
            sums[:, axis] += np.bincount(merged[:, corner], angle * facets[:, axis], len(sums))
    normals = np.zeros_like(vertices, dtype=np.float64)
    normals[faces] = sums[merged]
    lengths = np.linalg.norm(normals, axis=1)
    # A vertex whose faces cancel, or that no face names, has no normal.
    if (lengths < 1e-9).any():
        raise ValueError(
            f"vertex {int(lengths.argmin())} has no normal: it has no faces, or these cancel, as where a mesh holds"
            " each face a second time, turned over; remove what is double in a mesh editor"
        )
    return normals / lengths[:, None]


def write_mesh(path: Path, mesh: TriangleMesh) -> None:
    """Write a mesh as OBJ (v, vt, vn) or, where it has no uv, also as ASCII PLY; the suffix decides.

    Numbers have 9 digits, so the same mesh gives the same bytes.
    """
    count = len(mesh.vertices)
    if path.suffix.lower() == ".obj":
        parts = [_lines("v %.9g %.9g %.9g\n", mesh.vertices)]
        if mesh.uv is not None:
            parts.append(_lines("vt %.9g %.9g\n", mesh.uv))
        parts.append(_lines("vn %.9g %.9g %.9g\n", mesh.normals))
        # A corner's position, uv and normal stand in lines of the same number, counted from 1.
        corner = "%d//%d" if mesh.uv is None else "%d/%d/%d"
        indices = np.repeat(mesh.faces + 1, corner.count("%d"), axis=1)
        parts.append(_lines(f"f {corner} {corner} {corner}\n", indices))
    elif path.suffix.lower() == ".ply":
        if mesh.uv is not None:
            raise ValueError(f"{path}: PLY holds no texture coordinates here; write the mesh as .obj")
        properties = "".join(f"property double {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz"))
        parts = [
            f"ply\nformat ascii 1.0\nelement vertex {count}\n{properties}"
            f"element face {len(mesh.faces)}\nproperty list uchar int vertex_indices\nend_header\n",
            _lines("%.9g %.9g %.9g %.9g %.9g %.9g\n", np.hstack([mesh.vertices, mesh.normals])),
            _lines("3 %d %d %d\n", mesh.faces),
        ]
    else:
        raise ValueError(f"{path}: meshes are written as .obj or .ply, not as {path.suffix!r}")
    path.write_bytes("".join(parts).encode("ascii"))


def read_mesh(path: Path) -> TriangleMesh:
    """Read a mesh from PLY, OBJ, STL or GLB, in the file's own coordinates, taken as metres.

    Normals are the file's if it has them, else smooth ones. Faces without area, and vertices that no other face
    uses, are left out: no ray meets them, and they have no normal. Raises ValueError, which names the file, where it
    cannot be read, has no faces, holds numbers that aren't finite, or is inside out.
    """
    # Slow to import, and needed only where a mesh is read.
    import trimesh

    if not path.is_file():
        raise ValueError(f"{path}: there is no such file")
    try:
        scene = trimesh.load_scene(path, process=False)
    except Exception as error:  # trimesh's readers raise whatever a malformed file leads them into
        raise ValueError(f"{path}: cannot be read as a mesh ({error}); PLY, OBJ, STL and GLB can") from error
    placed = [scene.graph[node] for node in scene.graph.nodes_geometry]
    parts = [_part(scene.geometry[name], transform) for transform, name in placed]
    parts = [part for part in parts if len(part[1])]
    if not parts:
        raise ValueError(f"{path}: the mesh has no faces; a cloud of points is not enough")
    vertices = np.concatenate([part[0] for part in parts])
    starts = np.cumsum([0, *(len(part[0]) for part in parts)])
    faces = np.concatenate([part[1] + start for part, start in zip(parts, starts, strict=False)])
    try:
        if not np.isfinite(vertices).all():
            row = int(np.flatnonzero(~np.isfinite(vertices).all(axis=1))[0])
            raise ValueError(f"vertices[{row}] is {vertices[row]}; all must be finite")
        normals, uv = _of_all([part[2] for part in parts]), _of_all([part[3] for part in parts])
        used, faces = _with_area(vertices, faces)
        vertices, uv = vertices[used], None if uv is None else uv[used]
        normals = smooth_normals(vertices, faces) if normals is None else _unit(normals[used])
        mesh = TriangleMesh(vertices, faces, normals, uv)
        _check_outward(mesh)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    return mesh


def _part(geometry: Any, transform: Floats) -> tuple[Floats, Ints, Floats | None, Floats | None]:
    """Vertices, faces, normals and uv of one of the meshes that a file may hold, moved to its place."""
    faces = np.asarray(getattr(geometry, "faces", []), dtype=np.int64).reshape(-1, 3)
    vertices = np.asarray(geometry.vertices, dtype=np.float64)
    # Without this, one number that isn't finite would spread to the vertex's other two.
    moved = not np.array_equal(transform, np.eye(4))
    linear = transform[:3, :3]
    if moved:
        vertices = vertices @ linear.T + transform[:3, 3]
    normals = None
    # Asked for its normals, trimesh computes what the file hasn't; only what it read lies in its cache.
    if len(faces) and "vertex_normals" in geometry._cache.cache:
        normals = np.asarray(geometry.vertex_normals, dtype=np.float64)
        if moved:
            normals = normals @ np.linalg.inv(linear)
            normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.finfo(float).tiny)
    return vertices, faces, normals, getattr(getattr(geometry, "visual", None), "uv", None)


def _of_all(values: list[Floats | None]) -> Floats | None:
    """The parts' values in one array; None where a part has none."""
    given = [value for value in values if value is not None]
    return np.concatenate(given) if len(given) == len(values) else None


def _with_area(vertices: Floats, faces: Ints) -> tuple[Ints, Ints]:
    """Which vertices the faces that have an area use, and those faces (f, 3) by their places among these."""
    areas = np.linalg.norm(area_vectors(vertices, faces), axis=1)
    if not areas.any():
        raise ValueError(f"all {len(faces)} faces of the mesh are without area")
    used, faces = np.unique(faces[areas > 0], return_inverse=True)
    return used, faces.reshape(-1, 3)


def _lines(form: str, rows: NDArray[Any]) -> str:
    return (form * len(rows)) % tuple(rows.ravel().tolist())


def _unit(normals: Floats) -> Floats:
    normals = np.asarray(normals, dtype=np.float64)
    lengths = np.linalg.norm(normals, axis=1)
    wrong = ~(np.abs(lengths - 1) < _NEARLY_UNIT)
    if wrong.any():
        row = int(np.flatnonzero(wrong)[0])
        raise ValueError(f"normals[{row}] is {normals[row]}, not unit; write the mesh without normals")
    return np.asarray(normals / lengths[:, None])


def _check_outward(mesh: TriangleMesh) -> None:
    facets = area_vectors(mesh.vertices, mesh.faces)
    along = np.einsum("fi,fci->f", facets, mesh.normals[mesh.faces])
    if along.sum() < 0:
        raise ValueError("the normals point against the faces, which run counterclockwise seen from outside")
    if is_watertight(mesh) and volume(mesh) < 0:
        raise ValueError(
            f"the mesh is inside out (its volume is {volume(mesh):.3g}); flip its faces and normals"
        )
