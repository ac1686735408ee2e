"""Kd and Ks that vary over a surface: both sides' means over the same part of it, or word that there is none."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from capture.files.imagefile import read_pixels
from invrender.estimate.textured.layout import TexelLayout, VertexLayout, texel_layout
from invrender.result.saved import SavedResult
from invrender.result.saved_textures import SavedTextures, read_textures
from invrender.result.side import Number, Side, TrueTextures
from invrender.result.truth import brdf_of
from recon.mesh.bodies import MeshBody, blended
from recon.mesh.trianglemesh import TriangleMesh, read_mesh

Floats = NDArray[np.float64]
_Layout = TexelLayout | VertexLayout

# Corners of a scan's faces lie this near to those of the true surface, as a share of its size.
_SAME_FACES = 0.1
# A texel counts as known from this alpha on.
_KNOWN = 0.5
_MESH_ENDINGS = (".obj", ".ply", ".stl", ".glb")


@dataclass(frozen=True, eq=False)
class Matched:
    """Two sides whose Kd and Ks are means over the same part of a surface, unless `unlike`.

    note : a sentence, or empty.
    """

    first: Side
    second: Side
    unlike: bool
    note: str


def over_same_part(first: Side, second: Side) -> Matched:
    """Both sides, the truth of a textured object with its means over the part that the other side determines.

    Where the two sides' means are over different parts, and no truth can follow, both stay as they are, unlike.
    """
    if first.textures is None and second.textures is None:
        return Matched(first, second, False, "")
    try:
        if isinstance(first.textures, TrueTextures) and isinstance(second.textures, SavedResult):
            return Matched(_over_part(first, second.textures), second, False, _same("B", second.textures))
        if isinstance(second.textures, TrueTextures) and isinstance(first.textures, SavedResult):
            return Matched(first, _over_part(second, first.textures), False, _same("A", first.textures))
    except ValueError as error:
        return Matched(first, second, True, f"Kd and Ks are not judged: {error}.")
    if isinstance(first.textures, TrueTextures) and isinstance(second.textures, TrueTextures):
        return Matched(first, second, False, "")
    if isinstance(first.textures, SavedResult) and isinstance(second.textures, SavedResult):
        if _same_texels(first.textures, second.textures):
            return Matched(first, second, False, "")
        reason = "A and B determine different parts of the surface, over which they vary"
    elif (other := second if first.textures else first).is_truth:
        # One Kd and Ks all over: the mean over any part.
        return Matched(first, second, False, "")
    else:
        varied = "A" if first.textures else "B"
        reason = f"they vary over the surface in {varied}, and {other.title} has one value for it"
    return Matched(first, second, True, f"Kd and Ks are not judged: {reason}.")


def _same(name: str, result: SavedResult) -> str:
    assert result.content.texture is not None
    return (
        f"Kd and Ks are means over the {result.content.texture.known:.0%} of the surface that {name} determines, those"
        " of the truth too."
    )


def _same_texels(first: SavedResult, second: SavedResult) -> bool:
    """Whether two results have their textures at the same places and determine the same of them."""
    one, other = (_textures(result) for result in (first, second))
    if one.known is None or other.known is None:
        return False
    return (
        _meshes(first) == _meshes(second)
        and one.at_vertices == other.at_vertices
        and np.array_equal(one.known >= _KNOWN, other.known >= _KNOWN)
    )


def _meshes(result: SavedResult) -> dict[str, str]:
    """The meshes among what a result was made from, with their hashes."""
    inputs = result.content.inputs.items()
    return {name: known for name, known in inputs if name.lower().endswith(_MESH_ENDINGS)}


def _textures(result: SavedResult) -> SavedTextures:
    textures = read_textures(result, np.zeros(3))
    if textures is None:
        raise ValueError(f"{result.path}: names textures that aren't beside it")
    return textures


def _over_part(truth: Side, result: SavedResult) -> Side:
    """The truth with means over the part of the surface that a result determines; ValueError where they don't fit."""
    true_textures = truth.textures
    assert isinstance(true_textures, TrueTextures)
    kd, ks = true_means(true_textures, result)
    total = np.where(kd + ks > 0, kd + ks, 1.0)
    means = {"kd": kd, "ks": ks, "kd_normalised": kd / total, "ks_normalised": ks / total}
    numbers = {
        name: Number(means[name], np.zeros(3)) if name in means else number
        for name, number in truth.numbers.items()
    }
    return replace(truth, numbers=numbers, brdf=brdf_of(numbers, truth.form))


