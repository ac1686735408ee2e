"""The command `render` at work: options to pictures, notes on the terminal."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from capture.files.outfolder import result_files, result_folder
from capture.photoset import PhotoSet
from capture.terminal import console, leave_cleanly_when_stopped
from invrender.output.render.files import automatic_exposure, exposure_note, write_picture, write_png
from invrender.output.render.frames import TurntableFrame, light_frames, view_frames
from invrender.output.render.interreflection import bounces_of
from invrender.output.render.light import chosen_lighting, light_element, turned
from invrender.output.render.options import DEFAULT_FPS, RenderOptions, check_options
from invrender.output.render.picture import Picture, take_picture
from invrender.output.render.source_set import find_photoset, photo_camera
from invrender.output.render.subject import Subject, mesh_subject, photographed_subject, sphere_subject
from invrender.output.render.turntable import TURNTABLE_FILES, check_strip, develop, write_frames, write_views
from invrender.output.render.view import new_optics, parse_size, parse_view, seen_from
from invrender.result.reflectance import ASSUMABLE, Reflectance, assumption_notes, reflectance
from invrender.result.saved import SavedResult, nearest, read_result
from invrender.transport.radiosity import Bounced
from invrender.transport.transfer import LightElement

_DEFAULT_VIEW = "0,20"


def run_render(options: RenderOptions) -> None:
    """Render what the options ask for and print what a user should know of it."""
    check_options(options)
    leave_cleanly_when_stopped()
    result = read_result(options.result)
    material = reflectance(result, parse_assumed(options.assume), options.mean)
    own = _own_lighting(result, options)
    lighting = chosen_lighting(result, own, options.light, options.sources, options.panorama)
    element = light_element(lighting)
    photoset = find_photoset(result, options.photoset)
    subject = _subject(result, photoset, options)
    _check_subject(material, subject, options)
    frames, notes = _frames(result, photoset, options, subject)
    notes = [*material.notes, *assumption_notes(material, lighting), *subject.warnings, *notes]
    inputs = [result.path, *(path for path in (options.light, options.mesh, options.mesh_to_world) if path)]
    bounces = bounces_of(subject, material, result.albedo) if result.bounces else None
    take = _photographer(subject, material, element, options.std, bounces)
    if options.turntable is None:
        (frame,) = frames
        with result_files(options.out, inputs=inputs) as folder:
            notes += _write(take(frame), folder / options.out.name, options.exposure_ev)
    else:
        named = {f"{k:03d}": frame for k, frame in enumerate(frames)}
        if options.out.suffix.lower() == ".png":
            check_strip(options.out, named)
        place = (
            result_files(options.out, inputs=inputs)
            if options.out.suffix
            else result_folder(options.out, TURNTABLE_FILES)
        )
        with place as folder:
            exposure = write_frames(folder, named, take)
            if options.exposure_ev is None:
                notes.append(exposure_note(exposure))
            else:
                exposure = options.exposure_ev
            develop(folder, list(named), options.out, exposure, options.fps or DEFAULT_FPS)
            write_views(folder, named, lighting.name, inputs, notes)
    console.print(f"{result.content.name} under {lighting.name}: {options.out}", soft_wrap=True, markup=False)
    for note in notes:
        console.print(f"Note: {note}", style="yellow", markup=False)


def parse_assumed(texts: Sequence[str]) -> dict[str, float]:
    """Values as they are written for `--assume`, by name."""
    assumed = {}
    for text in texts:
        name, _, value = text.partition("=")
        if name not in ASSUMABLE:
            raise ValueError(f"--assume {text}: {name!r} cannot be assumed; {nearest(name, ASSUMABLE)}")
        try:
            assumed[name] = float(value)
        except ValueError:
            raise ValueError(f"--assume {text}: {value!r} is not a number; give {name}=VALUE") from None
    return assumed


def _own_lighting(result: SavedResult, options: RenderOptions) -> str | None:
    """Which of the result's lightings: the one that is named, or that of the photograph whose camera it is."""
    if options.lighting is not None or options.light is not None or options.sources:
        return options.lighting
    return next((photo.lighting for photo in result.content.photos if photo.file == options.photo), None)


