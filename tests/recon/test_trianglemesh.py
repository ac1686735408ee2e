"""Triangle meshes: what is refused, whether they are closed, smooth normals, and files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from recon.mesh.trianglemesh import TriangleMesh, is_watertight, read_mesh, smooth_normals, volume, write_mesh

# A cube of side 1 whose sides' diagonals lie this way and that.
_CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
_SIDES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
_FACES = np.array([face for a, b, c, d in _SIDES for face in ((a, b, c), (a, c, d))])


def _cube(
    faces: np.ndarray = _FACES, vertices: np.ndarray = _CORNERS, uv: np.ndarray | None = None
) -> TriangleMesh:
    outward = np.sign(vertices - vertices.mean(axis=0)) / np.sqrt(3)
    return TriangleMesh(vertices, faces, outward, uv)


def _seamed() -> TriangleMesh:
    """The cube, each corner of each face with a vertex and texture coordinates of its own."""
    faces = np.arange(_FACES.size).reshape(-1, 3)
    return _cube(faces, _CORNERS[_FACES.ravel()], np.random.default_rng(1).uniform(size=(_FACES.size, 2)))


def test_smooth_normals_do_not_depend_on_the_diagonals() -> None:
    # Three sides meet at right angles: weighted by area, a side cut in two at the corner would count double.
    expected = (_CORNERS - 0.5) * 2 / np.sqrt(3)
    np.testing.assert_allclose(smooth_normals(_CORNERS, _FACES), expected, atol=1e-15)  # rounding


def test_volume_is_the_same_far_from_the_origin() -> None:
    assert volume(_cube(vertices=_CORNERS * 0.1 + 1000)) == pytest.approx(
        1e-3, rel=1e-9
    )  # 1000's last bit: 1e-13
    assert volume(_cube(_FACES[:, ::-1])) == pytest.approx(-1, rel=1e-15)


def test_watertight_means_every_edge_once_each_way() -> None:
    turned = _FACES.copy()
    turned[3] = turned[3, ::-1]
    assert is_watertight(_cube())
    assert is_watertight(_seamed())
    assert not is_watertight(_cube(_FACES[1:]))
    assert not is_watertight(_cube(turned))
    assert not is_watertight(_cube(np.concatenate([_FACES, _FACES])))
    assert not is_watertight(_cube(np.concatenate([_FACES, [[0, 1, 0]]])))
    assert not is_watertight(TriangleMesh(np.zeros((3, 3)), np.array([[0, 1, 2]]), np.eye(3)))


def test_seams_whose_sides_differ_in_the_last_digits_are_closed() -> None:
    seamed = _seamed()
    # What single precision leaves, at each corner of each face for itself.
    rounding = 6e-8 * np.random.default_rng(2).uniform(-1, 1, seamed.vertices.shape)
    for size, place in ((1.0, 0.0), (1e-3, 0.0), (1.0, 100.0)):
        moved = size * (seamed.vertices + rounding) + place
        assert is_watertight(_cube(seamed.faces, moved))
        expected = (seamed.vertices - 0.5) * 2 / np.sqrt(3)
        np.testing.assert_allclose(smooth_normals(moved, seamed.faces), expected, atol=1e-6)
    # A hundred-thousandth of the size is a gap.
    assert not is_watertight(_cube(seamed.faces, seamed.vertices + 200 * rounding))


def test_faces_held_twice_turned_over_are_told() -> None:
    with pytest.raises(ValueError, match=r"vertex \d+ has no normal: .* turned over; remove what is double"):
        smooth_normals(_CORNERS, np.concatenate([_FACES, _FACES[:, ::-1]]))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"faces": np.zeros((0, 3), int)}, "no faces"),
        ({"faces": _FACES + 1}, "names vertex 8, but the mesh has vertices 0 to 7"),
        ({"faces": _FACES - 1}, "names vertex -1"),
        ({"faces": _FACES.astype(float)}, r"\(12, 3\) float64; they must be \(f, 3\) integers"),
        ({"vertices": np.where(_CORNERS == 1, np.nan, _CORNERS)}, r"vertices\[1\] is"),
        ({"normals": np.ones((8, 3))}, "has length 1.73205081; normals must be unit"),
        ({"normals": np.ones((7, 3))}, r"normals are \(7, 3\); 8 vertices need \(8, 3\)"),
        ({"uv": np.full((8, 2), np.inf)}, r"uv\[0\] is"),
    ],
)
def test_a_malformed_mesh_is_refused(change: dict[str, np.ndarray], message: str) -> None:
    parts = {"vertices": _CORNERS, "faces": _FACES, "normals": (_CORNERS - 0.5) * 2 / np.sqrt(3)}
    with pytest.raises(ValueError, match=message):
        TriangleMesh(**(parts | change))


def test_a_mesh_cannot_be_changed_from_outside() -> None:
    vertices = _CORNERS.copy()
    mesh = _cube(vertices=vertices)
    vertices[0] = 7
    assert mesh.vertices[0, 0] == 0
    with pytest.raises(ValueError, match="read-only"):
        mesh.faces[0] = 1


@pytest.mark.parametrize("name", ["a.ply", "a.obj", "seam.obj"])
def test_files_keep_the_mesh(tmp_path: Path, name: str) -> None:
    mesh = _seamed() if name == "seam.obj" else _cube()
    # Normals that are nobody's average, to see that they are the file's.
    bent = mesh.normals + 0.1 * np.random.default_rng(2).standard_normal(mesh.normals.shape)
    bent /= np.linalg.norm(bent, axis=1, keepdims=True)
    mesh = TriangleMesh(mesh.vertices * 0.07, mesh.faces, bent, mesh.uv)
    write_mesh(tmp_path / name, mesh)
    read = read_mesh(tmp_path / name)
    # Readers may number the vertices anew; the corners of the faces are what they were.
    for before, after in ((mesh.vertices, read.vertices), (mesh.normals, read.normals), (mesh.uv, read.uv)):
        if before is None or after is None:
            assert before is after
        else:
            np.testing.assert_allclose(after[read.faces], before[mesh.faces], atol=2e-9)  # nine digits
    write_mesh(tmp_path / f"again-{name}", mesh)
    assert (tmp_path / f"again-{name}").read_bytes() == (tmp_path / name).read_bytes()


def test_stl_gets_smooth_normals_and_glb_its_parts_in_place(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(3, radius=0.05)
    ball.export(tmp_path / "ball.stl")
    read = read_mesh(tmp_path / "ball.stl")
    assert is_watertight(read)
    # An icosphere's faces differ in size by 1.3, so that angle weights are good to a fraction of an edge.
    np.testing.assert_allclose(read.normals, read.vertices / 0.05, atol=0.01)
    scene = trimesh.Scene()
    stretch = np.diag([1.0, 1.0, 2.0, 1.0])
    for place in (0, 3):
        stretch[0, 3] = place
        scene.add_geometry(trimesh.creation.icosphere(2), transform=stretch)
    # Its normals are written along, and must stay perpendicular to a surface that is stretched.
    for part in scene.geometry.values():
        assert len(part.vertex_normals)
    scene.export(tmp_path / "two.glb", include_normals=True)
    two = read_mesh(tmp_path / "two.glb")
    expected = (two.vertices - [3, 0, 0] * (two.vertices[:, :1] > 1.5)) / [1, 1, 4]
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    assert two.vertices.max(axis=0) == pytest.approx([4, 1, 2], abs=1e-6)  # single precision
    assert (two.normals * expected).sum(axis=1).min() > 0.999  # an icosphere's normals are 2 degrees off


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("cloud.obj", "v 0 0 0\nv 1 0 0\n", "cloud.obj: .*no faces"),
        ("nan.obj", "v 0 0 0\nv 1 nan 0\nv 0 1 0\nf 1 2 3\n", r"nan.obj: vertices\[1\] is \[ *1. *nan *0.\]"),
        ("text.ply", "hello", "text.ply: cannot be read as a mesh"),
        ("mesh.xyzq", "hello", "mesh.xyzq: cannot be read as a mesh"),
    ],
)
def test_a_file_without_a_mesh_is_refused(tmp_path: Path, name: str, text: str, message: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(ValueError, match=message):
        read_mesh(tmp_path / name)


def test_wrong_ways_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"gone.ply: there is no such file"):
        read_mesh(tmp_path / "gone.ply")
    with pytest.raises(ValueError, match=r"\.ply: PLY holds no texture coordinates here"):
        write_mesh(tmp_path / "a.ply", _seamed())
    with pytest.raises(ValueError, match=r"not as '\.stl'"):
        write_mesh(tmp_path / "a.stl", _cube())
    write_mesh(tmp_path / "against.ply", _cube(_FACES[:, ::-1]))
    with pytest.raises(ValueError, match=r"against.ply: the normals point against the faces"):
        read_mesh(tmp_path / "against.ply")
    trimesh.Trimesh(_CORNERS, _FACES[:, ::-1], process=False).export(tmp_path / "inside.stl")
    with pytest.raises(ValueError, match=r"inside.stl: the mesh is inside out \(its volume is -1\)"):
        read_mesh(tmp_path / "inside.stl")
