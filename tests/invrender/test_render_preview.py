"""Previews by reflection maps, against the pictures that integrate every pixel, and against their own bound."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from capture.camera import Camera
from capture.files.imagefile import write_exr
from invrender.output.render.photographer import Photographer, photographer
from invrender.output.render.preview import previewer
from invrender.output.render.view import parse_view
from invrender.result.saved import read_result
from synthetic.lights.arealight import AreaLight
from synthetic.lights.illumination import latlong_map

from .renders import read, within, write_result

_AREA = AreaLight(np.array([0.5, -0.4, 0.77]), np.array([0.8, 1.0, 1.3]), width_rad=0.9)


@pytest.fixture(scope="module")
def studio(tmp_path_factory: pytest.TempPathFactory) -> Photographer:
    """A glossy ball under an area light, in a dim room."""
    folder = write_result(tmp_path_factory.mktemp("preview") / "result", "microfacet", 1.5, 0.2)
    write_exr(folder / "lighting.exr", latlong_map([_AREA], 32).astype(np.float32) + np.float32(0.05))
    result = read_result(folder)
    return photographer(result, result.read_lighting(result.lighting(None)))


def camera_at(studio: Photographer, azimuth: float, side: int) -> Camera:
    """A camera that looks at the ball from an azimuth, degrees."""
    return studio.camera(parse_view(f"{azimuth},25"), studio.optics((side, side)))


def test_a_preview_is_off_by_what_it_states(studio: Photographer) -> None:
    quick = previewer(studio)
    assert quick.found is not None
    bound = quick.found.bound
    squares, stated = 0.0, 0.0
    for azimuth in (0, 160):
        camera = camera_at(studio, azimuth, 72)
        exact, seen = studio.take(camera), quick.take(camera)
        inside = within(exact.coverage)
        assert inside.sum() > 1500
        assert (seen.coverage[inside] == 1).all()
        difference = (seen.radiance - exact.radiance)[inside].astype(float)
        # Angles between view and normal of a ball's pixels.
        rows, columns = np.nonzero(inside)
        hits = studio.subject.body.hits(camera, np.column_stack([columns, rows]) + 0.5)
        cos = (hits.normals * hits.views).sum(axis=1)
        steep = cos < np.cos(np.radians(70))
        assert steep.any()
        # Grazing pixels are integrated, too, at their middle alone.
        assert np.abs(difference[steep]).max() < 0.02 * exact.radiance.max()
        largest, rms = (
            np.stack([np.interp(cos, bound.cos_angles, part[:, c]) for c in range(3)], axis=1)
            for part in (bound.largest, bound.rms)
        )
        between = max(each.between_pixels for each in quick.found.lobes) * exact.radiance.max()
        assert (np.abs(difference) <= largest + between)[~steep].all()
        squares += float((difference[~steep] ** 2).sum())
        stated += float((rms[~steep] ** 2).sum())
    # Over all orientations they are equal; these are two views of one light.
    assert 0.5 * stated < squares < 1.5 * stated


def test_light_that_turns_is_a_view_that_turns_back(studio: Photographer) -> None:
    quick = previewer(studio)
    turned = quick.take(camera_at(studio, 70, 24), 40)
    assert_allclose(turned.radiance, quick.take(camera_at(studio, 30, 24)).radiance, atol=1e-6)


def test_sources_alone_need_no_maps(
    lightfactor: Callable[..., tuple[int, str, str]], studio: Photographer, tmp_path: Path
) -> None:
    command = ("render", studio.result.folder, "--source", "40,30,2,1,0.5", "--size", "40x40")
    assert lightfactor(*command, "-o", tmp_path / "x.exr")[0] == 0
    code, said, _ = lightfactor(*command, "--preview", "-o", tmp_path / "quick.exr")
    assert code == 0
    assert "exact for each pixel's middle" in said
    (exact, layers), (quick, _) = read(tmp_path / "x.exr"), read(tmp_path / "quick.exr")
    inside = within(layers["A"])
    assert_allclose(quick[inside], exact[inside], atol=0.02 * exact.max())


def test_the_command_says_what_a_preview_is_off_by_and_what_it_takes(
    lightfactor: Callable[..., tuple[int, str, str]], studio: Photographer, tmp_path: Path
) -> None:
    command = ("render", studio.result.folder, "--preview", "--size", "24x24")
    code, said, _ = lightfactor(*command, "--turntable", 3, "-o", tmp_path / "turn.png")
    assert code == 0
    assert (
        "for filtering the light. Up to 70 degrees from the normal a ball in the map's light is off by"
        in said
    )
    code, _, err = lightfactor(*command, "--std", "-o", tmp_path / "x.exr")
    assert code == 1
    assert "--preview knows no standard deviations" in err


def test_what_reflects_nothing_has_no_preview(tmp_path: Path) -> None:
    result = read_result(write_result(tmp_path / "result"))
    studio = photographer(result, result.read_lighting(result.lighting(None)))
    studio.material.brdf.kd.setflags(write=True)
    studio.material.brdf.kd[:] = 0
    with pytest.raises(ValueError, match=r"--preview: .*reflects nothing.*; or leave --preview out"):
        previewer(studio)
