from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose

from capture.arc.gantry import look_at
from capture.camera import ORTHOGRAPHIC, Camera
from capture.decode import decode, read_mask
from capture.radiance import RadianceImage
from recon.sphere.finddisk import SphereRim, find_rim, rim_near
from recon.sphere.fit import fit_sphere
from recon.sphere.outline import mask_silhouette
from recon.sphere.sphere import Sphere

WIDTH, HEIGHT = 240, 180
FLAT = Camera(ORTHOGRAPHIC, [1.0, 0, 0], WIDTH, HEIGHT, np.eye(4))
FRONT, SIDE, ABOVE = (0.0, 0.0, -1.0), (0.9, 0.3, -0.3), (-0.4, -0.6, -0.7)


def picture(radiance: np.ndarray, saturated: np.ndarray | None = None) -> RadianceImage:
    pixels = np.ascontiguousarray(
        np.broadcast_to(np.atleast_3d(radiance), (*radiance.shape[:2], 3)), np.float32
    )
    return RadianceImage(
        pixels, np.zeros_like(pixels), np.zeros(pixels.shape[:2], bool) if saturated is None else saturated
    )


def backdrop(rng: np.random.Generator, blur: float, size: tuple[int, int] = (HEIGHT, WIDTH)) -> np.ndarray:
    """A random pattern (h, w) in 0 to 1, smooth over `blur` pixels."""
    pattern = cv2.GaussianBlur(rng.random(size), (0, 0), blur)
    return (pattern - pattern.min()) / np.ptp(pattern)


