"""Finding the sphere of a whole photo set, with masks and without."""

from __future__ import annotations

import json
import os
import tracemalloc
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose

from capture.arc.gantry import Arc
from capture.camera import Camera
from capture.photoset import load_photoset
from recon.placement.findsphere import find_sphere, sphere_masks

CENTRE, RADIUS = (0.002, -0.001, 0.003), 0.03
ANGLES = np.radians([0, 25, 50, 75])


def rendered(sphere, camera: Camera, light, draw) -> tuple[np.ndarray, np.ndarray]:
    """A matte sphere on black, (h, w, 3) 16 bit, and its mask (h, w) 8 bit."""
    cover = draw(sphere, camera, 4)
    rays = camera.rays(np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), -1) + 0.5)
    hit, normals = sphere.hits(*rays)
    shade = np.where(hit, np.clip(normals @ light, 0, None), 0).reshape(cover.shape)
    # Pixels of which the centre lies outside are shaded as their neighbours are.
    shade = np.where(hit.reshape(cover.shape), shade, cv2.dilate(shade, np.ones((3, 3))))
    noise = np.random.default_rng(0).normal(0, 1e-3, cover.shape)
    image = np.clip(cover * shade * 0.9 + 0.005 + noise, 0, 0.95)
    return np.repeat((image * 65535)[..., None], 3, axis=2).astype(np.uint16), (cover * 255).astype(np.uint8)


@pytest.fixture
def photo_set(tmp_path, draw, ball):
    """`photo_set(masked, light)`: four photographs on an arc, those numbered in `masked` with masks."""

    def write(masked=(), light=(1.0, 0.6, 0.5)) -> Path:
        params = [700.0, 700, 100, 75]
        lines = [
            'format = 1\nname = "ball"',
            '[camera]\nmodel = "PINHOLE"',
            f"width = 200\nheight = 150\nparams = {params}",
            '[radiometry]\nencoding = "linear"',
            '[object]\nshape = "sphere"',
        ]
        for k, angle in enumerate(ANGLES):
            pose = Arc([0.0, 0, 0], [0, 0, 1], 0.5, [1, 0, 0]).pose(angle)
            camera = Camera("PINHOLE", params, 200, 150, pose)
            image, mask = rendered(
                ball(CENTRE, RADIUS), camera, np.array(light) / np.linalg.norm(light), draw
            )
            cv2.imwrite(str(tmp_path / f"{k}.png"), image)
            lines.append(f'[[photo]]\nfile = "{k}.png"\nworld_to_camera = {json.dumps(pose.tolist())}')
            if k in masked:
                cv2.imwrite(str(tmp_path / f"{k}_mask.png"), mask)
                lines.append(f'mask = "{k}_mask.png"')
        path = tmp_path / "photoset.toml"
        path.write_text("\n".join(lines) + "\n")
        return path

    return write


def errors_px(sphere) -> np.ndarray:
    return np.append(sphere.centre - CENTRE, sphere.radius - RADIUS) * 700 / 0.5


@pytest.mark.parametrize(
    ("masked", "tolerance"),
    # Masks of 8 bits and 4 x 4 points; the rims of photographs whose outermost pixels are shaded roughly.
    [((0, 1, 2, 3), 0.02), ((), 0.15), ((1, 2), 0.15)],
)
def test_the_sphere_of_a_set_is_found_with_masks_or_without(photo_set, masked, tolerance):
    photoset = load_photoset(photo_set(masked))
    sphere = find_sphere(photoset)
    assert np.abs(errors_px(sphere)).max() < tolerance
    assert len(sphere.residual_px) == 4
    # Without a mask of its own a photograph gets the sphere's; its pixels at the rim are then left out.
    for k, photo in enumerate(photoset.photos):
        mask = sphere_masks(photoset, sphere)(photo)
        assert mask is not None
        radius = sphere.pixel_radius(photo.camera)
        assert mask.sum() == pytest.approx(np.pi * radius**2, rel=0.01)
        assert set(np.unique(mask)) == {0, 1} or k in masked


def test_a_photograph_that_shows_too_little_leans_on_the_others(photo_set):
    # Light from beside the first camera: the last one, 75 degrees on, sees a quarter of the rim lit.
    photoset = load_photoset(photo_set((), light=(0.2, -1.0, 0.3)))
    sphere = find_sphere(photoset)
    assert np.abs(errors_px(sphere)).max() < 0.4
    assert 2 <= len(sphere.residual_px) <= 4


def test_a_given_sphere_needs_neither_and_no_mask_is_made_up(photo_set):
    path = photo_set(())
    text = path.read_text().replace(
        'shape = "sphere"', f'shape = "sphere"\ncentre = {list(CENTRE)}\nradius = {RADIUS}'
    )
    path.write_text(text)
    photoset = load_photoset(path)
    sphere = find_sphere(photoset)
    assert (tuple(sphere.centre), sphere.radius) == (CENTRE, RADIUS)
    assert sphere_masks(photoset, sphere)(photoset.photos[0]) is None


def test_photographs_that_show_no_sphere_are_named(photo_set):
    path = photo_set(())
    for k in range(4):
        cv2.imwrite(str(path.parent / f"{k}.png"), np.full((150, 200, 3), 300, np.uint16))
    with pytest.raises(
        ValueError, match=r"0\.png: no mask is given and no sphere was found in this photograph or"
    ):
        find_sphere(load_photoset(path))


def test_memory_does_not_grow_with_the_masks(tmp_path):
    """Twelve masks of 3 megapixels, 12 MB each as numbers."""
    mask = np.zeros((1500, 2000), np.uint8)
    cv2.circle(mask, (1000, 750), 400, 255, -1, cv2.LINE_AA)
    cv2.imwrite(str(tmp_path / "mask.png"), mask)
    lines = [
        'format = 1\nname = "disk"\n[camera]\nmodel = "ORTHOGRAPHIC"\nwidth = 2000\nheight = 1500\n[object]\n'
        'shape = "sphere"\n[radiometry]\nencoding = "linear"'
    ]
    for k in range(12):
        cv2.imwrite(str(tmp_path / f"{k}.png"), mask)
        lines.append(
            f'[[photo]]\nfile = "{k}.png"\nmask = "mask.png"'
            "\nworld_to_camera = [[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]]"
        )
    (tmp_path / "photoset.toml").write_text("\n".join(lines))
    photoset = load_photoset(tmp_path / "photoset.toml")
    tracemalloc.start()
    sphere = find_sphere(photoset)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert_allclose(sphere.pixel_radius(photoset.photos[0].camera), 400, atol=1.0, equal_nan=False)
    # One per core is at work, with a few temporary arrays as large; all of them would be 144 MB.
    assert peak < 12e6 * 4 * ((os.cpu_count() or 1) + 1)
