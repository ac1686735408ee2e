"""The tables of scene files: what is photographed, under which light, from where, and by which camera."""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from capture.boards.board import parse_board
from capture.files.tables import Table

Vector3 = tuple[float, float, float]
Matrix4 = tuple[tuple[float, float, float, float], ...]
# Beyond these bounds no quantity of a scene makes sense, and arithmetic overflows.
Positive = Annotated[float, Field(ge=1e-12, le=1e12)]
NotNegative = Annotated[float, Field(ge=0, le=1e12)]
Degrees = Annotated[float, Field(ge=0, le=180)]
Stop = Annotated[float, Field(ge=-30, le=30)]
_BRIGHTEST = 1e12
_FILE_NAME = re.compile(r"[\w.+-][\w.+ -]*")


def _rgb(value: Any) -> Any:
    """Three channels, of which one number gives all."""
    channels = value if isinstance(value, tuple) else (value,) * 3
    numbers = [entry for entry in channels if isinstance(entry, int | float) and not isinstance(entry, bool)]
    if len(channels) != 3 or len(numbers) != 3 or not all(0 <= number <= _BRIGHTEST for number in numbers):
        raise ValueError(f"is {_shown(value)}: give one number >= 0, or three, [red, green, blue]")
    return tuple(map(float, numbers))


def _background(value: Any) -> Any:
    if isinstance(value, str) and value not in ("black", "room"):
        raise ValueError(f"is {value!r}: give 'black', 'room', or a radiance, [red, green, blue]")
    return value if isinstance(value, str) else _rgb(value)


def _shown(value: Any) -> str:
    """As TOML writes it."""
    return repr(list(value) if isinstance(value, tuple) else value)


Rgb = Annotated[Vector3, BeforeValidator(_rgb)]


def _in_file_name(name: str) -> str:
    if not _FILE_NAME.fullmatch(name):
        raise ValueError(
            f"is {name!r}, but names files: write it with letters, digits, spaces and . _ + - only"
        )
    return name


class SceneObject(Table):
    shape: Literal["sphere", "cat", "doll", "mesh"]
    centre: Vector3 = (0.0, 0.0, 0.0)
    # Spheres only.
    radius: Positive = 0.02
    # The set says where the sphere is, instead of leaving that to its outline.
    stated: bool = False
    # Cat and doll: the length of the mesh's edges.
    edge: Positive | None = None
    # Cat: texture coordinates, which take seconds to find.
    atlas: bool = True
    # Meshes only.
    mesh: str | None = None
    unit: Literal["m", "cm", "mm"] = "m"

    @model_validator(mode="after")
    def _keys_of_the_shape(self) -> SceneObject:
        owners = {
            "radius": ("sphere",),
            "stated": ("sphere",),
            "edge": ("cat", "doll"),
            "atlas": ("cat",),
            "mesh": ("mesh",),
            "unit": ("mesh",),
        }
        for key, shapes in owners.items():
            if key in self.model_fields_set and self.shape not in shapes:
                raise ValueError(f"{key} is for shape = {' or '.join(map(repr, shapes))}: remove it")
        if self.shape == "mesh" and self.mesh is None:
            raise ValueError("lacks the key 'mesh': the file of the mesh, PLY, OBJ, STL or GLB")
        return self


# The parameters of each model besides kd and ks; those in brackets may be missing.
_PARAMETERS = {
    "lambertian": ((), ()),
    "microfacet": (("sigma",), ("mu",)),
    "smith": (("sigma",), ("mu",)),
    "ggx": (("alpha",), ("mu",)),
    "anisotropic": (("alpha_x", "alpha_y"), ("mu",)),
    "plastic": (("mu",), ("sigma", "alpha")),
    "phong": (("exponent",), ()),
    "mirror": ((), ("mu",)),
    "table": (("file",), ()),
}


