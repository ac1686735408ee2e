"""Photometric stereo, against spheres rendered by brute force and the true normals of real objects."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import trimesh

from capture.files.imagefile import read_pixels, write_exr
from capture.photoset import load_photoset
from capture.srgb import linear_to_srgb
from invrender.photometric_stereo.bounces import form_factors
from invrender.photometric_stereo.photographs import read_capture
from invrender.photometric_stereo.ptm import polynomial_texture, write_ptm
from invrender.photometric_stereo.result import (
    StereoResult,
    odd_photographs,
    photometric_stereo,
    solve_capture,
)
from invrender.photometric_stereo.shading import SharedReflection, linearised
from invrender.photometric_stereo.stack import PixelStack
from invrender.photometric_stereo.start import least_squares
from recon.harmonics.basis import sphere_directions
from recon.normals.normalmap import NormalMap, read_normal_map, write_normal_map
from tests.invrender.stereosets import (
    RADIUS,
    angles_to,
    as_normals,
    few_lobes_compared,
    few_pixels_shared,
    rendered_normals,
    thinned,
    write_real,
    write_rendered,
    write_small,
)

Lightfactor = Callable[..., tuple[int, str, str]]


def of_pixels(result: StereoResult, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Errors and error bars of a result's normals, degrees."""
    inside = result.capture.inside
    return angles_to(result.solved.surface.normals, truth[inside]), result.solved.deviations.normal_deg


@pytest.fixture
def few_lobes() -> Iterator[None]:
    """The test's fits compare few lobes."""
    with few_lobes_compared():
        yield


@pytest.fixture(scope="module")
def glossy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_rendered(tmp_path_factory.mktemp("stereo") / "glossy")


