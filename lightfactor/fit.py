"""What `process` finds, as one object: numbers with their errors, light, photographs, pictures, files."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from capture.files.outfolder import result_folder
from invrender.estimate.quantities import PhotoScore
from invrender.output.gradients.figure import gradients_figure
from invrender.output.gradients.photograph import PhotoGradients, photo_gradients
from invrender.output.render.light import chosen_lighting, distant_source, light_element, own_lighting
from invrender.output.render.options import check_preview, check_tolerance
from invrender.output.render.photographer import photographer
from invrender.output.render.picture import Picture, interpolation_note
from invrender.output.render.preview import previewer
from invrender.output.render.view import checked_size, view_of
from invrender.output.report.brdf_figure import brdf_figure
from invrender.output.report.files import RESULT_FILES
from invrender.output.report.pictures import lighting_figure, photo_error_figure
from invrender.result.reflectance import reflectance
from invrender.result.saved import SavedErrors, SavedModel, SavedPhoto, SavedResult
from invrender.result.saved_textures import SavedTextures, read_textures
from invrender.tables import html_list, html_table, text_table
from lightfactor.arguments import naming_arguments, with_arguments
from lightfactor.brdf import FittedBrdf, fitted_brdf
from lightfactor.light import FittedLight, fitted_lights

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]

_DEFAULT_VIEW = (0.0, 20.0)
_HEADINGS = ("parameter", "value ± std", "status")


class Fit:
    """Reflectance and light of an object, as `process` found them or `read_fit` read them back.

    Both behave alike: they show what result.json holds. A fresh fit keeps its files in a temporary folder, which goes
    when the fit does; `save` puts them into a folder of yours.
    """

    def __init__(self, saved: SavedResult, photoset: Path | None = None) -> None:
        self._saved = saved
        self._photoset = photoset

    @property
    def result(self) -> SavedResult:
        """The content of result.json, as the other modules take it."""
        return self._saved

    @property
    def photoset(self) -> Path | None:
        """The manifest of the set that it was made from; None where it is looked for around the folder."""
        return self._photoset

    @property
    def folder(self) -> Path:
        """Where its files lie."""
        return self._saved.folder

    @property
    def name(self) -> str:
        """The photo set's name."""
        return self._saved.content.name

    @property
    def gauge(self) -> str:
        """Which scale the numbers are in, in words."""
        return self._saved.content.gauge

    @property
    def is_absolute(self) -> bool:
        """Whether Kd and Ks are in the light's own scale, not up to a factor per channel."""
        return self._saved.is_absolute

    @cached_property
    def brdf(self) -> FittedBrdf:
        """The BRDF, each number with its standard deviation, status, reason and remedy."""
        return fitted_brdf(self._saved)

    @cached_property
    def textures(self) -> SavedTextures | None:
        """Maps of Kd and Ks where they vary over the surface, with their standard deviations; None where they don't."""
        ks = self.brdf.ks.value
        return read_textures(self._saved, np.zeros(3) if ks is None else np.asarray(ks))

    @cached_property
    def lightings(self) -> tuple[FittedLight, ...]:
        """The lightings, in the manifest's order."""
        return fitted_lights(self._saved)

    @property
    def photos(self) -> tuple[SavedPhoto, ...]:
        """The photographs with their errors, relative RMS, in the manifest's order."""
        return self._saved.content.photos

    @property
    def error(self) -> SavedErrors:
        """Errors over all photographs, relative RMS: `fitted`, `unseen`, `held_out`; None where there are none."""
        return self._saved.content.fit

    @property
    def models(self) -> tuple[SavedModel, ...]:
        """The candidate models with their evidence, the chosen one marked."""
        return self._saved.content.models

    @property
    def warnings(self) -> tuple[str, ...]:
        """What one should know before using the numbers, in sentences."""
        return self._saved.content.warnings

    @property
    def covariance_names(self) -> tuple[str, ...]:
        """The numbers that `covariance` is of: "kd.r", ..., "mu", "sigma", ..."""
        return self._saved.content.brdf.covariance.names

    @cached_property
    def covariance(self) -> Floats:
        """The covariance (n, n) of the numbers in `covariance_names`; NaN where none is known."""
        size = len(self.covariance_names)
        return np.array(self._saved.content.brdf.covariance.values, float).reshape(size, size)

    def save(self, folder: Path | str) -> Path:
        """Write what `lightfactor process` writes into a folder, and return it; an earlier result there is replaced.

        ValueError if the folder holds anything else, which would be lost.
        """
        out = Path(folder)
        with result_folder(out, RESULT_FILES) as place:
            for path in sorted(own for pattern in RESULT_FILES for own in self.folder.glob(pattern)):
                copy = shutil.copytree if path.is_dir() else shutil.copy2
                copy(path, place / path.name)
        return out

    @naming_arguments
    def render(
        self,
        view: Sequence[float] | None = None,
        *,
        photo: str | None = None,
        size: Sequence[int] | None = None,
        fov: float | None = None,
        lighting: str | None = None,
        light: Path | str | NDArray[np.floating] | None = None,
        panorama: bool = False,
        sources: Sequence[tuple[float, float, float | Sequence[float]]] = (),
        rotate_light: float = 0.0,
        mesh: Path | str | None = None,
        mesh_to_world: Path | str | None = None,
        radius: float | None = None,
        mean: bool = False,
        std: bool = False,
        preview: bool = False,
        tolerance: float | None = None,
        assume: Mapping[str, float] | None = None,
    ) -> Picture:
        """Predict a picture: `radiance` (h, w, 3), linear, `coverage` (h, w), `std` (h, w, 3) if asked for, `notes`.

        view : azimuth and elevation, degrees, and maybe the distance, metres; (0, 20) if nothing is given.
        photo : as this photograph was taken. size : width and height, pixels. fov : field of view, degrees.
        lighting : which of the fit's, by name. light : another, a lat-long map, (H, 2H, 3) or a file (`panorama`: as
            one sees it, left on the left). sources : (azimuth, elevation, irradiance) of distant sources, degrees, the
            irradiance one number or three. rotate_light : degrees about +Z.
        mesh, mesh_to_world, radius : another object: a mesh, and a file that places it; a sphere, metres.
        mean : of textures only their means. std : standard deviations, too, of Kd, Ks, mu and sigma, to first order.
        preview : quickly, by reflection maps; the last note says how far they are off.
        tolerance : percent RMS that interpolating what is reflected of a map may leave, 0.5 if nothing is given; 0
            integrates for each ray, slowly. The last note says what it left.
        assume : values of mu or sigma where they are undetermined.
        ValueError says what doesn't go together, or what the photographs left open.
        """
        if photo is not None and (view is not None or size is not None or fov is not None):
            raise ValueError("--photo is a whole camera: it excludes --view, --size and --fov")
        check_preview(preview, std)
        check_tolerance(tolerance, preview, std)
        own = own_lighting(self._saved, lighting, photo, light is None and not sources)
        light = Path(light) if isinstance(light, str) else light
        given = [_source(source) for source in sources]
        studio = photographer(
            self._saved,
            chosen_lighting(self._saved, own, light, given, panorama),
            self._photoset,
            assume,
            mean,
            _path(mesh),
            _path(mesh_to_world),
            radius,
        )
        notes = studio.notes
        if photo is not None:
            camera = studio.photo_camera(photo)
        else:
            wanted = view_of(_DEFAULT_VIEW if view is None else view)
            pixels = None if size is None else checked_size(size)
            camera = studio.camera(wanted, studio.optics(pixels, fov))
            notes += studio.made_up(wanted, pixels, fov)
        if preview:
            quick = previewer(studio)
            picture = quick.take(camera, rotate_light)
            notes += (quick.stated,)
        else:
            picture = studio.take(camera, rotate_light, std, tolerance)
            notes += interpolation_note([picture.interpolated])
        return replace(picture, notes=tuple(map(with_arguments, notes)))

    @naming_arguments
    def gradients(
        self, photo: str, *, pixels: int = 20_000, assume: Mapping[str, float] | None = None
    ) -> PhotoGradients:
        """Split the gradient of a predicted photograph into what makes it, as `lightfactor gradients` does.

        photo : by its file's name. pixels : about so many around the object, 100 or more. assume : as of `render`.
        `terms` and `difference` are radiance per pixel of the photograph, to the right and down, (n, 2, 3);
        `picture(values)` lays values (n, ...) of the pixels out. [RMB07, eq. 25.] ValueError says what was left open.
        """
        if pixels < 100:
            raise ValueError(f"--pixels is {pixels}; gradients need 100 pixels or more")
        own = own_lighting(self._saved, None, photo, True)
        lighting = self._saved.read_lighting(self._saved.lighting(own))
        studio = photographer(self._saved, lighting, self._photoset, assume)
        camera = studio.photo_camera(photo)
        return photo_gradients(studio.subject, camera, studio.material, light_element(lighting), pixels)

    def plot_gradients(self, photo: str) -> Figure:
        """What `gradients` of a photograph finds: prediction, gradient, terms, and where light counts as near."""
        return gradients_figure(photo, self.gradients(photo))

    def plot_lighting(self) -> Figure:
        """The lightings as lat-long maps with their sources, as the report has them."""
        return lighting_figure([light.as_fitted for light in self.lightings])

    def plot_errors(self) -> Figure:
        """The error of each photograph: fitted, unseen, held out, as the report has it."""
        if not self.photos:
            raise ValueError(f"{self._saved.path}: names no photographs whose errors could be drawn")
        return photo_error_figure(
            [
                PhotoScore(
                    label=photo.file,
                    lighting=photo.lighting or "",
                    held_out=photo.held_out,
                    samples=photo.samples,
                    rms=photo.rms_relative,
                    cross_validated=photo.cross_validated_rms_relative,
                )
                for photo in self.photos
            ]
        )

    @naming_arguments
    def plot_brdf(self, assume: Mapping[str, float] | None = None) -> Figure:
        """BRDF times cosine over the angle of incidence, with bands of one standard deviation."""
        return brdf_figure(self.name, reflectance(self._saved, assume or {}))

    def __repr__(self) -> str:
        return "\n".join([self._title(), text_table(_HEADINGS, self._table()), *self._lines()])

    def _repr_html_(self) -> str:
        """For notebooks."""
        return html_list([self._title()]) + html_table(_HEADINGS, self._table()) + html_list(self._lines())

    def _title(self) -> str:
        chosen = [model.name for model in self.models if model.chosen]
        return f"{self.name}: {chosen[0] if chosen else self.brdf.model}"

    def _table(self) -> list[tuple[str, str, str]]:
        return [
            (*line, number.status) for number in self.brdf.shown for line in number.lines(self.is_absolute)
        ]

    def _lines(self) -> list[str]:
        kinds = (
            ("fitted", self.error.fitted),
            ("unseen", self.error.unseen),
            ("held out", self.error.held_out),
        )
        errors = ", ".join(f"{error:.2%} {kind}" for kind, error in kinds if error is not None)
        lines = [f"Error on photographs (relative RMS): {errors}."] if errors else []
        why: dict[tuple[str, str], list[str]] = {}
        for number in self.brdf.shown:
            if number.reason:
                why.setdefault((number.reason, number.remedy), []).append(number.name)
        lines += [
            f"{', '.join(names)}: {reason}. To settle it: {remedy}."
            for (reason, remedy), names in why.items()
        ]
        return [f"Scale: {self.gauge}.", *lines, *(f"Warning: {text}" for text in self.warnings)]


def _source(source: Sequence[Any]) -> tuple[Floats, Floats]:
    if len(source) != 3:
        raise ValueError(f"sources: {source} can't be read; give (azimuth, elevation, irradiance) of each")
    return distant_source(*source)


def _path(path: Path | str | None) -> Path | None:
    return None if path is None else Path(path)