def true_means(true_textures: TrueTextures, result: SavedResult) -> tuple[Floats, Floats]:
    """Kd and Ks (3,) of the truth, means over the part of the surface that a result determines, weighed by area.

    The true textures are looked up at texels no larger than its own. ValueError where a file is missing, or where the
    truth's mesh is not the one that the result's textures lie on.
    """
    for file in (true_textures.kd_map, true_textures.ks_map, true_textures.mesh):
        if not file.is_file():
            raise ValueError(f"{file} is missing; copy the whole folder that `lightfactor synth` wrote")
    textures, true_mesh = _textures(result), read_mesh(true_textures.mesh)
    layout = _layout(result, textures, true_mesh)
    known = np.ones(len(layout), bool)
    if textures.known is not None:
        picture = textures.known >= _KNOWN
        known = picture[0] if isinstance(layout, VertexLayout) else picture[layout.rows, layout.columns]
    if not known.any():
        raise ValueError(f"{result.path} determines no part of the surface")
    kd_map, ks_map = (
        read_pixels(file).astype(float) for file in (true_textures.kd_map, true_textures.ks_map)
    )
    layout, known = _as_fine(layout, known, max(*kd_map.shape[:2], *ks_map.shape[:2]))
    # As bilinear as the renderer looks them up.
    none = np.zeros((1, 1, 3))
    seen = SavedTextures(kd_map, ks_map, none, none).at(_true_coordinates(layout, true_mesh)[known])
    weights = layout.areas[known]
    kd, ks = (
        true_textures.factor * np.average(values, axis=0, weights=weights) for values in (seen.kd, seen.ks)
    )
    return kd, ks


def _layout(result: SavedResult, textures: SavedTextures, true_mesh: TriangleMesh) -> _Layout:
    """Where a result's textures have their values."""
    table = result.content.texture
    assert table is not None
    mesh = true_mesh if table.mesh is None else read_mesh(result.folder / table.mesh)
    apart = np.inf
    if mesh.faces.shape == true_mesh.faces.shape:
        apart = float(np.abs(mesh.vertices[mesh.faces] - true_mesh.vertices[true_mesh.faces]).max())
    if true_mesh.uv is None or apart > _SAME_FACES * float(np.ptp(true_mesh.vertices, axis=0).max()):
        raise ValueError(f"the truth's mesh is not the one that the textures of {result.path} lie on")
    height, width = textures.kd.shape[:2]
    if textures.at_vertices:
        if (height, width) != (1, len(mesh.vertices)):
            raise ValueError(
                f"{result.path} has textures of {width} vertices, the truth's mesh has {len(mesh.vertices)}"
            )
        return VertexLayout(MeshBody(mesh))
    layout = texel_layout(MeshBody(mesh), height)
    if isinstance(layout, str):
        raise ValueError(f"the texture coordinates of {result.path} can't be used: {layout}")
    return layout


def _as_fine(layout: _Layout, known: NDArray[np.bool_], side: int) -> tuple[_Layout, NDArray[np.bool_]]:
    """A layout of texels no larger than those of a map of so many a side, and which of them are known."""
    while isinstance(layout, TexelLayout) and layout.side < side:
        layout, parents = layout.finer()
        known = (parents >= 0) & known[parents]
    return layout, known


def _true_coordinates(layout: _Layout, true_mesh: TriangleMesh) -> Floats:
    """The truth's texture coordinates (n, 2) at a layout's points, face by face."""
    assert true_mesh.uv is not None
    if isinstance(layout, VertexLayout):
        return true_mesh.uv
    return blended(true_mesh.uv, true_mesh.faces[layout.faces], layout.weights)
