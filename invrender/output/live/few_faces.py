"""Meshes of many faces, made of as few as browsers draw with ease."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

from invrender.output.render.photographer import Photographer
from invrender.output.render.subject import Subject
from invrender.transport.visibility import Shadows
from recon.mesh.bodies import MeshBody
from recon.mesh.simplified import Simplification, simplification
from recon.mesh.trianglemesh import TriangleMesh

# Faces that a browser holds and traces with ease.
MOST_FACES = 200_000


def few_faces(mesh: TriangleMesh, what: str) -> tuple[Simplification, tuple[str, ...]]:
    """A mesh as browsers draw it, and a sentence where it has fewer faces than before.

    what : the mesh's name for messages. ValueError where its seams and sharp edges alone have too many faces.
    """
    few = simplification(mesh, MOST_FACES)
    before, after = len(mesh.faces), len(few.mesh.faces)
    if after > MOST_FACES:
        raise ValueError(
            f"{what}: its mesh has {before:,} faces, and a browser draws {MOST_FACES:,} with ease; its borders, its"
            f" sharp edges and the seams of its texture keep {after:,}; simplify it in another program, give it fewer"
            " seams there, and use it in place of this one"
        )
    if few.mesh is mesh:
        return few, ()
    return few, (f"The mesh of {before:,} faces is shown with {after:,}.",)


def with_few_faces(studio: Photographer) -> tuple[Photographer, tuple[str, ...]]:
    """A photographer of the subject as browsers draw it, and the sentence; ValueError as `few_faces` has it.

    Shadows are the whole mesh's; what parts of the object send each other is found anew for the faces that are left.
    """
    if not isinstance(studio.subject.body, MeshBody):
        return studio, ()
    subject, few, notes = _shown(studio.subject, str(studio.result.path))
    material = studio.material
    if notes and material.textures is not None and material.textures.at_vertices:
        textures = material.textures.at_points(few.corners, few.weights)
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
