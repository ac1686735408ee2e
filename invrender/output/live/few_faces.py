"""Meshes of many faces, made of as few as browsers draw with ease."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

from invrender.output.render.photographer import Photographer
from invrender.output.render.subject import Subject
from invrender.transport.visibility import Shadows
from recon.mesh.bodies import MeshBody, blended
from recon.mesh.simplified import Simplification, simplification
from recon.mesh.trianglemesh import TriangleMesh

# Faces that a browser holds and traces with ease.
MOST_FACES = 200_000


def few_faces(mesh: TriangleMesh, what: str) -> tuple[Simplification, tuple[str, ...]]:
    """A mesh as browsers draw it, and a sentence where it has fewer faces than before.

    Where seams and sharp edges alone have too many faces, it is without them. what : the mesh's name for messages.
    ValueError where its borders have too many.
    """
    before, lost = len(mesh.faces), ""
    few = simplification(mesh, MOST_FACES)
    if few.mesh is mesh:
        return few, ()
    if len(few.mesh.faces) > MOST_FACES:
        few = simplification(mesh, MOST_FACES, seams=False)
        lost = ", smooth everywhere" + ("" if mesh.uv is None else " and its texture from corner to corner")
    after = len(few.mesh.faces)
    if after > MOST_FACES:
        raise ValueError(
            f"{what}: its mesh has {before:,} faces, and a browser draws {MOST_FACES:,} with ease; its borders keep"
            f" {after:,}; simplify it in another program, and use it in place of this one"
        )
    return few, (f"The mesh of {before:,} faces is shown with {after:,}{lost}.",)


def with_few_faces(studio: Photographer) -> tuple[Photographer, tuple[str, ...]]:
    """A photographer of the subject as browsers draw it, and the sentence; ValueError as `few_faces` has it.

    Shadows are the whole mesh's; what parts of the object send each other is found anew for the faces that are left.
    """
    if not isinstance(studio.subject.body, MeshBody):
        return studio, ()
    subject, few, notes = _shown(studio.subject, str(studio.result.path))
    material, textures = studio.material, studio.material.textures
    if notes and textures is not None:
        if textures.at_vertices:
            textures = textures.at_points(few.corners, few.weights)
        elif few.mesh.uv is None:
            assert studio.subject.body.mesh.uv is not None
            textures = textures.onto_vertices(blended(studio.subject.body.mesh.uv, few.corners, few.weights))
        material = replace(material, textures=textures)
    return replace(studio, subject=subject, material=material), notes


@lru_cache(maxsize=1)
def _shown(subject: Subject, what: str) -> tuple[Subject, Simplification, tuple[str, ...]]:
    """The last subject's is kept: each of a result's lights asks for it."""
    assert isinstance(subject.body, MeshBody)
    few, notes = few_faces(subject.body.mesh, what)
    if not notes:
        return subject, few, notes
    body = MeshBody(few.mesh)
    shadows = subject.shadows
    if shadows is not None:
        shadows = Shadows(body, few.carried(shadows.shadow).astype(shadows.shadow.dtype))
    return replace(subject, body=body, shadows=shadows), few, notes