class MaterialTable(Table):
    model: Literal[
        "lambertian", "microfacet", "smith", "ggx", "anisotropic", "plastic", "phong", "mirror", "table"
    ] = "microfacet"
    # A sphere of RH01, Fig. 11, instead of the parameters.
    name: Literal["teflon", "delrin", "neoprene", "steel", "bronze", "painted"] | None = None
    kd: Rgb | None = None
    ks: Rgb | None = None
    mu: Annotated[float, Field(gt=1, le=1000)] | None = None
    sigma: Positive | None = None
    alpha: Positive | None = None
    alpha_x: Positive | None = None
    alpha_y: Positive | None = None
    exponent: Positive | None = None
    file: str | None = None

    @model_validator(mode="after")
    def _parameters_of_the_model(self) -> MaterialTable:
        given = self.model_fields_set - {"model", "name"}
        if self.name is not None:
            if self.model not in ("microfacet", "smith"):
                raise ValueError(
                    f"name = {self.name!r} is a sphere of RH01, for model = 'microfacet' or 'smith', not {self.model!r}"
                )
            if given:
                raise ValueError(f"name and {min(given)} both give the material: remove one of them")
            return self
        needed, possible = _PARAMETERS[self.model]
        for key in sorted(given - {*self._weights, *needed, *possible}):
            parameters = ", ".join((*self._weights, *needed, *possible))
            raise ValueError(f"{key} is no parameter of model = {self.model!r}, which has {parameters}")
        self._check_given(needed)
        if self.model == "plastic" and (self.sigma is None) == (self.alpha is None):
            raise ValueError(
                "model = 'plastic' needs sigma, of facets as 'smith' has them, or alpha, as 'ggx' does: one of the two"
            )
        return self

    @property
    def _weights(self) -> tuple[str, ...]:
        if self.model == "table":
            return ()
        return ("kd",) if self.model == "lambertian" else ("kd", "ks")

    def check_weights(self, painted: bool) -> None:
        """ValueError if kd and ks are missing; or, of an object on which they are painted, if they are given."""
        if not painted and self.name is None:
            self._check_given(self._weights)
        if painted and (given := self.model_fields_set & {"name", "kd", "ks", "file"}):
            raise ValueError(f"has {min(given)} in [material], but the doll is painted: remove it")
        if painted and self.model == "plastic":
            raise ValueError(
                "has model = 'plastic', whose base can't be painted as the doll is: take another"
            )

    def _check_given(self, keys: tuple[str, ...]) -> None:
        for key in keys:
            if getattr(self, key) is None:
                raise ValueError(f"lacks the key {key!r}, which model = {self.model!r} needs")


class Towards(Table):
    """A direction from the object: three numbers, or angles from +X towards +Y and above the horizon."""

    direction: Vector3 | None = None
    azimuth_deg: float | None = None
    elevation_deg: float = 0.0

    @model_validator(mode="after")
    def _one_direction(self) -> Towards:
        angles = self.model_fields_set & {"azimuth_deg", "elevation_deg"}
        if (self.direction is None) == (self.azimuth_deg is None) or (self.direction and angles):
            raise ValueError("needs direction, or azimuth_deg with elevation_deg: one of the two")
        return self


class AreaTable(Towards):
    radiance: Rgb
    # RH01's projection screen: 99% of its energy in degrees l <= 6.
    width_deg: Annotated[float, Field(ge=0.01, le=1e6)] = 20.0


class SceneSource(Towards):
    irradiance: Rgb
    radius_deg: Annotated[float, Field(ge=0.001, lt=90)] | None = None


class LampTable(Towards):
    # At the object's centre, as if it were a distant source's.
    irradiance: Rgb
    distance: Positive


class SceneLighting(Table):
    name: Annotated[str, AfterValidator(_in_file_name)] = "lighting"
    area: tuple[AreaTable, ...] = ()
    directional: tuple[SceneSource, ...] = ()
    lamp: tuple[LampTable, ...] = ()
    map: str | None = None
    map_scale: Positive = 1.0
    # What the photo set gives of it; "distant": lamps as they look from the object's centre, all else.
    given: Literal["all", "distant", "ball", "nothing"] = "all"

    @model_validator(mode="after")
    def _some_light(self) -> SceneLighting:
        if not (self.area or self.directional or self.lamp or self.map):
            raise ValueError("has no light: give area, directional, lamp or map")
        if self.map is None and "map_scale" in self.model_fields_set:
            raise ValueError("map_scale is for a map: remove it, or give map")
        return self


class SceneCamera(Table):
    width: Annotated[int, Field(gt=0, le=20000)] = 320
    height: Annotated[int, Field(gt=0, le=20000)] = 240
    focal_px: Positive
    # The middle of the picture, if not given.
    principal_point: tuple[float, float] | None = None
    # OpenCV's k1, k2, p1, p2.
    distortion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)


class PathTable(Table):
    lighting: str | None = None
    photos: Annotated[int, Field(gt=0, le=10000)] = 60
    held_out: tuple[Annotated[int, Field(ge=0)], ...] = ()

    @model_validator(mode="after")
    def _held_out_exist(self) -> PathTable:
        for number in self.held_out:
            if number >= self.photos:
                raise ValueError(
                    f"held_out names photograph {number}, counted from 0, but there are {self.photos}"
                )
        return self


