"""The schema of scene files: small TOML tables that say what is photographed, under which light, from where."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from capture.files.tables import Table, validated

Vector3 = tuple[float, float, float]
Matrix4 = tuple[tuple[float, float, float, float], ...]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0, le=1)]


def _grey(value: Any) -> Any:
    """One number counts for all channels."""
    return (float(value),) * 3 if isinstance(value, int | float) and not isinstance(value, bool) else value


Rgb = Annotated[Vector3, BeforeValidator(_grey)]


class ObjectTable(Table):
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
    def _keys_of_the_shape(self) -> ObjectTable:
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
    "phong": (("exponent",), ()),
    "mirror": ((), ("mu",)),
    "table": (("file",), ()),
}


class MaterialTable(Table):
    model: Literal["lambertian", "microfacet", "smith", "ggx", "anisotropic", "phong", "mirror", "table"] = (
        "microfacet"
    )
    # A sphere of RH01, Fig. 11, instead of the parameters.
    name: Literal["teflon", "delrin", "neoprene", "steel", "bronze", "painted"] | None = None
    kd: Rgb | None = None
    ks: Rgb | None = None
    mu: Annotated[float, Field(gt=1)] | None = None
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
        needed += () if self.model == "table" else ("kd",) if self.model == "lambertian" else ("kd", "ks")
        for key in sorted(given - {*needed, *possible}):
            raise ValueError(
                f"{key} is no parameter of model = {self.model!r}, which has {', '.join((*needed, *possible))}"
            )
        for key in needed:
            if getattr(self, key) is None:
                raise ValueError(f"lacks the key {key!r}, which model = {self.model!r} needs")
        return self


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
    width_deg: Positive = 20.0


class SourceTable(Towards):
    irradiance: Rgb
    radius_deg: Annotated[float, Field(gt=0, lt=90)] | None = None


class LampTable(Towards):
    # At the object's centre, as if it were a distant source's.
    irradiance: Rgb
    distance: Positive


class LightingTable(Table):
    name: str = "lighting"
    area: tuple[AreaTable, ...] = ()
    directional: tuple[SourceTable, ...] = ()
    lamp: tuple[LampTable, ...] = ()
    map: str | None = None
    map_scale: Positive = 1.0
    # What the photo set tells of it.
    given: Literal["all", "ball", "nothing"] = "all"

    @model_validator(mode="after")
    def _some_light(self) -> LightingTable:
        if not (self.area or self.directional or self.lamp or self.map):
            raise ValueError("has no light: give area, directional, lamp or map")
        if self.map is None and "map_scale" in self.model_fields_set:
            raise ValueError("map_scale is for a map: remove it, or give map")
        return self


class CameraTable(Table):
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


class GantryTable(PathTable):
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
    bracket_stops: tuple[float, ...] | None = None

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

    pose_deg: NotNegative = 0.0
    pose_m: NotNegative = 0.0
    mesh_m: NotNegative = 0.0
    mesh_correlation_m: Positive = 0.003
    misaligned_deg: NotNegative = 0.0
    misaligned_m: NotNegative = 0.0
    background: Literal["black", "room"] | Vector3 = "black"
    outliers: Share = 0.0


class EffortTable(Table):
    directions: int = 512
    per_side: int = 4
    bounces: int = 0
    paths: int = 4


class BallTable(Table):
    radius: Positive = 0.02
    # Where it is photographed from, around the object's place; two views see all around.
    azimuths_deg: tuple[float, ...] = (0.0, 90.0)
    elevation_deg: Annotated[float, Field(gt=-90, lt=90)] = 0.0
    distance: Positive = 0.6


class CalibrationTable(Table):
    """Photographs to calibrate the camera by: of a board, a bracket, repeats, an even wall."""

    # As `lightfactor board` has it.
    board: str = "charuco:10x7:0.030:0.022:DICT_5X5_100"
    boards: Annotated[int, Field(ge=3, le=1000)] = 12


class SceneFile(Table):
    format: Literal[1]
    name: str
    description: str = ""
    seed: Annotated[int, Field(ge=0)] = 0
    object: ObjectTable
    material: MaterialTable | None = None
    lighting: tuple[LightingTable, ...]
    camera: CameraTable
    gantry: GantryTable | None = None
    turntable: TurntableTable | None = None
    view: tuple[ViewTable, ...] = ()
    sensor: SensorTable = SensorTable()
    faults: FaultsTable = FaultsTable()
    render: EffortTable = EffortTable()
    mirror_ball: BallTable | None = None
    calibration: CalibrationTable | None = None

    @model_validator(mode="after")
    def _whole(self) -> SceneFile:
        if not (self.gantry or self.turntable or self.view):
            raise ValueError("has no photographs: give [gantry], [turntable] or [[view]] tables")
        if not self.lighting:
            raise ValueError("has no light: give a [[lighting]] table")
        names = [table.name for table in self.lighting]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"two [[lighting]] tables are named {name!r}; names must differ")
        for path in (self.gantry, self.turntable, *self.view):
            if path and path.lighting is not None and path.lighting not in names:
                raise ValueError(
                    f"names a lighting {path.lighting!r}; there are {', '.join(map(repr, names))}"
                )
        if self.calibration is not None and self.sensor.file == "exr":
            raise ValueError(
                "[calibration] photographs are a camera's, but the sensor writes EXR: give [sensor] file = 'png', ..."
            )
        if any(table.given == "ball" for table in self.lighting) and self.mirror_ball is None:
            raise ValueError("gives a lighting by 'ball': add a [mirror_ball] table")
        if self.material is None and self.object.shape != "doll":
            raise ValueError("lacks the table [material]; only the doll brings its own, painted")
        return self


def read_scene_file(path: Path) -> SceneFile:
    """Parse and validate a scene file; ValueError names file, key and remedy."""
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror or error})") from error
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ValueError(f"{path}: is not valid TOML: {error}") from error
    return validated(SceneFile, path, data)
