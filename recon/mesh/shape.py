"""The mesh of a photo set: read, in metres, and checked for what scans suffer from."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from capture.photoset import PhotoSet
from recon.mesh.trianglemesh import TriangleMesh, area_vectors, merged_faces, read_mesh

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001}

# Pieces that hold less than this share of the largest one's area are dirt of the scan.
_LOOSE = 0.001
# Share of all area that may be left out as dirt; beyond it the mesh is in crumbs.
_MOST_LOOSE = 0.05
# Share of edges whose two faces disagree on which side is outside, beyond which normals mean nothing.
_MOST_TWISTED = 0.01


@dataclass(frozen=True, eq=False)
class ObjectMesh:
    """The mesh of [object] in its own frame, metres; `warnings`, in plain words, of what was left out or is missing."""

    mesh: TriangleMesh
    warnings: tuple[str, ...]


def read_object_mesh(photoset: PhotoSet) -> ObjectMesh:
    """The mesh that a photo set names; ValueError names the file, what is wrong with it, and what to do."""
    table = photoset.object
    if table.mesh is None:
        raise ValueError(
            f"{photoset.manifest}: [object] has no mesh: give shape = 'mesh' and mesh = the file (PLY, OBJ, STL, GLB)"
        )
    path = photoset.resolve(table.mesh)
    mesh = read_mesh(path)
    mesh = replace(mesh, vertices=mesh.vertices * METRES[table.unit])
    try:
        kept, warnings = without_loose_pieces(mesh)
        warnings += opening_warnings(kept)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    return ObjectMesh(kept, tuple(f"{path.name}: {warning}" for warning in warnings))


def placed(mesh: TriangleMesh, mesh_to_world: Floats) -> TriangleMesh:
    """The mesh in the world; mesh_to_world : (4, 4) rigid."""
    turn = mesh_to_world[:3, :3]
    return replace(
        mesh, vertices=mesh.vertices @ turn.T + mesh_to_world[:3, 3], normals=mesh.normals @ turn.T
    )


def without_loose_pieces(mesh: TriangleMesh) -> tuple[TriangleMesh, list[str]]:
    """The mesh without the small loose pieces that scanners leave, and a sentence if there were any.

    A piece is loose if its area is below 0.1% of the largest's. ValueError if loose ones hold more than 5% of all area.
    """
    piece = _pieces(mesh)
    areas = np.linalg.norm(area_vectors(mesh.vertices, mesh.faces), axis=1)
    of_piece = np.asarray(np.bincount(piece, areas), float)
    if not of_piece.max() > 0:
        raise ValueError("all faces of the mesh are without area; export it again")
    loose = of_piece < _LOOSE * of_piece.max()
    if not loose.any():
        return mesh, _pieces_warning(of_piece)
    share = float(of_piece[loose].sum() / of_piece.sum())
    if share > _MOST_LOOSE:
        raise ValueError(
            f"the mesh is in {len(of_piece)} loose pieces, and {int(loose.sum())} small ones hold {share:.0%} of its"
            " area; merge vertices that are at one place, or remove what isn't the object, in a mesh editor"
        )
    kept = _faces_of(mesh, ~loose[piece])
    left_out = f"{int(loose.sum())} loose pieces, {share:.2g} of the area, are left out as dirt of the scan"
    return kept, [*_pieces_warning(of_piece[~loose]), left_out]


def _pieces_warning(areas: NDArray[np.floating]) -> list[str]:
    """A sentence if the mesh has several pieces, by their areas."""
    if len(areas) == 1:
        return []
    share = 1 - float(areas.max() / areas.sum())
    return [
        f"the mesh has {len(areas)} separate pieces; all but the largest hold {share:.1%} of its area: if they aren't"
        " the object, remove them in a mesh editor"
    ]


def largest_piece(mesh: TriangleMesh) -> TriangleMesh:
    """The connected piece that has the largest area."""
    piece = _pieces(mesh)
    areas = np.linalg.norm(area_vectors(mesh.vertices, mesh.faces), axis=1)
    return _faces_of(mesh, piece == np.bincount(piece, areas).argmax())


def opening_warnings(mesh: TriangleMesh) -> list[str]:
    """What is open in a mesh, in sentences; ValueError where its faces don't agree on what is outside."""
    faces = merged_faces(mesh.vertices, mesh.faces)
    start, end = faces.ravel().astype(np.int64), np.roll(faces, -1, axis=1).ravel().astype(np.int64)
    size = int(faces.max()) + 1
    # An edge of a closed mesh is run through once in either direction: sides then add up to nothing.
    edge = np.minimum(start, end) * size + np.maximum(start, end)
    distinct, index, uses = np.unique(edge, return_inverse=True, return_counts=True)
    sides = np.bincount(index, np.where(start < end, 1.0, -1.0))
    twisted = float(((uses == 2) & (np.abs(sides) == 2)).mean())
    if twisted > _MOST_TWISTED:
        raise ValueError(
            f"{twisted:.0%} of the mesh's edges join faces that disagree on which side is outside; orient its faces"
            " alike in a mesh editor"
        )
    open_edges = uses == 1
    if not open_edges.any():
        return []
    low, high = np.divmod(distinct[open_edges], size)
    at = np.zeros((size, 3))
    at[faces.ravel()] = mesh.vertices[mesh.faces.ravel()]
    length = float(np.linalg.norm(at[low] - at[high], axis=1).sum())
    holes = connected_components(coo_array((np.ones(len(low)), (low, high)), shape=(size, size)))[1]
    count = len(np.unique(holes[low]))
    return [
        f"the mesh has {count} opening{'s' if count > 1 else ''}, {length:.3g} m around: light comes in there, and"
        " what is seen through one isn't sampled; close it if the object is closed there"
    ]


def _pieces(mesh: TriangleMesh) -> Ints:
    """Which connected piece each face belongs to, (f,)."""
    faces = merged_faces(mesh.vertices, mesh.faces)
    size = int(faces.max()) + 1
    pairs = np.concatenate([faces[:, :2], faces[:, 1:]])
    graph = coo_array((np.ones(len(pairs), np.int8), (pairs[:, 0], pairs[:, 1])), shape=(size, size))
    _, label = connected_components(graph, directed=False)
    _, piece = np.unique(label[faces[:, 0]], return_inverse=True)
    return np.asarray(piece, np.int64)


def _faces_of(mesh: TriangleMesh, keep: NDArray[np.bool_]) -> TriangleMesh:
    """The mesh of some of its faces, and of the vertices that they use."""
    used, faces = np.unique(mesh.faces[keep], return_inverse=True)
    return TriangleMesh(
        vertices=mesh.vertices[used],
        faces=faces.reshape(-1, 3),
        normals=mesh.normals[used],
        uv=None if mesh.uv is None else mesh.uv[used],
    )
