"""Transfer vectors kept beside the mesh's file, so that they are computed once."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np

from capture.files.outfolder import result_files
from recon.mesh.transfer import TransferVectors, transfer_vectors
from recon.mesh.trianglemesh import TriangleMesh

# Counts up whenever `transfer_vectors` would give other numbers for the same mesh.
_METHOD = 1
# What every command asks for by default, so that each finds what another has kept. Light that is unknown is
# sought up to this degree; what the mesh hides of it must be known as far, and so well that it doesn't bend the light.
USUAL_DEGREE, USUAL_RAYS = 12, 512


def cached_transfer(
    mesh: TriangleMesh, mesh_file: Path, l_max: int = USUAL_DEGREE, rays: int = USUAL_RAYS
) -> tuple[TransferVectors, str | None]:
    """Transfer vectors read from cat.transfer.npz beside cat.ply, or computed and written there.

    mesh : in its file's own axes, whatever its unit. Where it stands in the world changes with every alignment, the
        shadows on it don't: give the result the mesh's place by `rotated(mesh_to_world[:3, :3])`.
    A file that is damaged, or was made of another mesh or with other settings, is replaced. Also returns a warning
    if the result could not be written. Raises ValueError as `transfer_vectors` does.
    """
    path = mesh_file.with_name(f"{mesh_file.stem}.transfer.npz")
    key = _key(mesh, l_max, rays)
    known = _read(path, key)
    if known is not None:
        return known, None
    vectors = transfer_vectors(mesh, l_max, rays)
    try:
        with result_files(path, inputs=[mesh_file]) as folder:
            np.savez(folder / path.name, key=key, coefficients=vectors.coefficients, std=vectors.std)
    except (OSError, ValueError) as error:
        return vectors, f"the mesh's transfer vectors could not be kept, so each run computes them: {error}"
    return vectors, None


def _key(mesh: TriangleMesh, l_max: int, rays: int) -> str:
    digest = hashlib.sha256(f"{_METHOD} {l_max} {rays}".encode())
    for array in (mesh.vertices, mesh.faces, mesh.normals):
        digest.update(f"{array.shape} {array.dtype}".encode())
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()


def _read(path: Path, key: str) -> TransferVectors | None:
    """What the file holds for the key; None if it is missing, for another one, or no such file at all."""
    try:
        # numpy leaves a damaged file open that it opened itself.
        with path.open("rb") as stream, np.load(stream) as file:
            if str(file["key"]) != key:
                return None
            return TransferVectors(file["coefficients"], file["std"])
    except Exception:  # numpy's and zipfile's readers raise whatever a damaged file leads them into
        return None
