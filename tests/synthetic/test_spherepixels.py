"""Photographs: what a pixel holds, how much of it is sphere, and the sensor's noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from capture.arc.gantry import look_at
from capture.camera import Camera
from synthetic.demo import demo_staging
from synthetic.lights.arealight import AreaLight
from synthetic.lights.illumination import Illumination
from synthetic.lights.sources import DirectionalSource, PointSource
from synthetic.materials.microfacet import MicrofacetMaterial
from synthetic.render.photograph import photographs
from synthetic.render.pixels import pixel_coverage
from synthetic.render.spherepixels import sphere_means
from synthetic.scene import Scene, Shot
from synthetic.sensing.noise import Noise
from synthetic.shapes.ball import Ball

POSE = look_at([0.6, 0, 0], [0, 0, 0], [0, 0, 1])
ORTHOGRAPHIC = Camera("ORTHOGRAPHIC", np.array([2000.0, 50.3, 49.8]), 100, 100, POSE)
BALL = Ball(np.zeros(3), 0.02)
UNIFORM = Illumination("uniform", (AreaLight(np.array([0, 0, 1.0]), np.ones(3), 1e6),))
MATTE = MicrofacetMaterial(np.full(3, 0.25), np.zeros(3), None, 0.1)


def matte_scene(light: Illumination = UNIFORM, camera: Camera = ORTHOGRAPHIC, ball: Ball = BALL) -> Scene:
    return Scene("matte", ball, MATTE, (Shot(camera, light),))


def photograph(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    (photo,) = photographs(scene)
    return photo


def test_coverage_adds_up_to_the_disks_area_and_centre() -> None:
    coverage = pixel_coverage(BALL, ORTHOGRAPHIC)
    # Each of some 320 rim pixels is counted in 256 points; their errors are independent.
    assert_allclose(coverage.sum(), np.pi * 40**2, rtol=2e-4)
    y, x = np.mgrid[:100, :100] + 0.5
    centroid = np.array([(coverage * x).sum(), (coverage * y).sum()]) / coverage.sum()
    assert_allclose(centroid, [50.3, 49.8], atol=0.005)


def test_pixels_on_the_rim_are_dimmed_by_their_black_part() -> None:
    radiance, coverage = photograph(matte_scene())
    # Uniform light on a matte sphere: pi kd wherever it is.
    whole = coverage == 1
    assert_allclose(radiance[whole], np.full((whole.sum(), 3), np.pi * 0.25), rtol=1e-9)
    assert (radiance[coverage == 0] == 0).all()
    # The rim's share is taken by 6x6 points here and by 16x16 in the coverage: each good to about 1/12.
    assert_allclose(radiance[..., 0], np.pi * 0.25 * coverage, atol=np.pi * 0.25 * 0.1)


def test_one_source_lights_the_side_that_faces_it() -> None:
    # The camera looks along -x with y to its right: light from +y falls on the right half.
    source = DirectionalSource(np.array([0, 1.0, 0]), np.ones(3))
    radiance, coverage = photograph(matte_scene(Illumination("source", (), (source,))))
    _, x = np.mgrid[:100, :100] + 0.5
    inner = (coverage == 1) & (np.abs(x - 50.3) > 1)
    # Orthographic: n_y = (x - 50.3) / 40, linear across each pixel, so means are exact up to the rim.
    expected = 0.25 * np.clip((x - 50.3) / 40, 0, None)
    assert_allclose(radiance[inner], np.repeat(expected[inner, None], 3, axis=1), atol=1e-12)


@pytest.mark.parametrize("index", [0, pytest.param(18, marks=pytest.mark.slow)])
def test_pixels_are_means_over_their_area(index: int, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = demo_staging().scene
    (shot,) = scene.shots[index : index + 1]
    # The right half, and a little more: the sphere's middle must be seen.
    left_out = 72
    params = shot.camera.params - [0, 0, left_out, 0, 0, 0, 0, 0]
    camera = replace(shot.camera, params=params, width=shot.camera.width - left_out)
    scene = replace(scene, shots=(replace(shot, camera=camera),))
    radiance, coverage = photograph(scene)
    for name in ("_FEWEST_SUBSAMPLES", "_MOST_SUBSAMPLES"):
        monkeypatch.setattr(f"synthetic.render.spherepixels.{name}", 9)
    dense, _ = photograph(scene)
    y, x = np.mgrid[: camera.height, : camera.width] + 0.5
    origins, directions = camera.rays(np.column_stack([x.ravel(), y.ravel()]))
    hit, normals = scene.surface.sphere.hits(origins, directions)
    cos_o = -(normals * directions).sum(axis=1)
    cos_o = np.where(hit, cos_o, 0).reshape(x.shape)
    usable = (cos_o > 0.25) & (coverage == 1)
    error = np.abs(radiance - dense) / (dense + 0.01 * dense[usable].mean())
    assert np.sqrt((error[usable] ** 2).mean()) < 1e-3  # a tenth of the sensor's noise
    assert error[usable].max() < 0.02  # where a grazing highlight ends at the source's horizon
    assert error[cos_o > 0.6].max() < 1e-5  # away from that horizon all is smooth


def test_many_photographs_share_tables_of_their_integrals_and_look_the_same() -> None:
    scene, (rows, columns) = demo_staging().scene, np.mgrid[60:120:6, 60:120:6].reshape(2, -1)
    shot, pixels = scene.shots[3], np.column_stack([columns, rows])
    given = scene.surface, scene.material, shot.illumination, shot.camera, pixels
    few, many = sphere_means(*given, cameras=1), sphere_means(*given, cameras=60)
    assert few is not None
    assert many is not None
    assert not np.array_equal(few, many)
    assert_allclose(many, few, atol=1e-6 * few.max())  # splines' error, far below a sensor's noise


def test_noise_has_the_deviation_that_it_is_told() -> None:
    truth, coverage = photograph(matte_scene())
    photo = Noise(relative=0.02, floor=0.005).applied(truth, coverage, np.random.default_rng(3))
    assert photo.dtype == np.float32
    whole, outside = coverage == 1, coverage == 0
    level = truth[coverage > 0].mean()
    residual = photo - truth
    expected = np.hypot(0.02 * np.pi * 0.25, 0.005 * level)
    for part, deviation in ((whole, expected), (outside, 0.005 * level)):
        count = residual[part].size
        # Five standard errors of a mean and of a deviation.
        assert abs(residual[part].mean()) < 5 * deviation / np.sqrt(count)
        assert_allclose(residual[part].std(), deviation, rtol=5 / np.sqrt(2 * count))


def test_impossible_scenes_are_refused() -> None:
    behind = Camera("PINHOLE", np.array([500.0, 500, 50, 50]), 100, 100, np.eye(4))
    with pytest.raises(ValueError, match="the object is behind camera 0"):
        matte_scene(camera=behind, ball=Ball(np.array([0, 0, -1.0]), 0.02))
    with pytest.raises(ValueError, match=r"camera 0 at \[0\.0, 0\.0, 0\.0\] m is inside the object"):
        matte_scene(camera=behind)
    with pytest.raises(ValueError, match="has no light"):
        Illumination("dark")
    with pytest.raises(ValueError, match=r"the lamp at \[0\.0, 0\.01, 0\.0\] m stands inside the object"):
        matte_scene(Illumination("lamp", (), (PointSource(np.array([0, 0.01, 0]), np.ones(3)),)))
    with pytest.raises(ValueError, match=r"noise is -0\.1 relative"):
        Noise(relative=-0.1)
