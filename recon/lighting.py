"""The lightings of a photo set, read from maps, source lists and mirror balls."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from capture.decode import decode_in_set, read_mask
from capture.exposure import ExposureSettings, relative_exposure
from capture.lighting import Lighting, read_latlong
from capture.manifest import BallViewTable, CameraTable, LightingTable, MirrorBallTable
from capture.photo import Photo
from capture.photoset import PhotoSet, build_camera
from capture.placing import matrix4
from capture.source_region import source_regions
from recon.mesh.bodies import Body
from recon.mirrorball.bracket import view_bracket
from recon.mirrorball.light import ball_lighting, lighting_of_ball
from recon.mirrorball.view import BallView
from recon.sphere.circle import Disk

Floats = NDArray[np.float64]


# Near a surface a lamp is no point: the least distance, over the object's size.
_LEAST_CLEARANCE = 0.1


def read_lighting(photoset: PhotoSet, table: LightingTable, body: Body | None = None) -> Lighting:
    """One named lighting of a set; ValueError names the table and what it lacks.

    body : the object, from which near lamps are seen; None where whoever asks takes all light for distant.
    """
    where = f'{photoset.manifest}: [[lighting]] "{table.name}"'
    if table.unknown:
        raise ValueError(
            f"{where}: unknown = true: this version recovers reflectance under known light only;"
            " give map, directional, near or mirror_ball"
        )
    if table.mirror_ball is not None:
        lighting = _from_ball(photoset, table, table.mirror_ball, where)
        return lighting.from_afar if body is None else lighting
    recover = table.recover or ()
    directions = np.array([source.direction for source in table.directional]).reshape(-1, 3)
    centre, offsets = _from_object(table, body, where)
    distances = np.linalg.norm(offsets, axis=1)
    lacking = [
        *(
            f"directional source {k + 1} has no irradiance"
            for k, s in enumerate(table.directional)
            if not s.irradiance
        ),
        *(f"near source {k + 1} has no intensity" for k, lamp in enumerate(table.near) if not lamp.intensity),
    ]
    if lacking and "irradiance" not in recover:
        raise ValueError(f"{where}: {lacking[0]}; give it, or recover = ['irradiance'] to have it fitted")
    if "irradiance" in recover and not (table.directional or table.near):
        raise ValueError(f"{where}: recover = ['irradiance'], but there is no directional or near source")
    if "ambient" in recover and table.map:
        raise ValueError(
            f"{where}: recover = ['ambient'] contradicts map: a recovered ambient stands in for a map"
        )
    irradiances = [source.irradiance or (1.0, 1.0, 1.0) for source in table.directional]
    # At the object's centre.
    irradiances += [
        tuple(np.array(lamp.intensity) / distance**2) if lamp.intensity else (1.0, 1.0, 1.0)
        for lamp, distance in zip(table.near, distances, strict=True)
    ]
    try:
        lighting = Lighting(
            name=table.name,
            radiance_map=read_latlong(photoset.resolve(table.map)) if table.map else None,
            directions=np.concatenate([directions, offsets]),
            irradiances=np.array(irradiances).reshape(-1, 3),
            recover_irradiance="irradiance" in recover,
            recover_ambient="ambient" in recover,
            origin=table.map or "manifest",
            direction_std_deg=np.full(len(irradiances), photoset.direction_std_deg)
            if photoset.direction_std_deg
            else None,
            closeness=np.concatenate([np.zeros(len(directions)), 1 / distances]) if table.near else None,
            centre=centre,
        )
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from error
    dark = lighting.radiance_map is None and not lighting.irradiances.any()
    if dark and not lighting.recovers:
        raise ValueError(f"{where}: gives no light at all; every irradiance is zero")
    return lighting


def _from_object(table: LightingTable, body: Body | None, where: str) -> tuple[Floats, Floats]:
    """The object's centre (3,), and near lamps (k, 3) from there, metres."""
    if not table.near:
        return np.zeros(3), np.zeros((0, 3))
    if body is None:
        raise ValueError(
            f"{where}: near: lamps at a place are for `lightfactor process`; this takes all light for distant: give"
            " the lamp as directional where it is 25 times the object's size away, or leave its photographs out"
        )
    for k, lamp in enumerate(table.near):
        clearance = body.clearance(np.array(lamp.position))
        at = f"{where}: near source {k + 1} at {list(lamp.position)} m"
        if clearance < 0:
            raise ValueError(f"{at} lies inside the object; position is in the world's frame, in metres")
        if not stands_clear(body, np.array(lamp.position)):
            raise ValueError(
                f"{at} is {clearance:.3g} m from the object's surface, nearer than a tenth of its size"
                f" ({body.size:.3g} m): no lamp is a point from there; check the unit, or move the lamp away"
            )
    return body.centre, np.array([lamp.position for lamp in table.near]) - body.centre


