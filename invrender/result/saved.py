"""A result folder as it is read back: `result.json`, checked, and the maps beside it."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field

from capture.files.documents import read_json
from capture.files.imagefile import read_pixels
from capture.files.tables import LenientTable
from capture.lighting import Lighting, check_latlong
from invrender.brdf.brushed import FACETS, brushed
from invrender.brdf.form import Axis, LobeForm
from invrender.brdf.lobes import FORMS, PLASTICS, RH01_FORM, UNCORRELATED
from invrender.brdf.richer import RICHER
from invrender.estimate.evidence import MISFIT_REMEDY

RESULT_NAME = "result.json"
_MANIFEST_NAME = "photoset.toml"
_WHAT = "a result.json, as `lightfactor process` writes it, holds brdf, object, lighting and photos"
_KEYS = ("format", "name", "gauge", "brdf", "object", "lighting", "photos", "identifiability", "inputs")
_OPTIONAL = (
    "texture",
    "interreflection",
    "polarisation",
    "references",
    "fit",
    "models",
    "warnings",
    "cameras",
    "settings",
    "software",
)

# For whether a form's name is known, whatever it is brushed about.
_ANY_AXIS = (0.0, 0.0, 1.0)
_Triple = tuple[float, float, float]
_Row = tuple[float, float, float, float]


class _Kind(LenientTable):
    """What a result is of, where it isn't of a body."""

    kind: str | None = None


class SavedQuantity(LenientTable):
    """A number, or one per channel; `value` is None where it is undetermined.

    variance_shares : what each cause has of its variance (`quantities.CAUSES`); empty where nobody split it.
    """

    value: float | _Triple | None
    std: float | _Triple | None
    status: str
    variance_shares: dict[str, float] = Field(default_factory=dict)


class _Shares(LenientTable):
    kd: SavedQuantity | None
    ks: SavedQuantity | None


class _Covariance(LenientTable):
    names: tuple[str, ...]
    values: tuple[tuple[float | None, ...], ...]


def _is_known(model: str) -> str:
    saved_form(model, axis=_ANY_AXIS)
    return model


class SavedBrdf(LenientTable):
    """The BRDF's numbers; None where the chosen model has no such parameter.

    model : the name of the lobe's form, or "lambertian". specular : "neutral", "coloured", or None where undetermined.
    form_numbers : the form's own (a coat, a haze), if it has any, and what follows from them. brushed_about : the axis
    of a brushed form. exponent : Phong's. albedo : pi Kd.
    """

    model: Annotated[str, AfterValidator(_is_known)]
    kd: SavedQuantity
    ks: SavedQuantity | None
    mu: SavedQuantity | None
    sigma: SavedQuantity | None
    specular: str | None = None
    exponent: SavedQuantity | None = None
    form_numbers: dict[str, SavedQuantity] = Field(default_factory=dict)
    brushed_about: Axis | None = None
    albedo: SavedQuantity | None = None
    normalised: _Shares
    covariance: _Covariance

    @property
    def form(self) -> LobeForm:
        """The form of the lobe with its own numbers."""
        values = {
            name: float(np.mean(np.array(number.value, float))) for name, number in self.form_numbers.items()
        }
        return saved_form(self.model, values, self.brushed_about)


class _Object(LenientTable):
    """A sphere, or a mesh with the sphere that holds it; the mesh itself lies in the photo set."""

    shape: Literal["sphere", "mesh"] = "sphere"
    centre: _Triple
    radius: float
    mesh_to_world: tuple[_Row, _Row, _Row, _Row] | None = None


class _Texture(LenientTable):
    """Where Kd and Ks vary.

    kd, kd_std, ks, ks_std : the files beside result.json, None for what doesn't vary. known : the share of the surface
    where the photographs determine them. mesh : beside result.json, too, the object with the texture coordinates that
    were made for it.
    """

    kd: str | None = None
    kd_std: str | None = None
    ks: str | None = None
    ks_std: str | None = None
    at: Literal["texels", "vertices"] = "texels"
    known: float = 1.0
    mesh: str | None = None

    @property
    def files(self) -> tuple[str, ...]:
        """All that it names."""
        named = (self.kd, self.kd_std, self.ks, self.ks_std, self.mesh)
        return tuple(name for name in named if name is not None)


class _Bounces(LenientTable):
    """Light that bounces between the object's parts.

    taken_off : whether Kd and Ks are without it. albedo : of Kd and Ks that are known up to a scale.
    """

    taken_off: bool
    albedo: _Triple | None = None


