"""What is done with fits and scenes: compare, export, plan, photograph."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import get_args

from capture.files.outfolder import result_files
from capture.primaries import PRIMARIES
from capture.progress import silent
from capture.terminal import track as terminal_track
from invrender.output.compare.page import write_page
from invrender.output.compare.sides import SideComparison, compare_sides, read_side
from invrender.output.export.exported import ExportedResult, export_result
from invrender.output.export.html import ExportedPage
from invrender.output.export.html import export_page as write_page_of
from invrender.output.render.files import in_primaries
from invrender.output.render.files import save_picture as write_picture
from invrender.output.render.picture import Picture
from invrender.output.render.view import view_of
from invrender.plan.asked import asked_experiment
from invrender.plan.planned import PlannedScene, check_effort, plan_experiment
from invrender.plan.planning import DEFAULT_DEGREE, DEFAULT_SAMPLES
from invrender.result.saved import SavedResult, nearest, read_result
from invrender.result.side import Side, result_side
from lightfactor.arguments import naming_arguments, with_arguments
from lightfactor.fit import Fit
from synthetic.lights.illumination import Given
from synthetic.shoot import photograph_scene


@naming_arguments
def compare(
    first: Fit | Path | str, second: Fit | Path | str, page: Path | str | None = None
) -> SideComparison:
    """Two fits side by side, or a fit beside the truth: `rows`, `lights`, `notes`, and the `verdict` in a sentence.

    first, second : a fit, a result folder, or a truth.json. page : an .html that shows pictures of both, too.
    Each row has both values with their standard deviations, the difference, and z, that over both combined; two numbers
    agree where it is at most 2. ValueError says what is wrong with a path.
    """
    found = compare_sides(_side(first), _side(second))
    if page is not None:
        out = Path(page)
        if out.suffix.lower() not in (".html", ".htm"):
            raise ValueError(f"page {out}: the name must end in .html")
        with result_files(out) as folder:
            write_page(folder / out.name, found)
    return found


@naming_arguments
def export(
    fit: Fit | Path | str,
    folder: Path | str,
    form: str,
    *,
    light: bool = False,
    lighting: str | None = None,
    albedo: float | Sequence[float] | None = None,
    assume: Mapping[str, float] | None = None,
    view: Sequence[float] | None = None,
    photoset: Path | str | None = None,
) -> ExportedResult:
    """Write a fit for another program: `files`, the `mapping` to its material with what is lost by that, and `notes`.

    fit : a fit or a result folder. folder : an earlier export in it is replaced. form : "gltf", "mitsuba",
        "materialx" or "openpbr". light : glTF also has the light. lighting : which, where there are several.
    albedo : in a relative gauge, pi Kd + Ks of the brightest channel, or three; 0.5 if not given. assume : values of mu
        or sigma where they are undetermined. view : of Mitsuba's camera, azimuth and elevation (degrees), and maybe
        the distance (metres). photoset : the set that the fit was made from, looked for around it otherwise.
    ValueError says what doesn't go together, or what the photographs left open.
    """
    result, given = _result_and_set(fit, photoset)
    found = export_result(
        result,
        Path(folder),
        form,
        light=light,
        lighting=lighting,
        albedo=[albedo] if isinstance(albedo, int | float) else albedo,
        assumed=dict(assume or {}),
        view=None if view is None else view_of(view),
        photoset=given,
    )
    return replace(found, notes=tuple(map(with_arguments, found.notes)))


@naming_arguments
def export_page(
    fit: Fit | Path | str,
    folder: Path | str,
    *,
    lighting: str | None = None,
    assume: Mapping[str, float] | None = None,
    view: Sequence[float] | None = None,
    photoset: Path | str | None = None,
    progress: bool = False,
) -> ExportedPage:
    """Write a fit as one page on which a browser shows it under light that can be turned: `files`, `error`, `notes`.

    lighting : one of the fit's, all of them, up to four, if not given. view : where it is first seen from. progress :
    show it on the terminal. The other arguments are those of `export`. `error` says how far pictures on the page are
    off from `fit.render`. ValueError says what the photographs left open, or why browsers can't draw it.
    """
    result, given = _result_and_set(fit, photoset)
    found = write_page_of(
        result,
        Path(folder),
        lighting=lighting,
        assumed=dict(assume or {}),
        view=None if view is None else view_of(view),
        photoset=given,
        track=terminal_track if progress else silent,
    )
    return replace(found, notes=tuple(map(with_arguments, found.notes)))


@naming_arguments
def plan(
    scene: Fit | Path | str,
    light: Given | None = None,
    degree: int = DEFAULT_DEGREE,
    samples: int = DEFAULT_SAMPLES,
    progress: bool = False,
) -> PlannedScene:
    """What photographs will determine before anyone takes them, and which one more would help most.

    scene : the name of a built-in one, a scene file, or a fit or its folder, whose set one photograph more may join.
        light : "all", "distant" (lamps as if they were), "ball" or "nothing", what the set will tell of the light, in
        place of what file or set say; of a fit "all" or "nothing". degree : highest harmonic degree of unknown light, 0
        to 30. samples : pixels that are looked at, 1000 or more. progress : show bars on the terminal.
    The answer has `document`, as plan.json; `figure()`; `write(folder)`. ValueError says what is wrong with the scene.
    """
    check_effort(degree, samples)
    track = terminal_track if progress else silent
    name, photoset = (scene.result.path, scene.photoset) if isinstance(scene, Fit) else (scene, None)
    experiment, path = asked_experiment(str(name), _told(light), photoset, track)
    return plan_experiment(experiment, path, degree, samples, track)


@naming_arguments
def synth(
    scene: Path | str,
    folder: Path | str,
    light: Given | None = None,
    seed: int | None = None,
    progress: bool = False,
) -> Path:
    """Photograph a synthetic scene into a photo set with its truth.json beside it, and return the folder.

    scene : the name of a built-in one, or a scene file. folder : an earlier set of the same scene in it is replaced.
        light : "all", "distant" (lamps as if they were), "ball" or "nothing", what the set tells of the light, in place
        of what the file says. seed : of all that is random. progress : show bars on the terminal.
    ValueError says what is wrong with the scene, or that the folder holds something else.
    """
    photograph_scene(str(scene), Path(folder), _told(light), seed, terminal_track if progress else None)
    return Path(folder)


@naming_arguments
def save_picture(
    picture: Picture, path: Path | str, exposure: float | None = None, primaries: str | None = None
) -> Path:
    """Write a picture of `Fit.render`, and return its path: .exr, linear, with alpha and std; .png to look at.

    exposure : EV of a PNG, sRGB; radiance 1 is white at 0. None lets only the brightest half percent clip.
    primaries : "srgb", "p3", "rec2020", or of an .exr "acescg", that the file says, of a picture in linear sRGB.
    """
    out = Path(path)
    if out.suffix.lower() not in (".exr", ".png"):
        raise ValueError(f"{out}: the name must end in .exr or .png")
    if primaries is not None and primaries not in PRIMARIES:
        raise ValueError(f"primaries is {primaries!r}; {nearest(primaries, tuple(PRIMARIES))}")
    chosen = None if primaries is None else PRIMARIES[primaries]
    with result_files(out) as folder:
        shown = picture if chosen is None else in_primaries(picture, chosen)
        write_picture(folder / out.name, shown, exposure, chosen)
    return out


def _told(light: Given | None) -> Given | None:
    """ValueError where it is none of the words for what a set tells of its light."""
    if light is not None and light not in get_args(Given):
        raise ValueError(f"light is {light!r}; {nearest(str(light), get_args(Given))}")
    return light


def _side(given: Fit | Path | str) -> Side:
    return result_side(given.result) if isinstance(given, Fit) else read_side(Path(given))


def _result_and_set(fit: Fit | Path | str, photoset: Path | str | None) -> tuple[SavedResult, Path | None]:
    """What is exported, and the set that it was made from, if anyone says."""
    given = None if photoset is None else Path(photoset)
    if isinstance(fit, Fit):
        return fit.result, given or fit.photoset
    return read_result(Path(fit)), given