def stands_clear(body: Body, position: Floats) -> bool:
    """Whether a lamp at a position (3,) is far enough from an object to count as a point."""
    return body.clearance(position) >= _LEAST_CLEARANCE * body.size


def frame_warnings(photoset: PhotoSet) -> list[str]:
    """A sentence if lights, or a mesh's place, are given in a frame that the registered poses don't share."""
    if not photoset.own_frame:
        return []
    given = [f"lighting {table.name!r}" for table in photoset.lightings if not table.unknown]
    if photoset.object.mesh_to_world is not None:
        given.append("mesh_to_world")
    if not given:
        return []
    return [
        f"the poses were registered in a frame of their own: {', '.join(given)} must be given in that frame, or the"
        " frame be set by a board, by gantry angles or by given poses of some photos"
    ]


def _from_ball(photoset: PhotoSet, table: LightingTable, ball: MirrorBallTable, where: str) -> Lighting:
    users = [photo for photo in photoset.photos if photo.lighting == table.name]
    if not users:
        raise ValueError(f"{where}: no photo uses this lighting; remove it, or name it in a [[photo]]")
    tables: tuple[BallViewTable, ...] = ball.views or (ball,)
    views = [_ball_view(photoset, ball, view, users, where) for view in tables]
    return lighting_of_ball(ball_lighting(views, views[0].name), table.recover, table.name)


def _ball_view(
    photoset: PhotoSet, ball: MirrorBallTable, view: BallViewTable, users: Sequence[Photo], where: str
) -> BallView:
    pose = matrix4(view.world_to_camera, where) if view.world_to_camera else _common_pose(users, where)
    camera = users[0].camera.posed(pose)
    if view.camera is not None:
        shared = CameraTable(
            model=camera.model, params=tuple(camera.params), width=camera.width, height=camera.height
        )
        camera = build_camera(photoset.manifest, (shared, view.camera), pose, where)
    size = (camera.height, camera.width)
    radiometry = photoset.radiometry
    if len(view.photo) > 1 and radiometry.exposure == "equal":
        raise ValueError(
            f"{where}: photo is a bracket, but [radiometry] exposure = 'equal' says that all exposures are one;"
            " use 'exif', or 'manual' with exposure_s"
        )
    exposed = []
    for index, name in enumerate(view.photo):
        path = photoset.resolve(name)
        seconds = view.exposure_s[index] if view.exposure_s else None
        settings = ExposureSettings(seconds, view.iso, view.f_number)
        exposure = relative_exposure(path, radiometry.exposure, settings)
        exposed.append((exposure, decode_in_set(radiometry, path, settings, size)))
    exposed.sort(key=lambda entry: -entry[0])
    background = None
    if view.background is not None:
        # Its exposure is found by comparison.
        equal = replace(radiometry, exposure="equal")
        background = decode_in_set(equal, photoset.resolve(view.background), ExposureSettings(), size)
    return view_bracket(
        [image for _, image in exposed],
        camera,
        view.photo[0],
        read_mask(photoset.resolve(view.mask), size) if view.mask else None,
        background,
        Disk(*view.ball) if view.ball else None,
        ball.reflectance,
        ball.camera_mask_deg,
        [exposure for exposure, _ in exposed],
        source_regions(photoset.lightings).get(users[0].lighting),
    )[0]


def _common_pose(users: Sequence[Photo], where: str) -> np.ndarray:
    pose = users[0].camera.world_to_camera
    for photo in users[1:]:
        if not np.allclose(photo.camera.world_to_camera, pose, atol=1e-9):
            raise ValueError(
                f"{where}: the photos under this lighting have several poses, so the ball's is not known;"
                " give mirror_ball = { ..., world_to_camera = [...] }"
            )
    return pose
