"""The command `render` at work: options to pictures, notes on the terminal."""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import partial

from capture.files.outfolder import result_files, result_folder
from capture.primaries import PRIMARIES
from capture.terminal import console, leave_cleanly_when_stopped
from invrender.output.render.files import exposure_note, in_primaries, save_picture
from invrender.output.render.frames import TurntableFrame, light_frames, view_frames
from invrender.output.render.light import chosen_lighting, own_lighting, parse_source
from invrender.output.render.options import DEFAULT_FPS, RenderOptions, check_options
from invrender.output.render.photographer import Photographer, photographer
from invrender.output.render.picture import Picture, interpolation_note
from invrender.output.render.preview import previewer
from invrender.output.render.turntable import TURNTABLE_FILES, check_strip, develop, write_frames, write_views
from invrender.output.render.view import parse_size, parse_view
from invrender.result.reflectance import check_assumable
from invrender.result.saved import read_result

_DEFAULT_VIEW = "0,20"


def run_render(options: RenderOptions) -> None:
    """Render what the options ask for and print what a user should know of it."""
    check_options(options)
    leave_cleanly_when_stopped()
    result = read_result(options.result)
    assumed = parse_assumed(options.assume)
    sources = [parse_source(text) for text in options.sources]
    own = own_lighting(result, options.lighting, options.photo, options.light is None and not sources)
    studio = photographer(
        result,
        chosen_lighting(result, own, options.light, sources, options.panorama),
        options.photoset,
        assumed,
        options.mean,
        options.mesh,
        options.mesh_to_world,
        options.radius,
    )
    if options.turn == "object" and not studio.subject.turns_visibly:
        raise ValueError(
            "--turn object: a sphere looks the same however it turns; turn the view or the light, or give a --mesh"
        )
    frames, made_up = _frames(studio, options)
    notes = [*studio.notes, *made_up]
    inputs = [result.path, *(path for path in (options.light, options.mesh, options.mesh_to_world) if path)]

    begin = time.perf_counter()
    quick = previewer(studio) if options.preview else None
    prepared = time.perf_counter() - begin
    errors: list[float | None] = []

    primaries = None if options.primaries is None else PRIMARIES[options.primaries]

    def take(frame: TurntableFrame) -> Picture:
        if quick is not None:
            picture = quick.take(frame.camera, frame.light_turn)
        else:
            picture = studio.take(frame.camera, frame.light_turn, options.std, options.tolerance)
            errors.append(picture.interpolated)
        return picture if primaries is None else in_primaries(picture, primaries)

    if options.turntable is None:
        (frame,) = frames
        with result_files(options.out, inputs=inputs) as folder:
            notes += save_picture(folder / options.out.name, take(frame), options.exposure_ev, primaries)
            notes += interpolation_note(errors)
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
            exposure = write_frames(folder, named, take, primaries)
            if options.exposure_ev is None:
                notes.append(exposure_note(exposure))
            else:
                exposure = options.exposure_ev
            develop(folder, list(named), options.out, exposure, options.fps or DEFAULT_FPS, primaries)
            notes += interpolation_note(errors)
            write_views(folder, named, studio.lighting.name, inputs, notes)
    under = studio.lighting.name
    console.print(f"{result.content.name} under {under}: {options.out}", soft_wrap=True, markup=False)
    if quick is not None:
        took = f"{time.perf_counter() - begin:.2g} s, {prepared:.2g} s of it for filtering the light"
        console.print(f"Preview in {took}. {quick.stated}", soft_wrap=True, markup=False)
    for note in notes:
        console.print(f"Note: {note}", style="yellow", markup=False)


def parse_assumed(texts: Sequence[str]) -> dict[str, float]:
    """Values as they are written for `--assume`, by name."""
    assumed = {}
    for text in texts:
        name, _, value = text.partition("=")
        check_assumable(name)
        try:
            assumed[name] = float(value)
        except ValueError:
            raise ValueError(f"--assume {text}: {value!r} is not a number; give {name}=VALUE") from None
    return assumed


def _frames(studio: Photographer, options: RenderOptions) -> tuple[list[TurntableFrame], tuple[str, ...]]:
    """What is to be taken, and notes on the cameras."""
    count, turn = options.turntable or 1, options.rotate_light
    if options.photo:
        return light_frames(studio.photo_camera(options.photo), count, turn), ()
    size = None if options.size is None else parse_size(options.size)
    view = parse_view(options.view or _DEFAULT_VIEW)
    camera = partial(studio.camera, optics=studio.optics(size, options.fov_deg))
    notes = studio.made_up(view, size, options.fov_deg)
    return view_frames(view, camera, count, options.turn or "view", turn), notes
