"""A mesh that isn't what the photographs show is refused, with what would explain it."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from capture.arc.gantry import look_at
from capture.camera import Camera
from recon.mesh.bodies import MeshBody, body_coverage
from recon.mesh.shape import placed
from recon.mesh.trianglemesh import TriangleMesh
from recon.placement.check import MaskedView, check_placement

from .bodymeshes import ball_mesh, joined

# A lopsided body off its own origin, so that no turn, flip or scale of it looks like another.
BODY = joined(
    ball_mesh((0.02, 0, 0.01), 0.03, 3),
    ball_mesh((0.06, 0.01, 0.02), 0.02, 3),
    ball_mesh((0.02, 0.04, 0.04), 0.015, 3),
)
TO_WORLD = np.array([[0, -1.0, 0, 0.1], [1, 0, 0, 0.2], [0, 0, 1, 0.05], [0, 0, 0, 1]])
EYES = [(0.6, 0.1, 0.3), (-0.3, 0.5, 0.2), (0.1, -0.4, 0.4)]
CAMERAS = [
    Camera("PINHOLE", [210.0, 210, 60, 45], 120, 90, look_at(eye, [0.1, 0.23, 0.07], [0, 0, 1]))
    for eye in EYES
]
MASKS = [body_coverage(MeshBody(placed(BODY, TO_WORLD)), camera).astype(np.float32) for camera in CAMERAS]


def views(cameras=CAMERAS, masks=MASKS) -> list[MaskedView]:
    return [
        MaskedView(f"{k}.png", camera, mask)
        for k, (camera, mask) in enumerate(zip(cameras, masks, strict=True))
    ]


def check(mesh: TriangleMesh = BODY, to_world: np.ndarray = TO_WORLD, **changed):
    return check_placement(MeshBody(placed(mesh, to_world)), to_world, views(**changed))


def test_a_mesh_in_its_place_overlaps_its_masks_wholly():
    found = check()
    assert found.overlaps == (1.0, 1.0, 1.0)
    assert not found.warnings
    unmasked = check(masks=[None, None, None])
    assert unmasked.overlaps == (None, None, None)
    assert "no photograph has a mask" in unmasked.warnings[0]


def test_a_mesh_somewhat_off_is_warned_of():
    shifted = TO_WORLD.copy()
    shifted[2, 3] += 0.004
    found = check(to_world=shifted)
    assert all(0.8 < overlap < 0.95 for overlap in found.overlaps)
    assert "overlap by less than 95% in 3 of the photographs (0.png 8" in found.warnings[0]
    assert "align" in found.warnings[0]
    one = check(masks=[MASKS[0], MASKS[1], np.roll(MASKS[2], 1, axis=1)]).warnings[0]
    assert re.search(r"in 1 of the photographs \(2\.png \d\d%\): check their masks and poses", one)


@pytest.mark.parametrize(
    ("factor", "said"),
    [
        (1000, "it would fit if it were 0.001 times as large: millimetres taken for metres"),
        (0.001, "it would fit if it were 1000 times as large: metres taken for millimetres"),
        (1 / 25.4, "it would fit if it were 25.4 times as large: inches"),
        pytest.param(1.4, "it would fit if it were 0.714 times as large", marks=pytest.mark.slow),
    ],
)
def test_a_wrong_unit_is_named_with_its_factor(factor, said):
    with pytest.raises(ValueError, match=r"0\.png: .*" + said.replace(".", r"\.")):
        check(replace(BODY, vertices=BODY.vertices * factor))


def test_poses_in_millimetres_are_named():
    cameras = []
    for camera in CAMERAS:
        pose = camera.world_to_camera.copy()
        pose[:3, 3] *= 1000
        cameras.append(camera.posed(pose))
    with pytest.raises(
        ValueError, match=r"if the cameras' positions were 0\.001 times as large: millimetres taken"
    ):
        check(cameras=cameras)


@pytest.mark.parametrize(
    ("convert", "said"),
    [
        (np.linalg.inv, r"camera_to_world \(OpenCV axes\)"),
        (lambda pose: np.diag([1.0, -1, -1, 1]) @ pose, "OpenGL axes"),
        (
            lambda pose: np.linalg.inv(pose) @ np.diag([1.0, -1, -1, 1]),
            "camera_to_world with OpenGL or Blender",
        ),
    ],
)
def test_another_convention_of_poses_is_named(convert, said):
    cameras = [camera.posed(convert(camera.world_to_camera)) for camera in CAMERAS]
    with pytest.raises(ValueError, match=r"0\.png: .*the pose looks like .*" + said):
        check(cameras=cameras)


@pytest.mark.parametrize(
    ("factor", "also"),
    [
        (1, ""),
        pytest.param(1000, "0.001 times as large: millimetres taken for metres", marks=pytest.mark.slow),
    ],
)
@pytest.mark.parametrize(
    ("turn", "why"),
    [
        ([[1, 0, 0], [0, 0, 1], [0, -1, 0]], "+Y is up in its file"),  # as Blender writes GLB
        pytest.param([[0, 1, 0], [0, 0, 1], [1, 0, 0]], "", marks=pytest.mark.slow),
    ],
)
def test_turned_axes_are_named_with_the_place_that_mends_them(turn, why, factor, also):
    vertices, normals = (values @ np.transpose(turn) for values in (BODY.vertices, BODY.normals))
    turned = replace(BODY, vertices=vertices, normals=normals)
    with pytest.raises(ValueError, match="its axes were turned") as error:
        check(replace(turned, vertices=factor * turned.vertices))
    said = str(error.value)
    assert why in said
    assert also in said
    place = np.array(json.loads(said[said.index("mesh_to_world = ") + 16 : said.index(" into [object]")]))
    assert min(check(turned, place).overlaps) == 1


def test_axes_and_poses_of_another_program_are_named_together():
    turned = replace(BODY, vertices=BODY.vertices[:, [1, 2, 0]], normals=BODY.normals[:, [1, 2, 0]])
    flip = np.diag([1.0, -1, -1, 1])
    with pytest.raises(ValueError, match=r"OpenGL axes .*; and its axes were turned"):
        check(turned, cameras=[camera.posed(flip @ camera.world_to_camera) for camera in CAMERAS])


def test_masks_that_are_inverted_mirrored_or_white_all_over_are_named():
    for flip, said in ((np.fliplr, "mirrored, right and left"), (np.flipud, "from the bottom up")):
        with pytest.raises(ValueError, match=r"\d\.png: .*; the mask looks .*" + said):
            check(masks=[flip(mask) for mask in MASKS])
    with pytest.raises(
        ValueError, match=r"0\.png: .*; the mask is inverted: it must be white where the object is"
    ):
        check(masks=[1 - mask for mask in MASKS])
    with pytest.raises(ValueError, match=r"2\.png: .*; the mask is inverted"):
        check(masks=[MASKS[0], MASKS[1], 1 - MASKS[2]])
    with pytest.raises(ValueError, match=r"0\.png: .*; its mask is white all over"):
        check(masks=[np.ones_like(mask) for mask in MASKS])


def test_a_wrong_focal_length_is_a_size_that_fits():
    said = r"0\.92\d times as large: check .* the camera's focal length"
    assert re.search(said, check(cameras=[camera.zoomed(1.08) for camera in CAMERAS]).warnings[0])
    with pytest.raises(ValueError, match=said.replace("92", "80")):
        check(cameras=[camera.zoomed(1.24) for camera in CAMERAS])


def test_faces_inside_out_are_named():
    with pytest.raises(ValueError, match="turned over: the mesh is inside out"):
        check(replace(BODY, faces=BODY.faces[:, ::-1], normals=-BODY.normals))


def test_a_photo_that_does_not_show_the_object_is_named():
    away = CAMERAS[1].posed(look_at(EYES[1], 2 * np.array(EYES[1]) - [0.1, 0.23, 0.07], [0, 0, 1]))
    with pytest.raises(ValueError, match=r"1\.png: the mesh lies behind the camera"):
        check(cameras=[CAMERAS[0], away, CAMERAS[2]], masks=[MASKS[0], None, MASKS[2]])
    aside = CAMERAS[1].posed(look_at(EYES[1], [2, 0.5, 0.2], [0, 0, 1]))
    with pytest.raises(ValueError, match=r"1\.png: the object isn't seen"):
        check(cameras=[CAMERAS[0], aside, CAMERAS[2]])
    # A mask of something else.
    with pytest.raises(
        ValueError, match=r"2\.png: .* by only \d+%; 2 other photographs show .* check this one's mask"
    ):
        check(masks=[MASKS[0], MASKS[1], np.roll(MASKS[2], 15, axis=1)])
    with pytest.raises(
        ValueError, match=r"1\.png: .* its mask is what the camera of 0\.png sees: .* exchanged\?"
    ):
        check(masks=[MASKS[0], MASKS[0], MASKS[2]])
    # Every photograph shows another than its mask says: that is no single one's fault.
    with pytest.raises(ValueError, match=r"0\.png: .*; check world_to_camera, mesh_to_world"):
        check(masks=MASKS[1:] + MASKS[:1])


def test_a_camera_within_the_mesh_is_said():
    with pytest.raises(ValueError, match=r"0\.png: the camera stands within the mesh, from -"):
        check(replace(BODY, vertices=BODY.vertices * 1000))
