"""How references lie in the world: by corners, by their sphere, and what contradicts the camera or the object."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from capture.files.imagefile import write_exr
from capture.photoset import PhotoSet, load_photoset
from recon.mesh.bodies import SphereBody
from recon.reference import find_references
from recon.sphere.sphere import Sphere

Floats = NDArray[np.float64]

# At 0.5 m a metre is 3000 pixels.
HEAD = """format = 1
name = "card"
[camera]
model = "SIMPLE_PINHOLE"
params = [1500.0, 400.0, 300.0]
width = 800
height = 600
[[lighting]]
name = "room"
unknown = true
[[photo]]
file = "000.exr"
world_to_camera = [[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [0.0, 1.0, 0.0, 0.5], [0.0, 0.0, 0.0, 1.0]]
[[reference]]
photo = "000.exr"
reflectance = 0.4
"""


@pytest.fixture
def written(tmp_path: Path) -> Callable[[str], PhotoSet]:
    write_exr(tmp_path / "000.exr", np.full((600, 800, 3), 0.3, np.float32))

    def write(table: str) -> PhotoSet:
        (tmp_path / "photoset.toml").write_text(HEAD + table)
        return load_photoset(tmp_path)

    return write


def corners_of(photoset: PhotoSet, normal: Floats, centre: Floats, size: tuple[float, float]) -> Floats:
    """Corners of a card in the photograph (4, 2) pixels, the first two along its width."""
    across = np.cross(normal, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    up = np.cross(normal, across)
    places = [
        centre + a * size[0] / 2 * across + b * size[1] / 2 * up
        for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))
    ]
    return photoset.photos[0].camera.project(np.array(places))


def test_corners_say_how_a_card_is_turned_as_well_as_they_claim(written: Callable[[str], PhotoSet]) -> None:
    rng, size, far = np.random.default_rng(5), (0.085, 0.054), []
    camera = written("centre = [0, 0, 0]\nradius = 0.01")
    for _ in range(30):
        normal = np.array([rng.uniform(-0.6, 0.6), -1.0, rng.uniform(-0.6, 0.6)])
        normal /= np.linalg.norm(normal)
        centre = rng.uniform(-0.02, 0.02, 3)
        corners = corners_of(camera, normal, centre, size) + 0.5 * rng.standard_normal((4, 2))
        photoset = written(f"region = {corners.tolist()}\nsize = {list(size)}")
        try:
            (found,) = find_references(photoset)
        except ValueError:
            # Nearly head-on two ways look alike.
            with pytest.raises(ValueError, match="two ways in which it may be turned"):
                find_references(photoset)
            continue
        assert found.positions is not None
        # Half a pixel is 0.2 mm across, and in depth as much as 0.5% of a size of 250 pixels is.
        assert np.abs(found.positions[0] - centre).max() < 0.008
        far.append(np.arccos(np.clip(found.normals[0] @ normal, -1, 1)) / found.normal_std)
    assert len(far) > 12
    # Lengths of two turns of one deviation each: the RMS is the square root of 2; of 12 or more, to 30%.
    assert 0.9 < np.sqrt(np.mean(np.square(far))) < 1.9


def test_a_spheres_normals_are_those_of_its_points(written: Callable[[str], PhotoSet]) -> None:
    photoset = written("centre = [0.02, 0.01, -0.01]\nradius = 0.02")
    (found,) = find_references(photoset)
    assert found.positions is not None
    assert found.normal_std == 0
    assert_allclose(found.normals, (found.positions - [0.02, 0.01, -0.01]) / 0.02, atol=1e-9)
    # They face the camera, and lie in the pixels that were read.
    camera = photoset.photos[0].camera
    assert ((found.normals * camera.views(found.positions)).sum(axis=1) > 0.4).all()


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (
            "region = [[10, 10], [90, 10], [90, 90], [10, 90]]\nnormal = [0, 1, 0]",
            "faces away from the camera",
        ),
        (
            "region = [[10, 10], [90, 90], [90, 10], [10, 90]]\nsize = [0.03, 0.03]",
            "the corners miss those of a flat rectangle",
        ),
        (
            "region = [[380, 280], [450, 280], [450, 350], [380, 350]]\nnormal = [0, -1, 0]",
            "show the object itself",
        ),
    ],
)
def test_what_contradicts_camera_or_object_is_refused(
    written: Callable[[str], PhotoSet], table: str, message: str
) -> None:
    body = SphereBody(Sphere(np.zeros(3), 0.03, np.zeros((4, 4))))
    with pytest.raises(ValueError, match=r'\[\[reference\]\] 1 \(photo "000.exr"\): .*' + message):
        find_references(written(table), body)