def seen_from(sphere: Sphere, camera: Camera, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Whether the rays through points (n, 2) meet the sphere, and its normals there (n, 3)."""
    origins, directions = camera.rays(points)
    offset = origins - sphere.centre
    half = (offset * directions).sum(axis=1)
    root = half**2 - (offset**2).sum(axis=1) + sphere.radius**2
    normals = (offset + (-half - np.sqrt(np.maximum(root, 0)))[:, None] * directions) / sphere.radius
    return root > 0, normals


def shaded(
    sphere: Sphere, camera: Camera, light, ambient, behind, n: int = 5, blur: float = 0.0
) -> np.ndarray:
    """A matte sphere (albedo 1) before a backdrop: means over n x n points of each pixel; radiance (h, w)."""
    y, x = np.mgrid[: camera.height, : camera.width] + 0.5
    rows, columns = np.nonzero(
        seen_from(sphere, camera, np.column_stack([x.ravel(), y.ravel()]))[0].reshape(x.shape)
    )
    # No pixel further out than two from those whose middle shows the sphere has any part of it.
    top, left = np.maximum([rows.min() - 2, columns.min() - 2], 0)
    bottom, right = np.minimum([rows.max() + 3, columns.max() + 3], x.shape)
    steps = (np.arange(n) + 0.5) / n
    x, y = ((np.arange(*ends)[:, None] + steps).ravel() for ends in ((left, right), (top, bottom)))
    inside, normals = seen_from(sphere, camera, np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2))
    shade = ambient + np.clip(normals @ (np.array(light) / np.linalg.norm(light)), 0, None)
    lit, cover = np.zeros((2, camera.height, camera.width))
    for whole, part in ((lit, np.where(inside, shade, 0.0)), (cover, inside)):
        whole[top:bottom, left:right] = part.reshape(bottom - top, n, right - left, n).mean(axis=(1, 3))
    radiance = lit + (1 - cover) * behind
    return cv2.GaussianBlur(radiance, (0, 0), blur) if blur else radiance


def error_px(rim: SphereRim, truth: Sphere) -> np.ndarray:
    """Of centre and radius, in an orthographic camera of one pixel per metre."""
    return np.append((rim.sphere.centre - truth.centre)[:2], rim.sphere.radius - truth.radius)


def noisy(rng: np.random.Generator, radiance: np.ndarray) -> np.ndarray:
    return radiance + rng.normal(0, 1, radiance.shape) * (0.003 + 0.01 * radiance)


SCENES = {
    "bright on black": (ABOVE, 0.3, lambda rng: 0.0, 0.02),
    "lit from the front, so black at its rim": (FRONT, 0.0, lambda rng: 0.0, 0.06),
    "lit from one side": (SIDE, 0.0, lambda rng: 0.0, 0.1),
    "dark on bright": (ABOVE, 0.05, lambda rng: 3.0, 0.05),
    "before a pattern": (ABOVE, 0.2, lambda rng: 1.5 + 1.5 * backdrop(rng, 4), 0.1),
}


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("blur", [0.0, pytest.param(1.0, marks=pytest.mark.slow)])
def test_a_sphere_is_found_where_it_is(ball, scene, blur):
    light, ambient, behind, tolerance = SCENES[scene]
    rng = np.random.default_rng(1)
    for _ in range(2):
        truth = ball([*(np.array([125, 85]) + rng.uniform(-3, 3, 2)), 200], rng.uniform(45, 60))
        image = noisy(rng, shaded(truth, FLAT, light, ambient, behind(rng), blur=blur))
        rim = find_rim(FLAT, picture(image))
        assert rim is not None
        # Noise of 1%; a blur of 1 px moves the edge of a disc by 1 / (2 R) = 0.01 px, and smears shading.
        assert np.abs(error_px(rim, truth)).max() < tolerance * (1 + blur)
        # 0.1 px is what a photograph's own scatter hides.
        assert (np.abs(error_px(rim, truth)) < 3 * np.sqrt(np.diag(rim.sphere.covariance))[[0, 1, 3]]).all()


def test_it_is_found_under_perspective_with_distortion_and_in_large_photographs(ball):
    pose = look_at((0.5, -0.2, 0.3), (0.03, 0.02, 0.0), (0, 0, 1))
    truth = ball([0, 0, 0], 0.06)
    for width, blur in ((320, 0.0), (1000, 2.5)):  # a large one is never sharp to the pixel
        scale = width / 320
        params = [350 * scale, 350 * scale, 160 * scale, 120 * scale, -0.2, 0.05, 1e-3, -1e-3]
        camera = Camera("OPENCV", params, width, int(240 * scale), pose)
        image = shaded(truth, camera, (1, -1, 1), 0.1, 0.0, n=5 if width < 1000 else 2, blur=blur)
        rim = find_rim(camera, picture(noisy(np.random.default_rng(2), image)))
        assert rim is not None
        distance, found = (np.linalg.norm(each.centre - camera.centre) for each in (truth, rim.sphere))
        # In hundredths of a pixel: its direction, and its angular radius of about 42 px (131).
        assert_allclose(
            camera.project(rim.sphere.centre), camera.project(truth.centre), atol=0.1, equal_nan=False
        )
        assert rim.sphere.radius / found == pytest.approx(0.06 / distance, abs=0.1 / (350 * scale))


def test_a_round_highlight_and_a_smaller_ball_are_passed_over(ball):
    truth = ball([130.3, 88.8, 200], 55)
    image = shaded(truth, FLAT, SIDE, 0.02, 0.0)
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    image += 2.0 * (np.hypot(x - 150, y - 100) < 15)
    image += 3.0 * (np.hypot(x - 30, y - 40) < 18)
    rim = find_rim(FLAT, picture(image))
    assert rim is not None
    assert np.abs(error_px(rim, truth)).max() < 0.15


def test_what_is_saturated_is_no_edge(ball):
    truth = ball([125.2, 90.4, 200], 50)
    image = shaded(truth, FLAT, ABOVE, 0.3, 0.0)
    clipped = image > 0.9  # a third of the disk, to its rim
    rim = find_rim(FLAT, picture(np.minimum(image, 0.9), clipped))
    assert rim is not None
    assert np.abs(error_px(rim, truth)).max() < 0.1
    row, column = (rim.points.astype(int)).T[::-1]
    assert not clipped[row, column].any()


def test_near_a_known_place_a_short_arc_will_do(ball):
    truth = ball([125.2, 90.4, 200], 50)
    turn = np.arctan2(*(np.mgrid[:HEIGHT, :WIDTH] + 0.5 - np.array([90.4, 125.2])[:, None, None]))
    image = shaded(truth, FLAT, FRONT, 0.3, 0.0) * (np.abs(turn) < 0.6)  # a fifth of it, in a sector of light
    assert find_rim(FLAT, picture(image)) is None
    rim = rim_near(ball([126.0, 89.6, 200], 50.8), FLAT, picture(image))
    assert rim is not None
    away = np.hypot(*(rim.points - [125.2, 90.4]).T) - 50
    assert np.median(np.abs(away)) < 0.05
    assert rim_near(truth, FLAT, picture(np.zeros((HEIGHT, WIDTH)))) is None
    # A sphere around the camera or behind it shows nowhere.
    camera = Camera("PINHOLE", [300.0, 300, 120, 90], WIDTH, HEIGHT, np.eye(4))
    for centre in ([0, 0, 0.1], [0, 0, -2.0]):
        assert rim_near(ball(centre, 0.5), camera, picture(image)) is None


def shape(name: str) -> np.ndarray:
    rng = np.random.default_rng(5)
    canvas = np.zeros((HEIGHT, WIDTH), np.uint8)
    turn = np.arange(8) * np.pi / 4
    octagon = np.column_stack([120 + 70 * np.cos(turn), 90 + 70 * np.sin(turn)])
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    shapes = {
        "black": lambda: canvas,
        "white": lambda: canvas + 255,
        "noise": lambda: 255 * rng.random(canvas.shape),
        "fine pattern": lambda: 255 * backdrop(rng, 3),
        "patches": lambda: 255.0 * (backdrop(rng, 15) > 0.5),
        "square": lambda: cv2.rectangle(canvas, (70, 40), (170, 140), 255, -1),
        "box": lambda: cv2.rectangle(canvas, (60, 50), (180, 110), 255, -1),
        "ellipse": lambda: cv2.ellipse(canvas, (120, 90), (60, 52), 20, 0, 360, 255, -1, cv2.LINE_AA),
        "octagon": lambda: cv2.fillPoly(canvas, [octagon.astype(int)], 255, cv2.LINE_AA),
        "glow": lambda: 255 * np.exp(-((x - 120) ** 2 + (y - 90) ** 2) / 2 / 40**2),
        "small ball": lambda: cv2.circle(canvas, (120, 90), 4, 255, -1, cv2.LINE_AA),
    }
    return shapes[name]() / 255 + rng.normal(0, 0.003, canvas.shape)


@pytest.mark.parametrize(
    "name",
    [
        "black",
        "white",
        "noise",
        "fine pattern",
        "patches",
        "square",
        "box",
        "ellipse",
        "octagon",
        "glow",
        "small ball",
    ],
)
def test_what_is_no_sphere_is_not_taken_for_one(name):
    assert find_rim(FLAT, picture(shape(name))) is None


def test_photographs_without_a_sphere_show_none(data_dir):
    for file in (
        "temple/templeSR0007.png",
        "chessboard/left03.jpg",
        "memorial/memorial0068.png",
    ):
        image = decode(data_dir / file, "srgb")
        height, width = image.saturated.shape
        assert find_rim(Camera(ORTHOGRAPHIC, [], width, height, np.eye(4)), image) is None


def test_the_grey_ball_is_found_in_photographs_each_lit_from_elsewhere(data_dir):
    camera = Camera(ORTHOGRAPHIC, [1.0, 0, 0], 512, 340, np.diag([1.0, -1, -1, 1]))
    rims = [find_rim(camera, decode(data_dir / "psm" / "gray" / f"gray.{k}.png")) for k in (0, 3, 8)]
    found = np.array(
        [[*camera.project(rim.sphere.centre)[0], rim.sphere.radius] for rim in rims if rim is not None]
    )
    # The camera rests. The mask is a circle with a whole pixel as its centre, and 0.7 px off by all photographs.
    assert_allclose(found, np.broadcast_to(np.median(found, axis=0), (3, 3)), atol=0.4, equal_nan=False)
    mask = mask_silhouette(read_mask(data_dir / "psm" / "gray" / "gray.mask.png", (340, 512)))
    drawn = fit_sphere([camera], [mask])
    assert_allclose(
        found[:, :2], np.broadcast_to(camera.project(drawn.centre), (3, 2)), atol=1.0, equal_nan=False
    )
    assert_allclose(found[:, 2], drawn.radius, atol=0.3, equal_nan=False)
