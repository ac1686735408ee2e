"""The command `render` at work: options to pictures, notes on the terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from capture.camera import Camera
from capture.files.documents import input_hashes, software, write_json
from capture.files.outfolder import result_files, result_folder
from capture.terminal import console, leave_cleanly_when_stopped, track
from invrender.model.transfer import LightElement
from invrender.render.files import automatic_exposure, write_picture, write_png
from invrender.render.light import chosen_lighting, light_element
from invrender.render.picture import Picture, take_picture
from invrender.render.reflectance import ASSUMABLE, Reflectance, assumption_notes, reflectance
from invrender.render.saved import SavedResult, nearest, read_result
from invrender.render.source_set import find_photoset, photo_camera
from invrender.render.subject import Subject, mesh_subject, sphere_subject
from invrender.render.view import new_optics, parse_size, parse_view, seen_from, turntable

# The first is in every turntable's folder.
TURNTABLE_FILES = ("views.json", "*.exr", "*.png")
_DEFAULT_VIEW = "0,20"


@dataclass(frozen=True)
class RenderOptions:
    """The options of the command, as given; see its help."""

    result: Path
    out: Path
    lighting: str | None = None
    light: Path | None = None
    panorama: bool = False
    sources: tuple[str, ...] = ()
    view: str | None = None
    photo: str | None = None
    photoset: Path | None = None
    size: str | None = None
    fov_deg: float | None = None
    turntable: int | None = None
    radius: float | None = None
    mesh: Path | None = None
    mesh_to_world: Path | None = None
    exposure_ev: float | None = None
    std: bool = False
    assume: tuple[str, ...] = ()


def run_render(options: RenderOptions) -> None:
    """Render what the options ask for and print what a user should know of it."""
    _check_options(options)
    leave_cleanly_when_stopped()
    result = read_result(options.result)
    material = reflectance(result, _assumed(options.assume))
    lighting = chosen_lighting(result, options.lighting, options.light, options.sources, options.panorama)
    element = light_element(lighting)
    subject = _subject(result, options)
    cameras, notes = _cameras(result, options, subject)
    notes = [*material.notes, *assumption_notes(material, lighting), *subject.warnings, *notes]
    inputs = [result.path, *(path for path in (options.light, options.mesh, options.mesh_to_world) if path)]
    if options.turntable is None:
        (camera,) = cameras.values()
        with result_files(options.out, inputs=inputs) as folder:
            picture = take_picture(subject, camera, material, element, options.std)
            notes += _write(picture, folder / options.out.name, options.exposure_ev)
    else:
        with result_folder(options.out, TURNTABLE_FILES) as folder:
            notes += _write_turntable(cameras, folder, subject, material, element, options)
            _write_views(folder, cameras, lighting.name, inputs, notes)
    console.print(f"{result.content.name} under {lighting.name}: {options.out}", soft_wrap=True, markup=False)
    for note in notes:
        console.print(f"Note: {note}", style="yellow", markup=False)


def _check_options(options: RenderOptions) -> None:
    """ValueError where options exclude each other."""
    ending = options.out.suffix.lower()
    if options.turntable is not None:
        if ending:
            raise ValueError(f"-o {options.out}: --turntable writes a folder; give a name without {ending}")
        if options.photo:
            raise ValueError("--turntable goes round from --view; it excludes --photo")
    elif ending not in (".exr", ".png"):
        raise ValueError(f"-o {options.out}: the name must end in .exr or .png, unless --turntable is given")
    if options.photo and (options.view or options.size or options.fov_deg is not None):
        raise ValueError("--photo is a whole camera: it excludes --view, --size and --fov")
    if options.std and ending == ".png":
        raise ValueError("--std: a PNG has no room for standard deviations; write an .exr")
    if options.exposure_ev is not None and ending == ".exr":
        raise ValueError("--exposure is for looking at; an .exr holds the radiance itself: leave it out")
    if options.exposure_ev is not None and not abs(options.exposure_ev) <= 100:
        raise ValueError(f"--exposure is {options.exposure_ev:g} EV; it must be -100 to 100")
    if options.mesh is not None and options.radius is not None:
        raise ValueError("--radius is a sphere's; it excludes --mesh")
    if options.mesh_to_world is not None and options.mesh is None:
        raise ValueError("--mesh-to-world places a mesh; give --mesh")


def _assumed(texts: Sequence[str]) -> dict[str, float]:
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


def _subject(result: SavedResult, options: RenderOptions) -> Subject:
    if options.mesh is not None:
        return mesh_subject(options.mesh, options.mesh_to_world)
    known = result.content.object
    return sphere_subject(np.array(known.centre), known.radius if options.radius is None else options.radius)


def _cameras(
    result: SavedResult, options: RenderOptions, subject: Subject
) -> tuple[dict[str, Camera], list[str]]:
    """Cameras by the stem of the files that they fill, and notes on them."""
    size = None if options.size is None else parse_size(options.size)
    view = parse_view(options.view or _DEFAULT_VIEW)
    photoset = find_photoset(result, options.photoset)
    if options.photo:
        return {options.out.stem: photo_camera(result, photoset, options.photo)}, []
    optics = new_optics(result, photoset, subject.radius, size, options.fov_deg)
    notes = []
    if photoset is None and (options.fov_deg is None or size is None or view.distance is None):
        notes.append(
            "The photo set isn't beside the result (--set names it): what of the camera isn't given is made up, ten"
            " radii away, the object filling three quarters of the picture."
        )
    if options.turntable is None:
        return {options.out.stem: seen_from(optics, view, subject.centre, subject.radius)}, notes
    views = turntable(view, options.turntable)
    cameras = [seen_from(optics, each, subject.centre, subject.radius) for each in views]
    return {f"{k:03d}": camera for k, camera in enumerate(cameras)}, notes


def _write(picture: Picture, path: Path, exposure_ev: float | None) -> list[str]:
    """Write one picture; returns notes."""
    if path.suffix.lower() == ".exr":
        write_picture(path, picture)
        return []
    exposure, notes = _exposure(picture, exposure_ev)
    write_png(path, picture, exposure)
    return notes


def _write_turntable(
    cameras: Mapping[str, Camera],
    folder: Path,
    subject: Subject,
    material: Reflectance,
    element: LightElement,
    options: RenderOptions,
) -> list[str]:
    """Write all views, EXR and PNG, the latter exposed as the first; returns notes."""
    exposure, notes = options.exposure_ev, list[str]()
    for stem, camera in track(list(cameras.items()), "Rendering"):
        picture = take_picture(subject, camera, material, element, options.std)
        if exposure is None:
            exposure, notes = _exposure(picture, None)
        write_picture(folder / f"{stem}.exr", picture)
        write_png(folder / f"{stem}.png", picture, exposure)
    return notes


def _exposure(picture: Picture, given: float | None) -> tuple[float, list[str]]:
    if given is not None:
        return given, []
    exposure = automatic_exposure(picture)
    return exposure, [f"Exposed automatically: --exposure {exposure:.2f} gives the same brightness again."]


def _write_views(
    folder: Path, cameras: Mapping[str, Camera], lighting: str, inputs: Sequence[Path], notes: Sequence[str]
) -> None:
    document = {
        "format": 1,
        "lighting": lighting,
        "views": [
            {
                "file": f"{stem}.exr",
                "model": camera.model,
                "params": camera.params.tolist(),
                "width": camera.width,
                "height": camera.height,
                "world_to_camera": camera.world_to_camera.tolist(),
            }
            for stem, camera in cameras.items()
        ],
        "notes": list(notes),
        "inputs": input_hashes(inputs),
        "software": software(),
    }
    write_json(folder / "views.json", document)