class _Source(LenientTable):
    direction: _Triple
    irradiance: _Triple
    irradiance_std: tuple[float | None, float | None, float | None]
    position: _Triple | None = None


class _Coefficients(LenientTable):
    value: tuple[_Triple, ...]


class SavedLighting(LenientTable):
    """A lighting; `sh` are its first nine coefficients, `map` the file beside result.json.

    recovered : what of it was fitted: "irradiance", "ambient", "direction", "distance", "scale", "all". centre : (3,)
    metres, the object's, from which near sources are seen; None where all are far away.
    """

    name: str
    recovered: tuple[str, ...] = ()
    sh: _Coefficients
    directional: tuple[_Source, ...]
    map: str
    centre: _Triple | None = None

    @property
    def irradiance_std(self) -> NDArray[np.float64]:
        """Standard deviations (k, 3) of the sources' irradiances; 0 where given, NaN where unknown."""
        return np.array([source.irradiance_std for source in self.directional], float).reshape(-1, 3)


class SavedPhoto(LenientTable):
    """A photograph, the name of its lighting, and how well it is explained, relative RMS.

    samples : how many of its pixels were used. cross_validated_rms_relative : its error by a fit that has not seen it;
    None for one that is held out, whose rms_relative is just that.
    """

    file: str
    lighting: str | None = None
    held_out: bool
    samples: int = 0
    rms_relative: float
    cross_validated_rms_relative: float | None = None


class SavedErrors(LenientTable):
    """Relative RMS, means over photographs, None where there are none of the kind.

    fitted : of those in the fit. unseen : of each of them by a fit that has not seen it. held_out : of those never
    fitted. structured : the part that isn't noise.
    """

    fitted: float | None = Field(default=None, alias="rms_relative")
    unseen: float | None = Field(default=None, alias="cross_validated_rms_relative")
    held_out: float | None = Field(default=None, alias="held_out_rms_relative")
    structured: float | None = Field(default=None, alias="structured_rms_relative")


class SavedModel(LenientTable):
    """A candidate model. parameters : how many numbers were fitted. unseen : relative RMS on unseen photographs."""

    name: str
    parameters: int
    unseen: float = Field(alias="cross_validated_rms_relative")
    standard_error: float | None = None
    chosen: bool


class SavedFinding(LenientTable):
    """Why a parameter isn't determined, and what would settle it; empty where it is."""

    parameter: str
    reason: str
    remedy: str


class _Result(LenientTable):
    format: int
    name: str
    gauge: str
    brdf: SavedBrdf
    object: _Object
    texture: _Texture | None = None
    lighting: tuple[SavedLighting, ...]
    interreflection: _Bounces | None = None
    references: tuple[Any, ...] = ()
    fit: SavedErrors = SavedErrors()
    photos: tuple[SavedPhoto, ...]
    models: tuple[SavedModel, ...] = ()
    warnings: tuple[str, ...] = ()
    identifiability: tuple[SavedFinding, ...]
    inputs: dict[str, str]
    cameras: str | None = None
    settings: dict[str, Any] | None = None
    software: dict[str, str] | None = None