def test_least_squares_recovers_a_lambertian_surface_exactly() -> None:
    rng = np.random.default_rng(3)
    lamps = rng.normal(size=(1, 8, 3)) * 0.3 + np.array([0, 0, 1.0])
    lamps /= np.linalg.norm(lamps, axis=2, keepdims=True)
    normals = rng.normal(size=(50, 3)) * 0.1 + np.array([0, 0, 1.0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    kd = rng.uniform(0.05, 0.3, (50, 3))
    reflected = kd[:, None] * (normals @ lamps[0].T)[..., None]
    assert reflected.min() > 0
    usable = np.ones(reflected.shape[:2], bool)
    stack = PixelStack(
        reflected.astype(np.float32), np.zeros((50, 8), np.float32), usable, lamps, np.eye(3)[2:]
    )
    found = least_squares(stack)
    # Single precision of the photographs.
    assert angles_to(found.normals, normals).max() < 1e-3
    assert np.abs(found.kd / kd - 1).max() < 1e-5


def test_form_factors_inside_a_sphere_are_the_areas() -> None:
    # Within a sphere each patch receives of another what that has of the whole area (the integrating sphere).
    outward = sphere_directions(800)
    areas = np.full(len(outward), 4 * np.pi / len(outward))
    factors = form_factors(outward, -outward, areas)
    apart = np.linalg.norm(outward[:, None] - outward, axis=2) > 0.5
    # The patches' own size blurs the distances of near ones.
    assert np.abs(factors[apart] * len(outward) - 1).max() < 0.05
    assert np.abs(factors.sum(axis=1) - 1).max() < 0.1


def test_derivatives_are_those_of_the_prediction(glossy: Path) -> None:
    capture = read_capture(load_photoset(glossy))
    stack = capture.stack(capture.places(held_out=False), capture.plane()).at(slice(0, 40))
    surface = least_squares(stack)
    first = SharedReflection(None, 0.2, np.zeros(3), 0.02)
    about = linearised(first, surface, stack)
    step = np.array([2e-4, -3e-4, 1e-3, 0.0, 2e-3])
    moved = surface.moved(np.broadcast_to(step, (40, 5)), stack.views)
    change = first.predicted(moved, stack) - first.predicted(surface, stack)
    linear = about.turns @ step[:2] + about.base[..., None] * step[2:]
    # Of second order in the step, where no lamp crosses the horizon.
    lit = about.base > 0.05
    assert np.abs(change - linear)[lit].max() < 1e-6


def test_a_rendered_glossy_sphere_is_found_within_its_error_bars(glossy: Path) -> None:
    with few_pixels_shared():
        result = photometric_stereo(load_photoset(glossy))
    errors, bars = of_pixels(result, rendered_normals(glossy))
    least = angles_to(result.solved.least, rendered_normals(glossy)[result.capture.inside])
    # Pixels are 1.3 degrees wide in the middle; 1% of noise alone would be 0.2 degrees.
    assert errors.mean() < 0.5 < 2 < least.mean()
    assert (errors < 2 * bars).mean() > 0.95
    assert 0.5 < np.sqrt((errors**2).mean() / (bars**2).mean()) < 1.6
    # The renderer's own numbers: ks is 0.04, alpha 0.15.
    assert result.solved.reflection.form is not None
    assert result.solved.reflection.sigma == pytest.approx(0.15, rel=0.1)
    assert result.solved.reflection.ks == pytest.approx(np.full(3, 0.04), rel=0.15)


def test_given_normals_leave_the_lobe_and_kd_to_be_found(
    glossy: Path, tmp_path: Path, few_lobes: None
) -> None:
    truth = rendered_normals(glossy)
    write_normal_map(tmp_path, NormalMap(truth))
    folder = tmp_path / "given"
    folder.mkdir()
    for path in glossy.iterdir():
        if path.is_file():
            (folder / path.name).symlink_to(path)
    (folder / "photoset.toml").unlink()
    shutil.copy(glossy / "photoset.toml", folder)
    as_normals(folder, str(tmp_path / "normals.npz"))
    result = photometric_stereo(load_photoset(folder))
    assert np.array_equal(result.solved.surface.normals, result.capture.normals)
    assert result.normal_map.std_deg is None
    assert result.solved.reflection.sigma == pytest.approx(0.15, rel=0.05)
    inner = truth[result.capture.inside][:, 2] > 0.5
    assert result.solved.surface.kd[inner].mean(axis=0) == pytest.approx([0.2, 0.16, 0.12], rel=0.03)


@pytest.mark.slow
def test_near_lamps_are_taken_where_they_are(tmp_path: Path, few_lobes: None) -> None:
    folder = write_rendered(tmp_path / "near", distance=0.12, every=3)
    # The middle of what is seen of the sphere, which faces +x: lamps are near, so that its depth counts.
    as_normals(folder, centre=(2 / 3 * RADIUS, 0, 0))
    truth = rendered_normals(folder)
    result = photometric_stereo(load_photoset(folder))
    errors, bars = of_pixels(result, truth)
    assert errors.mean() < 1
    assert (errors < 2 * bars).mean() > 0.88
    # The same lamps, taken for distant: light from 9 degrees beside where it comes from at the outline.
    capture = result.capture
    far = [replace(lighting, closeness=None) for lighting in capture.lightings]
    distant = replace(capture, lightings=tuple(far))
    stack = distant.stack(distant.places(held_out=False), distant.plane())
    assert angles_to(least_squares(stack).normals, truth[capture.inside]).mean() > 3 * errors.mean()


@pytest.mark.parametrize(
    ("name", "every", "ours", "least"),
    # Somewhat above what all pixels and lamps give: 1.35 and 4.5 degrees; least squares gives 3.8 and 8.5.
    [("glossball", 2, 1.8, 3.5), pytest.param("normals_cat", 1, 5.0, 8.0, marks=pytest.mark.slow)],
)
def test_real_normals_are_found_where_least_squares_fails(
    data_dir: Path, tmp_path: Path, name: str, every: int, ours: float, least: float
) -> None:
    folder = write_real(data_dir / name, tmp_path / name, every)
    capture = thinned(read_capture(load_photoset(folder)), 2)
    truth = read_normal_map(data_dir / name / "normals.npz").normals[::2, ::2]
    with few_pixels_shared():
        result = solve_capture(capture)
    errors, bars = of_pixels(result, truth)
    assert errors.mean() < ours
    assert angles_to(result.solved.least, truth[capture.inside]).mean() > least
    assert (errors < 2 * bars).mean() > 0.88
    # The ball is convex; what bounces in the cat's creases is found as such.
    assert (result.solved.stack.bounced is not None) == (name == "normals_cat")


@pytest.fixture
def small(tmp_path: Path) -> Path:
    return write_small(tmp_path / "small")


def check_panel(file: Path, photoset: Path, result: Path) -> None:
    """A panel as trimesh reads it: its normal map is the result's, and photographs see its corners at their own."""
    (panel,) = trimesh.load(file).geometry.values()
    texture = np.asarray(panel.visual.material.normalTexture, float) / 255 * 2 - 1
    found = read_normal_map(result / "normals.npz")
    # Eight bits.
    assert np.abs(texture - found.normals)[found.inside].max() < 0.005
    camera = load_photoset(photoset).photos[0].camera
    # glTF's +Y is the world's +Z.
    world = np.asarray(panel.vertices) @ np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    seen = camera.project(world)
    uv = np.asarray(panel.visual.uv)
    assert (
        np.abs(seen - np.column_stack([uv[:, 0] * camera.width, (1 - uv[:, 1]) * camera.height])).max() < 1e-3
    )


def test_process_writes_maps_numbers_and_a_figure(
    small: Path, tmp_path: Path, lightfactor: Lightfactor
) -> None:
    status, said, error = lightfactor("process", small, "-o", tmp_path / "out")
    assert (status, error) == (0, "")
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names >= {"result.json", "normals.npz", "normals.exr", "normals.png", "albedo.exr", "stereo.png"}
    result = json.loads((tmp_path / "out/result.json").read_text())
    # With four lamps nothing but a Lambertian surface can be told.
    assert result["brdf"]["model"] == "lambertian"
    assert result["brdf"]["mu"]["value"] is None
    assert result["brdf"]["mu"]["remedy"]
    found = read_normal_map(tmp_path / "out/normals.npz")
    errors = angles_to(found.normals, rendered_normals(small))[found.inside]
    assert np.median(errors) < 1
    assert "Lambertian" in said
    assert lightfactor("export", tmp_path / "out", "--format", "gltf", "-o", tmp_path / "panel")[0] == 0
    check_panel(tmp_path / "panel/object.glb", small, tmp_path / "out")
    status, _, error = lightfactor("export", tmp_path / "out", "--format", "mitsuba", "-o", tmp_path / "m")
    assert status
    assert "make a panel of it; for mitsuba make a mesh with `lightfactor integrate`" in error
    assert lightfactor("export", tmp_path / "out", "--format", "openpbr", "-o", tmp_path / "x")[0] == 0
    document = ElementTree.parse(tmp_path / "x/material.mtlx").getroot()
    named = {node.get("name"): node for node in document.iter() if node.get("name")}
    assert named["geometry_normal"].get("nodename") == "normals"
    assert named["in"].get("nodename") == "normals_image"
    # Eight bits, made unit again.
    written = read_normal_map(tmp_path / "x/normals.png")
    found = read_normal_map(tmp_path / "out/normals.npz")
    assert np.abs(written.normals - found.normals)[found.inside].max() < 0.008
    for command in (
        ("render", tmp_path / "out", "-o", tmp_path / "x.exr"),
        ("compare", tmp_path / "out", small),
    ):
        status, _, error = lightfactor(*command)
        assert status
        assert "lightfactor integrate" in error


@pytest.mark.sweep
def test_error_bars_hold_what_lamps_directions_are_off(glossy: Path) -> None:
    capture = thinned(read_capture(load_photoset(glossy)), 2)
    lamps = np.stack([lighting.directions[0] for lighting in capture.lightings])
    rng = np.random.default_rng(5)
    turned = lamps + np.radians(1) * rng.normal(size=lamps.shape)
    lightings = tuple(
        replace(lighting, directions=direction[None])
        for lighting, direction in zip(capture.lightings, turned, strict=True)
    )
    photoset = replace(capture.photoset, direction_std_deg=1.0)
    result = solve_capture(replace(capture, lightings=lightings, photoset=photoset))
    errors, bars = of_pixels(result, rendered_normals(glossy)[::2, ::2])
    # Without the lamps' share of the bars it is 85%.
    assert (errors < 2 * bars).mean() > 0.9
    assert np.sqrt((errors**2).mean() / (bars**2).mean()) > 0.4


def test_photographs_under_swapped_lamps_are_named_and_left_out(glossy: Path, few_lobes: None) -> None:
    capture = thinned(read_capture(load_photoset(glossy)), 2)
    lightings = list(capture.lightings)
    lightings[2], lightings[15] = lightings[15], lightings[2]
    result = solve_capture(replace(capture, lightings=tuple(lightings)))
    photos = capture.photoset.photos
    errors = [result.predicted(place)[1] for place in range(len(photos))]
    said = odd_photographs(photos, errors)
    assert [sentence.split()[0] for sentence in said] == [photos[2].label, photos[15].label]
    # As without the two.
    assert of_pixels(result, rendered_normals(glossy)[::2, ::2])[0].mean() < 0.5


def read_ptm(path: Path, lamp: np.ndarray) -> np.ndarray:
    """The picture (h, w, 3), 0 to 255, that a viewer shows of a .ptm, by the format's description."""
    data = path.read_bytes()
    lines = data.split(b"\n", 6)
    assert lines[:2] == [b"PTM_1.2", b"PTM_FORMAT_LRGB"]
    width, height = int(lines[2]), int(lines[3])
    scales, biases = (np.array(line.split(), float) for line in lines[4:6])
    body = np.frombuffer(lines[6], np.uint8).astype(float)
    assert len(body) == 9 * width * height
    a = (body[: 6 * width * height].reshape(height, width, 6) - biases) * scales
    colour = body[6 * width * height :].reshape(height, width, 3)
    u, v = lamp[:2]
    level = (
        a[..., 0] * u * u + a[..., 1] * v * v + a[..., 2] * u * v + a[..., 3] * u + a[..., 4] * v + a[..., 5]
    )
    # The last row comes first.
    return np.clip(level[..., None] * colour / 255, 0, 255)[::-1]


def test_a_polynomial_texture_map_shows_the_photographs(glossy: Path, tmp_path: Path) -> None:
    capture = read_capture(load_photoset(glossy))
    stack = capture.stack(capture.places(held_out=False), capture.plane())
    found = polynomial_texture(stack)
    write_ptm(tmp_path / "relight.ptm", found, capture.inside)
    white = np.quantile(stack.reflected, 0.995)
    for photo in (0, 10, 20):
        lamp = stack.lamps[0, photo]
        shown = read_ptm(tmp_path / "relight.ptm", lamp)[capture.inside]
        truth = 255 * linear_to_srgb(np.clip(stack.reflected[:, photo] / white, 0, 1).astype(float))
        # A polynomial of second degree follows shading to a tenth; highlights and the terminator are beyond it.
        assert np.median(np.abs(shown - truth)) < 12
        # Coefficients are bytes: six roundings of half a step each.
        assert np.abs(shown - found.shown(lamp)).max() < 20
    assert (read_ptm(tmp_path / "relight.ptm", stack.lamps[0, 0])[~capture.inside] == 0).all()
    with pytest.raises(ValueError, match="takes 6 photographs; there are 4"):
        polynomial_texture(stack.of_photos(np.arange(4)))


@pytest.mark.sweep
def test_black_pixels_may_face_anywhere(glossy: Path) -> None:
    capture = thinned(read_capture(load_photoset(glossy)), 2)
    radiance = capture.radiance.copy()
    radiance[100:110] = 0
    result = solve_capture(replace(capture, radiance=radiance))
    bars = result.solved.deviations.normal_deg
    # Kd of nothing is as small as noise lets it be; the others' bars are below a degree.
    assert (bars[100:110] > 15).all()
    assert np.median(bars) < 1
    assert np.isfinite(result.normal_map.normals[capture.inside]).all()


def test_saturated_pixels_have_no_normal_and_are_counted(small: Path) -> None:
    capture = read_capture(load_photoset(small))
    assert not any("saturated" in warning for warning in capture.warnings)
    # With four photographs, two that are cut off at a pixel leave too few.
    for name in ("000.exr", "001.exr"):
        pixels = read_pixels(small / name).astype(np.float32)
        write_exr(small / name, np.minimum(pixels, np.quantile(pixels[capture.inside], 0.6)))
    again = read_capture(load_photoset(small))
    lost = int(capture.inside.sum() - again.inside.sum())
    assert lost > 20
    assert any(warning.startswith(f"{lost} of {capture.inside.sum()} pixels") for warning in again.warnings)
    assert (again.usable.sum(axis=1) >= 3).all()