class SceneGantry(PathTable):
    """A camera on an arc that looks at its centre, as RH01's."""

    radius: Positive = 0.6
    axis: Vector3 = (0.0, 0.0, 1.0)
    start: Vector3 = (1.0, 0.0, 0.0)
    centre: Vector3 = (0.0, 0.0, 0.0)
    start_deg: float = 0.0
    step_deg: float = 3.0


class TurntableTable(PathTable):
    """An object that turns counter-clockwise about +Z before a camera at rest, under lights at rest."""

    distance: Positive = 0.6
    azimuth_deg: float = 0.0
    elevation_deg: Annotated[float, Field(gt=-90, lt=90)] = 20.0
    step_deg: float = 6.0


class ViewTable(Table):
    """One photograph."""

    azimuth_deg: float | None = None
    elevation_deg: Annotated[float, Field(gt=-90, lt=90)] = 0.0
    distance: Positive = 0.6
    world_to_camera: Matrix4 | None = None
    lighting: str | None = None
    held_out: bool = False

    @model_validator(mode="after")
    def _one_place(self) -> ViewTable:
        angles = self.model_fields_set & {"azimuth_deg", "elevation_deg", "distance"}
        if (self.azimuth_deg is None) == (self.world_to_camera is None) or (self.world_to_camera and angles):
            raise ValueError(
                "needs azimuth_deg (elevation_deg, distance), or world_to_camera: one of the two"
            )
        return self


class SensorTable(Table):
    """The ideal sensor writes linear EXR with Gaussian noise; the others are a camera's."""

    file: Literal["exr", "png", "tiff", "jpeg", "dng"] = "exr"
    # EXR only: shares of the pixel's own radiance, and of the object's mean.
    noise: NotNegative = 0.01
    floor: NotNegative = 0.001
    # Cameras only.
    bits: Literal[8, 12, 14, 16] | None = None
    response: Literal["linear", "srgb", "gamma", "film"] | None = None
    full_well: Positive | None = None
    read_noise: NotNegative | None = None
    vignetting: bool = False
    demosaic: bool = False
    exposure_s: Positive | None = None
    saturated: Annotated[float, Field(ge=0, lt=1)] | None = None
    bracket_stops: tuple[Stop, ...] | None = None

    @model_validator(mode="after")
    def _keys_of_the_file(self) -> SensorTable:
        ideal = {"noise", "floor"}
        wrong = (
            self.model_fields_set
            - {"file"}
            - (ideal if self.file == "exr" else set(type(self).model_fields) - ideal)
        )
        if wrong:
            what = (
                "the ideal sensor's, for file = 'exr'"
                if min(wrong) in ideal
                else "a camera's: give file = 'png', ..."
            )
            raise ValueError(f"{min(wrong)} is {what}, but file is {self.file!r}")
        if self.exposure_s is not None and self.saturated is not None:
            raise ValueError("exposure_s and saturated both give the exposure: remove one of them")
        return self


class FaultsTable(Table):
    """What real captures get wrong; the photo set doesn't know of it, truth.json does. Standard deviations."""

    pose_deg: Degrees = 0.0
    pose_m: NotNegative = 0.0
    mesh_m: NotNegative = 0.0
    mesh_correlation_m: Positive = 0.003
    misaligned_deg: Degrees = 0.0
    misaligned_m: NotNegative = 0.0
    # "black", "room", or radiance; a union would lose its place in error messages.
    background: Annotated[Any, BeforeValidator(_background)] = "black"
    outliers: Annotated[float, Field(ge=0, lt=1)] = 0.0


class EffortTable(Table):
    directions: int = 1024
    per_side: int = 4
    bounces: int = 0


class BallTable(Table):
    # As large as the object, if not given.
    radius: Positive | None = None
    # Where it is photographed from, around the object's place; two views see all around.
    azimuths_deg: tuple[float, ...] = (0.0, 90.0)
    elevation_deg: Annotated[float, Field(gt=-90, lt=90)] = 0.0
    distance: Positive = 0.6


def _board(text: str) -> str:
    parse_board(text)
    return text


class CalibrationTable(Table):
    """Photographs to calibrate the camera by: of a board, a bracket, repeats, an even wall."""

    # As `lightfactor board` has it.
    board: Annotated[str, AfterValidator(_board)] = "charuco:10x7:0.030:0.022:DICT_5X5_100"
    boards: Annotated[int, Field(ge=3, le=1000)] = 12