@dataclass(frozen=True, eq=False)
class SavedResult:
    """A result that was read back. path : its result.json; content : what that holds."""

    path: Path
    content: _Result

    @property
    def folder(self) -> Path:
        return self.path.parent

    @property
    def is_absolute(self) -> bool:
        """Whether Kd and Ks are in the lighting's own scale, not up to a factor per channel."""
        return self.content.gauge.startswith("absolute")

    @property
    def bounces(self) -> bool:
        """Whether light that parts of an object send each other adds to what Kd and Ks predict.

        Not where the albedo was undetermined while it was fitted, as it is where references fix it afterwards, nor
        where photographs spoke against taking it off: they hold it.
        """
        found = self.content.interreflection
        if found is None:
            return self.is_absolute and not self.content.references
        return found.taken_off and (self.is_absolute or found.albedo is not None)

    @property
    def albedo(self) -> NDArray[np.float64] | None:
        """The albedo (3,) that bounced light was taken off with where Kd and Ks don't fix it."""
        found = self.content.interreflection
        return None if found is None or found.albedo is None else np.array(found.albedo)

    @property
    def label(self) -> str:
        return self.folder.resolve().name

    @property
    def misfits(self) -> bool:
        """Whether even the best model explains so little that no number is given."""
        return any(entry.remedy == MISFIT_REMEDY for entry in self.content.identifiability)

    def finding(self, parameter: str) -> SavedFinding:
        """What identifiability says of a parameter; empty words where it says nothing."""
        found = (entry for entry in self.content.identifiability if entry.parameter == parameter)
        return next(found, SavedFinding(parameter=parameter, reason="", remedy=""))

    def lighting(self, name: str | None) -> SavedLighting:
        """The lighting of a name, or the only one; ValueError names those that there are."""
        entries = self.content.lighting
        names = [entry.name for entry in entries]
        if name is None:
            if len(entries) != 1:
                raise ValueError(
                    f"{self.path}: holds {len(entries)} lightings: choose one with --lighting:"
                    f" {', '.join(map(repr, names))}"
                )
            return entries[0]
        if name not in names:
            raise ValueError(f"{self.path}: has no lighting {name!r}; {nearest(name, names)}")
        return entries[names.index(name)]

    def read_lighting(self, entry: SavedLighting) -> Lighting:
        """A lighting as the fit left it: the map beside result.json, recovered ambient included, and the sources."""
        path = self.folder / entry.map
        radiance = read_pixels(path).astype(np.float32)
        check_latlong(radiance, str(path))
        centre, closeness = np.zeros(3), None
        if entry.centre is not None:
            centre = np.array(entry.centre)
            closeness = np.array(
                [
                    0 if source.position is None else 1 / np.linalg.norm(np.array(source.position) - centre)
                    for source in entry.directional
                ]
            )
        return Lighting(
            entry.name,
            radiance if radiance.any() else None,
            np.array([source.direction for source in entry.directional]).reshape(-1, 3),
            np.array([source.irradiance for source in entry.directional]).reshape(-1, 3),
            origin=str(path),
            closeness=closeness,
            centre=centre,
        )


def read_result(path: Path) -> SavedResult:
    """A result from its folder, or its result.json; ValueError says what is wrong and what to give instead."""
    if not path.exists():
        raise ValueError(
            f"{path}: does not exist; give the folder that `lightfactor process` wrote, or its {RESULT_NAME}"
        )
    if path.is_dir():
        if not (path / RESULT_NAME).is_file():
            is_set = (path / _MANIFEST_NAME).is_file()
            remedy = (
                f"it is a photo set: `lightfactor process {path} -o RESULT` first"
                if is_set
                else "give the folder that `lightfactor process` wrote"
            )
            raise ValueError(f"{path}: holds no {RESULT_NAME}; {remedy}")
        path = path / RESULT_NAME
    kind = result_kind(path)
    if kind is not None:
        raise ValueError(
            f"{path}: is a result of {kind}, of normals without a body; `lightfactor integrate` makes a mesh of it:"
            " process a set with shape = 'mesh' and give that result"
        )
    return SavedResult(path, read_json(path, _Result, _KEYS, _WHAT, optional=_OPTIONAL))


def result_kind(path: Path) -> str | None:
    """What a result.json, or the one of a folder, is of, where it isn't of a body; else None."""
    path = path / RESULT_NAME if path.is_dir() else path
    return read_json(path, _Kind, (), _WHAT, optional=("kind",)).kind if path.is_file() else None


def saved_form(
    model: str, numbers: Mapping[str, float] = MappingProxyType({}), axis: Axis | None = None
) -> LobeForm:
    """The form of the lobe of a result's brdf.model; of a Lambertian one RH01's, which then stands for none.

    numbers : the form's own, by name; what it has and isn't given is at its usual value. axis : of a brushed one.
    """
    if model == "lambertian":
        return RH01_FORM
    forms = FORMS | RICHER | {form.name: form for form in (*PLASTICS.values(), *UNCORRELATED.values())}
    if axis is not None:
        forms |= {form.name: form for form in (brushed(of, axis) for of in FACETS)}
    if model not in forms:
        raise ValueError(
            f"the form {model!r} of the lobe is unknown; {nearest(str(model), ['lambertian', *forms])}"
        )
    return forms[model].with_numbers(numbers)


def nearest(name: str, names: Iterable[str]) -> str:
    """The end of a sentence about a name that doesn't exist: the nearest one, or all there are."""
    names = list(names)
    near = difflib.get_close_matches(name, names, n=1, cutoff=0.5)
    return f"did you mean {near[0]!r}?" if near else f"there are {', '.join(map(repr, names)) or 'none'}"
