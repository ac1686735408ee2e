"""Renders of meshes: their own shadows, textures, and the meshes that results are of."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose

from capture.files.documents import file_hash
from capture.files.imagefile import write_exr
from recon.mesh.trianglemesh import TriangleMesh, read_mesh, write_mesh
from synthetic.lights.arealight import AreaLight
from synthetic.lights.illumination import Illumination, latlong_map
from synthetic.lights.sources import DirectionalSource
from synthetic.materials.facets import BeckmannSlopes
from synthetic.materials.smith import SmithMaterial
from synthetic.render.photograph import photographs
from synthetic.scene import Scene, Shot
from synthetic.shapes.meshsurface import MeshSurface

from .renders import KD, KS, cameras, plates, read, tile, tile_result, within, write_result

Command = Callable[..., tuple[int, str, str]]
# Of a result whose photographs spoke against it, as of those that are integrated here.
NOTHING_BOUNCES = {"interreflection": {"taken_off": False}}


def test_a_cat_is_what_brute_force_integration_says(
    lightfactor: Command, bench: SimpleNamespace, cat_mesh: TriangleMesh, tmp_path: Path
) -> None:
    # Its edges are shorter than a pixel.
    write_mesh(tmp_path / "cat.ply", cat_mesh)
    write_result(tmp_path / "result", "half-angle microfacet", 1.5, 0.2, **NOTHING_BOUNCES)
    area = AreaLight(np.array([0.5, -0.4, 0.77]), np.array([0.8, 1.0, 1.3]), width_rad=0.5)
    write_exr(tmp_path / "room.exr", latlong_map([area], 64))
    source = DirectionalSource(bench.direction(110, 25), np.array([1.5, 1.4, 1.3]))
    lamp, room = ("--source", "110,25,1.5,1.4,1.3"), ("--light", tmp_path / "room.exr")
    mesh = ("--mesh", tmp_path / "cat.ply", "--view", "35,20,0.6", "--size", "80x60", "--fov", "15")
    surface = MeshSurface(read_mesh(tmp_path / "cat.ply"))
    material = SmithMaterial(KD, KS, 1.5, BeckmannSlopes(0.2, 0.2))
    for name, light, options in (
        ("lamp", Illumination("lamp", (), (source,)), lamp),
        ("both", Illumination("both", (area,), (source,)), lamp + room),
    ):
        turn = ("--turntable", 1, "-o", tmp_path / name)
        code, _, err = lightfactor("render", tmp_path / "result", *mesh, *options, *turn)
        assert (code, err) == (0, "")
        (camera,) = cameras(tmp_path / name)
        ((truth, coverage),) = photographs(Scene(name, surface, material, (Shot(camera, light),)))
        radiance, layers = read(tmp_path / name / "000.exr")
        assert_allclose(layers["A"], coverage, atol=0.12)  # parts of pixels, counted in 36 and in 16
        inside = within(layers["A"])
        apart = (radiance - truth)[inside]
        # Pixels that a shadow's or a part's edge runs through are coarse on either side, which makes 1.0%; the rest
        # are as on spheres. Were the sky's whole irradiance interpolated between vertices, it would be 1.5%.
        assert np.sqrt((apart**2).mean() / (truth[inside] ** 2).mean()) < 0.0125
        assert np.median(np.abs(apart)) < 0.003 * truth[inside].mean()
        if name == "lamp":
            # The shadows are where they should be: they fill a third of the cat.
            dark = (truth == 0).all(axis=2)[inside]
            assert 0.2 < dark.mean() < 0.5
            assert (dark != (radiance == 0).all(axis=2)[inside]).mean() < 0.02


def icosphere(path: Path, subdivisions: int = 4) -> None:
    """A sphere of radius 20 mm as a mesh with exact normals."""
    ball = trimesh.creation.icosphere(subdivisions, 1.0)
    normals = np.array(ball.vertices) / np.linalg.norm(ball.vertices, axis=1, keepdims=True)
    write_mesh(path, TriangleMesh(0.02 * normals, np.array(ball.faces), normals))


def test_a_mesh_of_a_sphere_looks_like_the_sphere(lightfactor: Command, tmp_path: Path) -> None:
    result = write_result(tmp_path / "result", "microfacet", 1.44, 0.1)
    room = latlong_map([AreaLight(np.array([0, 0.8, 0.6]), np.ones(3), width_rad=0.4)], 64)
    write_exr(tmp_path / "room.exr", room)
    icosphere(tmp_path / "ball.ply")
    common = ("render", result, "--light", tmp_path / "room.exr", "--source", "0,30,1")
    common = (*common, "--view", "60,20,0.6", "--size", "60x60", "--fov", "5")
    assert lightfactor(*common, "-o", tmp_path / "sphere.exr")[0] == 0
    assert lightfactor(*common, "--mesh", tmp_path / "ball.ply", "-o", tmp_path / "mesh.exr")[0] == 0
    (sphere, layers), (facets, other) = (read(tmp_path / f"{name}.exr") for name in ("sphere", "mesh"))
    # A facet is 2.5 degrees wide: its flatness moves outline and shadows by a twentieth of a pixel.
    inside = (layers["A"] == 1) & (other["A"] == 1)
    assert other["A"].sum() == pytest.approx(layers["A"].sum(), rel=2e-3)
    assert np.median(np.abs(sphere - facets)[inside]) < 0.002 * sphere.max()
    assert np.sqrt(((sphere - facets)[inside] ** 2).mean()) < 0.01 * sphere.max()


def test_a_mesh_shadows_itself(lightfactor: Command, tmp_path: Path) -> None:
    result = write_result(tmp_path / "result", **NOTHING_BOUNCES)
    plates(tmp_path / "plates.ply")
    code, out, _ = lightfactor(
        *("render", result, "--mesh", tmp_path / "plates.ply", "--source", "0,90,2", "--view", "20,30"),
        *("--size", "120x120", "--turntable", 1, "-o", tmp_path / "turn"),
    )
    assert code == 0
    assert "2 separate pieces" in out
    radiance, _ = read(tmp_path / "turn" / "000.exr")
    (camera,) = cameras(tmp_path / "turn")
    # Lit from straight above: Kd E where the sky is free, nothing below the plate.
    places = {(0.8, 0.8, 0.0): 1.0, (-0.8, 0.5, 0.0): 1.0, (0.0, 0.0, 0.6): 1.0, (0.1, 0.1, 0.0): 0.0}
    pixels = camera.project(np.array(list(places)))
    for (column, row), lit in zip(pixels, places.values(), strict=True):
        assert radiance[int(row), int(column)] == pytest.approx(lit * 2 * np.array(KD), rel=1e-5)
    # A result that nothing speaks against has light from the lit parts there, too.
    bounced = write_result(tmp_path / "bounced")
    code, _, _ = lightfactor(
        *("render", bounced, "--mesh", tmp_path / "plates.ply", "--source", "0,90,2", "--view", "20,30"),
        *("--size", "120x120", "-o", tmp_path / "bounced.exr"),
    )
    assert code == 0
    column, row = pixels[-1].astype(int)
    assert (read(tmp_path / "bounced.exr")[0][row, column] > 0).all()


def painted(folder: Path) -> None:
    """Textures of a result: Kd grows with u in red and with v in blue, known to a tenth of a level."""
    middles = (np.arange(8) + 0.5) / 8
    u, v = np.meshgrid(middles, middles[::-1])
    write_exr(folder / "texture_kd.exr", np.dstack([0.1 + 0.1 * u, 0 * u + 0.1, 0.1 + 0.1 * v]))
    write_exr(folder / "texture_kd_std.exr", np.full((1, 1, 3), 0.02, np.float32))


def test_textures_lie_where_their_coordinates_say(lightfactor: Command, tmp_path: Path) -> None:
    result = write_result(tmp_path / "result")
    painted(result)
    tile(tmp_path / "tile.obj")
    # From above, +Y is up in the picture.
    common = ("render", result, "--mesh", tmp_path / "tile.obj", "--view", "-90,90,3", "--fov", "20")
    code, _, err = lightfactor(*common, "--size", "60x60", "--std", "-o", tmp_path / "x.exr")
    assert (code, err) == (0, "")
    radiance, layers = read(tmp_path / "x.exr")
    side = 2 * 3 * np.tan(np.radians(10))  # of the picture, metres
    at = ((np.arange(60) + 0.5) / 60 - 0.5) * side + 0.5
    u, v = np.meshgrid(at, at[::-1])
    # Beyond the middles of the outermost texels nothing says how it goes on.
    inside = (np.minimum(u, v) > 0.1) & (np.maximum(u, v) < 0.9)
    expected = np.pi * np.dstack([0.1 + 0.1 * u, 0 * u + 0.1, 0.1 + 0.1 * v])
    # Single precision of files, and a sum over the sky's pixels.
    assert_allclose(radiance[inside], expected[inside], rtol=1e-3)
    assert_allclose(layers["std"][inside], np.pi * 0.02, rtol=1e-3)


def test_textures_without_coordinates_are_refused_or_averaged(lightfactor: Command, tmp_path: Path) -> None:
    result = write_result(tmp_path / "result")
    painted(result)
    tile(tmp_path / "tile.ply", with_uv=False)
    common = ("render", result, "--size", "20x20", "--view", "0,90,3", "-o", tmp_path / "x.exr")
    mesh = ("--mesh", tmp_path / "tile.ply")
    for options, words in (
        (mesh, "tile.ply: has no texture coordinates"),
        (("--radius", 1), "a sphere has none"),
    ):
        code, _, err = lightfactor(*common, *options)
        assert code == 1
        assert words in err
        assert "--mean" in err
    code, out, _ = lightfactor(*common, *mesh, "--mean")
    assert code == 0
    assert "the picture has their means" in out
    assert_allclose(read(tmp_path / "x.exr")[0][10, 10], np.pi * np.array(KD), rtol=1e-3)
    write_exr(result / "texture_kd.exr", np.full((2, 2, 3), -1, np.float32))
    code, _, err = lightfactor(*common, *mesh)
    assert code == 1
    assert "texture_kd.exr: is [-1.0, -1.0, -1.0] at row 0, column 0" in err
    # A map that is named and isn't there: neither one Ks in its place nor a deviation of zero.
    document = json.loads((result / "result.json").read_text())
    document["texture"] = {"kd": "texture_kd.exr", "kd_std": "texture_kd_std.exr", "ks": "texture_ks.exr"}
    (result / "result.json").write_text(json.dumps(document))
    code, _, err = lightfactor(*common, *mesh)
    assert code == 1
    assert "texture_ks.exr: is missing" in err


@pytest.fixture
def of_a_tile(tmp_path: Path) -> Path:
    """The result of a photo set of a tile, half a metre up, the set beside it."""
    return tile_result(tmp_path)


def test_a_result_of_a_mesh_is_rendered_with_it(
    lightfactor: Command, of_a_tile: Path, tmp_path: Path
) -> None:
    painted(of_a_tile)
    common = ("render", of_a_tile, "--view", "-90,90,3", "--fov", "20", "--size", "60x60")
    assert lightfactor(*common, "-o", tmp_path / "own.exr")[0] == 0
    tile(tmp_path / "tile.obj")
    place = {"mesh_to_world": json.loads((of_a_tile / "result.json").read_text())["object"]["mesh_to_world"]}
    (tmp_path / "place.json").write_text(json.dumps(place))
    given = ("--mesh", tmp_path / "tile.obj", "--mesh-to-world", tmp_path / "place.json")
    assert lightfactor(*common, *given, "-o", tmp_path / "given.exr")[0] == 0
    assert_allclose(read(tmp_path / "own.exr")[0], read(tmp_path / "given.exr")[0])


def test_a_mesh_that_is_missing_or_another_is_said(
    lightfactor: Command, of_a_tile: Path, tmp_path: Path
) -> None:
    folder = of_a_tile.parent / "set"
    common = ("render", of_a_tile, "--size", "20x20", "-o", tmp_path / "x.exr")
    tile(folder / "tile.obj", with_uv=False)
    code, _, err = lightfactor(*common)
    assert code == 1
    assert "tile.obj: is not the mesh that" in err
    (folder / "tile.obj").unlink()
    code, _, err = lightfactor(*common)
    assert code == 1
    assert "tile.obj" in err
    shutil.rmtree(folder)
    code, _, err = lightfactor(*common)
    assert code == 1
    assert "--set" in err
    assert "--mesh" in err
    # A ball of it can be had all the same.
    assert lightfactor(*common, "--radius", 0.1)[0] == 0


def test_what_of_a_texture_is_not_known_is_transparent(lightfactor: Command, tmp_path: Path) -> None:
    table = {"at": "texels", "known": 0.5, "mesh": None}
    result = write_result(tmp_path / "result", texture=table)
    known = np.ones((8, 8), np.float32)
    known[:, :4] = 0  # where u is below a half
    kd = np.full((8, 8, 3), 0.1, np.float32) * known[..., None]
    write_exr(result / "texture_kd.exr", kd, layers={"A": known})
    tile(tmp_path / "tile.obj")
    common = ("render", result, "--mesh", tmp_path / "tile.obj", "--view", "-90,90,3", "--fov", "15")
    code, out, _ = lightfactor(*common, "--size", "40x40", "-o", tmp_path / "x.exr")
    assert code == 0
    assert "open on 50% of the surface" in out
    radiance, layers = read(tmp_path / "x.exr")
    # Up to half a texel on, 0.0625 of 0.79 m, neighbours that are known say what is there.
    assert (layers["A"][:, :16] == 0).all()
    assert (layers["A"][:, 18:] == 1).all()
    assert_allclose(radiance[:, 18:], 0.1 * np.pi, rtol=1e-3)
    assert (radiance[:, :16] == 0).all()


def test_textures_at_vertices_and_on_coordinates_that_were_made(
    lightfactor: Command, of_a_tile: Path, tmp_path: Path
) -> None:
    tile(of_a_tile.parent / "set" / "tile.obj", with_uv=False)
    of_vertices = np.array([[[0.1, 0.1, 0.1], [0.2, 0.1, 0.1], [0.2, 0.1, 0.2], [0.1, 0.1, 0.2]]])
    common = (
        "render",
        of_a_tile,
        "--view",
        "-90,90,3",
        "--fov",
        "15",
        "--size",
        "40x40",
        "-o",
        tmp_path / "x.exr",
    )
    side = 2 * 3 * np.tan(np.radians(7.5))
    at = ((np.arange(40) + 0.5) / 40 - 0.5) * side + 0.5
    u, v = np.meshgrid(at, at[::-1])
    expected = np.pi * np.dstack([0.1 + 0.1 * u, 0 * u + 0.1, 0.1 + 0.1 * v])
    for table in ({"at": "vertices", "mesh": None}, {"at": "texels", "mesh": "textured.obj"}):
        document = json.loads((of_a_tile / "result.json").read_text())
        mesh = of_a_tile.parent / "set" / "tile.obj"
        document |= {"texture": table, "inputs": document["inputs"] | {"tile.obj": file_hash(mesh)}}
        (of_a_tile / "result.json").write_text(json.dumps(document))
        if table["mesh"]:
            painted(of_a_tile)
            tile(of_a_tile / table["mesh"])
        else:
            write_exr(of_a_tile / "texture_kd.exr", of_vertices.astype(np.float32))
        code, _, err = lightfactor(*common)
        assert (code, err) == (0, "")
        inside = (np.minimum(u, v) > 0.1) & (np.maximum(u, v) < 0.9)
        assert_allclose(read(tmp_path / "x.exr")[0][inside], expected[inside], rtol=1e-3)
    plates(of_a_tile / "textured.obj")
    code, _, err = lightfactor(*common)
    assert code == 1
    assert "textured.obj: is not the object's mesh" in err
