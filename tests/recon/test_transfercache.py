"""Transfer vectors kept beside a mesh: read again, and made anew where that file is not theirs."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
import trimesh

import recon.mesh.transfercache
from recon.mesh.transfercache import cached_transfer
from recon.mesh.trianglemesh import TriangleMesh, smooth_normals, write_mesh


@pytest.fixture
def mesh() -> TriangleMesh:
    """Two balls that shadow each other."""
    ball = trimesh.creation.icosphere(subdivisions=2)
    vertices = np.concatenate([ball.vertices, ball.vertices + np.array([0, 0, 2.2])])
    faces = np.concatenate([ball.faces, ball.faces + len(ball.vertices)])
    return TriangleMesh(vertices, faces, smooth_normals(vertices, faces))


@pytest.fixture
def place(tmp_path: Path, mesh: TriangleMesh) -> Path:
    write_mesh(tmp_path / "balls.ply", mesh)
    return tmp_path / "balls.ply"


@pytest.fixture
def computed(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Grows by one whenever transfer vectors are computed."""
    calls: list[int] = []
    compute = recon.mesh.transfercache.transfer_vectors
    monkeypatch.setattr(
        recon.mesh.transfercache, "transfer_vectors", lambda *settings: calls.append(1) or compute(*settings)
    )
    return calls


def test_what_was_kept_is_read_again(mesh: TriangleMesh, place: Path, computed: list[int]) -> None:
    first, warning = cached_transfer(mesh, place, 4)
    assert warning is None
    assert sorted(path.name for path in place.parent.iterdir()) == ["balls.ply", "balls.transfer.npz"]
    again, warning = cached_transfer(mesh, place, 4)
    assert warning is None
    assert len(computed) == 1
    np.testing.assert_array_equal(again.coefficients, first.coefficients)
    np.testing.assert_array_equal(again.std, first.std)


def test_another_mesh_or_setting_is_computed(mesh: TriangleMesh, place: Path, computed: list[int]) -> None:
    first, _ = cached_transfer(mesh, place, 4)
    moved = mesh.vertices.copy()
    moved[3] *= 1.001
    turned = mesh.normals.copy()
    turned[3] = turned[4]
    for other in (
        TriangleMesh(moved, mesh.faces, mesh.normals),
        TriangleMesh(mesh.vertices, mesh.faces[:-1], mesh.normals),
        TriangleMesh(mesh.vertices, mesh.faces, turned),
    ):
        cached_transfer(mesh, place, 4)
        before = len(computed)
        cached_transfer(other, place, 4)
        assert len(computed) == before + 1
    assert cached_transfer(mesh, place, 3)[0].coefficients.shape == (len(mesh.vertices), 16)
    cached_transfer(mesh, place, 4, 64)
    last, _ = cached_transfer(mesh, place, 4)
    assert len(computed) == 9  # the first, then each other with the first made anew in between
    np.testing.assert_array_equal(last.coefficients, first.coefficients)


def test_a_damaged_or_foreign_file_is_replaced(mesh: TriangleMesh, place: Path, computed: list[int]) -> None:
    first, _ = cached_transfer(mesh, place, 4)
    kept = place.with_name("balls.transfer.npz")
    good = kept.read_bytes()
    flipped = bytearray(good)
    flipped[len(good) // 2] ^= 1
    for bad in (b"", b"not an archive", good[: len(good) // 2], bytes(flipped), _npy(), _archive()):
        kept.write_bytes(bad)
        found, warning = cached_transfer(mesh, place, 4)
        assert warning is None
        np.testing.assert_array_equal(found.coefficients, first.coefficients)
        assert kept.read_bytes() == good
    assert len(computed) == 7


def test_where_nothing_can_be_kept_the_caller_is_told(mesh: TriangleMesh, place: Path) -> None:
    kept = place.with_name("balls.transfer.npz")
    kept.mkdir()
    found, warning = cached_transfer(mesh, place, 4)
    assert found.coefficients.shape == (len(mesh.vertices), 25)
    assert warning is not None
    assert "could not be kept" in warning
    assert str(kept) in warning


def _npy() -> bytes:
    """An array that isn't an archive."""
    return (
        b"\x93NUMPY\x01\x00v\x00{'descr': '<f8', 'fortran_order': False, 'shape': (1,), }".ljust(127)
        + b"\n"
        + bytes(8)
    )


def _archive() -> bytes:
    """An archive of something else."""
    stream = BytesIO()
    np.savez(stream, photographs=np.arange(3))
    return stream.getvalue()