def _subject(result: SavedResult, photoset: PhotoSet | None, options: RenderOptions) -> Subject:
    if options.mesh is not None:
        return mesh_subject(options.mesh, options.mesh_to_world)
    if options.radius is not None:
        return sphere_subject(np.array(result.content.object.centre), options.radius)
    return photographed_subject(result, photoset)


def _check_subject(material: Reflectance, subject: Subject, options: RenderOptions) -> None:
    """ValueError where the material or the options don't go with what is rendered."""
    if options.std and not np.isfinite(material.covariance).all():
        raise ValueError("--std: the result has no standard deviations; leave it out")
    if material.textures is not None and material.textures.at_vertices:
        if options.mesh is not None or options.radius is not None:
            raise ValueError(
                "the result's Kd and Ks vary from vertex to vertex of its own mesh; leave --mesh and --radius out, or"
                " give --mean for the means"
            )
    elif material.textures is not None and not subject.has_texture_coordinates:
        what = f"{options.mesh}: has no texture coordinates" if options.mesh else "a sphere has none"
        raise ValueError(
            f"the result's Kd and Ks vary over its mesh by its texture coordinates, and {what}; give a mesh that has"
            " them (OBJ, GLB), or --mean for the means"
        )
    if options.turn == "object" and not subject.turns_visibly:
        raise ValueError(
            "--turn object: a sphere looks the same however it turns; turn the view or the light, or give a --mesh"
        )


def _frames(
    result: SavedResult, photoset: PhotoSet | None, options: RenderOptions, subject: Subject
) -> tuple[list[TurntableFrame], list[str]]:
    """What is to be taken, and notes on the cameras."""
    size = None if options.size is None else parse_size(options.size)
    view = parse_view(options.view or _DEFAULT_VIEW)
    count, turn = options.turntable or 1, options.rotate_light
    if options.photo:
        return light_frames(photo_camera(result, photoset, options.photo), count, turn), []
    photographs = None
    if photoset is not None:
        cameras = [photo.camera for photo in photoset.photos]
        known = result.content.object
        photographs = (cameras, np.array(known.centre), known.radius)
    optics = new_optics(photographs, subject.radius, size, options.fov_deg)
    notes = []
    if photoset is None and (options.fov_deg is None or size is None or view.distance is None):
        notes.append(
            "The photo set isn't beside the result (--set names it): what of the camera isn't given is made up, ten"
            " radii away, the object filling three quarters of the picture."
        )
    camera = partial(seen_from, optics, centre=subject.centre, radius=subject.radius)
    return view_frames(view, camera, count, options.turn or "view", turn), notes


def _photographer(
    subject: Subject,
    material: Reflectance,
    element: LightElement,
    with_std: bool,
    bounces: Callable[[LightElement], Bounced | None] | None,
) -> Callable[[TurntableFrame], Picture]:
    """What takes a frame's picture."""
    # Frames in which the light rests share what is prepared of it.
    under = lru_cache(maxsize=1)(partial(turned, element))

    def take(frame: TurntableFrame) -> Picture:
        light = under(frame.light_turn)
        bounced = None if bounces is None else bounces(light)
        return take_picture(subject, frame.camera, material, light, with_std, bounced)

    return take


def _write(picture: Picture, path: Path, exposure_ev: float | None) -> list[str]:
    """Write one picture; returns notes."""
    if path.suffix.lower() == ".exr":
        write_picture(path, picture)
        return []
    exposure = (automatic_exposure(picture) or 0.0) if exposure_ev is None else exposure_ev
    write_png(path, picture, exposure)
    return [] if exposure_ev is not None else [exposure_note(exposure)]
