"""The schema of `photoset.toml`."""

from __future__ import annotations

import os
import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from capture.files.tables import Matrix4, NotNegative, Positive, Reflectance, Table, Vector3, validated
from capture.referencetable import ReferenceTable

# The fewest pixels of all photographs that a texture is solved from.
_FEWEST_PIXELS = 1000
# What of a lighting isn't known and is recovered with the BRDF.
Recoverable = Literal["irradiance", "ambient"]
# How the camera's filter was turned, to that of the lamps.
Polarisation = Literal["cross", "parallel"]


class CameraTable(Table):
    file: str | None = None
    model: str | None = None
    params: tuple[float, ...] | None = None
    width: int | None = None
    height: int | None = None


class RadiometryTable(Table):
    encoding: Literal["linear", "srgb", "response"] = "linear"
    file: str | None = None
    exposure: Literal["equal", "exif", "manual"] = "equal"
    noise: str | None = None
    flat_field: str | None = None
    # "none", "camera", "reference" or three factors; a union would lose its place in error messages.
    white_balance: Any = "none"
    color: str | None = None

    @model_validator(mode="after")
    def _consistent(self) -> RadiometryTable:
        if self.color is not None and self.white_balance != "none":
            raise ValueError(
                f"color balances white already, but white_balance is {self.white_balance!r}: remove one of them"
            )
        if self.file is not None and self.encoding != "response":
            raise ValueError(
                f"file is for encoding = 'response', but that is {self.encoding!r}: remove one of them"
            )
        factors = self.white_balance
        numbers = isinstance(factors, tuple) and all(
            isinstance(factor, int | float) and 0 < factor < float("inf") for factor in factors
        )
        if factors not in ("none", "camera", "reference") and not (numbers and len(factors) == 3):
            raise ValueError(
                f"white_balance is {factors!r}: give 'none', 'camera', 'reference', or factors [red, green, blue]"
                " above 0"
            )
        if self.file is None and self.encoding == "response":
            raise ValueError("encoding = 'response' needs file = the response.json that holds the curve")
        return self


class ObjectTable(Table):
    shape: Literal["sphere", "mesh", "normals"] = "sphere"
    centre: Vector3 | None = None
    radius: Positive | None = None
    mesh: str | None = None
    unit: Literal["m", "cm", "mm"] = "m"
    mesh_to_world: Matrix4 | None = None
    align: str | None = None
    # The file of a normal map, or "unknown".
    normals: str | None = None
    texture: bool = False
    texture_pixels: Annotated[int, Field(ge=0)] | None = None
    brushed_about: Vector3 | None = None

    @model_validator(mode="after")
    def _brushed_sphere(self) -> ObjectTable:
        if self.brushed_about is not None and self.shape != "sphere":
            raise ValueError("brushed_about is for shape = 'sphere': a mesh has no tangents; remove the key")
        if self.brushed_about is not None and not any(self.brushed_about):
            raise ValueError("brushed_about is [0, 0, 0]; give the axis of the circles of brushing")
        return self

    @model_validator(mode="after")
    def _pixels_of_a_texture(self) -> ObjectTable:
        if self.texture_pixels is not None and not self.texture:
            raise ValueError("texture_pixels is for texture = true: write that, too, or remove the key")
        if self.texture_pixels and self.texture_pixels < _FEWEST_PIXELS:
            raise ValueError(
                f"texture_pixels is {self.texture_pixels}; give {_FEWEST_PIXELS} or more, or 0 for all pixels"
            )
        return self

    @model_validator(mode="after")
    def _keys_of_the_shape(self) -> ObjectTable:
        owners = dict.fromkeys(("mesh", "mesh_to_world", "align"), "mesh") | {"normals": "normals"}
        for key, shape in owners.items():
            if self.shape != shape and getattr(self, key) is not None:
                raise ValueError(
                    f"{key} is for shape = {shape!r}, but the shape is {self.shape!r}: remove one of them"
                )
        if self.shape == "normals" and self.normals is None:
            raise ValueError(
                "shape = 'normals' needs normals = the file of a normal map, or 'unknown' to have them found"
            )
        for key in ("texture", "radius"):
            if self.shape == "normals" and getattr(self, key):
                raise ValueError(
                    f"{key} is not for shape = 'normals': every pixel has its own Kd; remove the key"
                )
        return self


class SourceTable(Table):
    direction: Vector3 | None = None
    arc_angle_deg: float | None = None
    irradiance: Vector3 | None = None

    @model_validator(mode="after")
    def _one_place(self) -> SourceTable:
        if (self.direction is None) == (self.arc_angle_deg is None):
            raise ValueError(
                "a source needs direction, or arc_angle_deg with a [light_arc] table: one of the two"
            )
        return self


class NearSourceTable(Table):
    position: Vector3
    intensity: Vector3 | None = None


def _one_photo(value: Any) -> Any:
    """One photo is a bracket of one."""
    return (value,) if isinstance(value, str) else value


def _one_time(value: Any) -> Any:
    """One exposure time is a bracket's of one."""
    if isinstance(value, tuple):
        return value
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < float("inf"):
        raise ValueError("must be seconds above 0, or an array of them")
    return (float(value),)


class BallViewTable(Table):
    # One photo, or a bracket: from the longest exposure to the shortest, or the other way round.
    photo: Annotated[tuple[str, ...], BeforeValidator(_one_photo)] = ()
    mask: str | None = None
    ball: Vector3 | None = None
    background: str | None = None
    camera: CameraTable | None = None
    world_to_camera: Matrix4 | None = None
    exposure_s: Annotated[tuple[Positive, ...] | None, BeforeValidator(_one_time)] = None
    iso: Positive | None = None
    f_number: Positive | None = None

    @model_validator(mode="after")
    def _one_place(self) -> BallViewTable:
        given = [key for key in ("mask", "ball", "background") if getattr(self, key) is not None]
        if len(given) > 1:
            raise ValueError(f"{given[0]} and {given[1]} both say where the ball is: remove one of them")
        if self.exposure_s is not None and len(self.exposure_s) != len(self.photo):
            raise ValueError(
                f"has {len(self.exposure_s)} numbers in exposure_s for {len(self.photo)} in photo: give one for each"
            )
        return self


class MirrorBallTable(BallViewTable):
    views: tuple[BallViewTable, ...] = ()
    reflectance: Reflectance = (1.0, 1.0, 1.0)
    camera_mask_deg: Annotated[float, Field(ge=0, le=90)] = 10.0

    @property
    def files(self) -> tuple[str, ...]:
        """The files that it names."""
        named: list[str | None] = []
        for view in self.views or (self,):
            named += [*view.photo, view.mask, view.background, view.camera.file if view.camera else None]
        return tuple(name for name in named if name is not None)

    @model_validator(mode="after")
    def _photo_or_views(self) -> MirrorBallTable:
        if bool(self.photo) == bool(self.views):
            raise ValueError(
                "needs photo, or views = [{ photo = ..., world_to_camera = ... }, ...]: one of the two"
            )
        own = sorted(self.model_fields_set & set(BallViewTable.model_fields))
        if self.views and own:
            raise ValueError(f"{own[0]} is each view's: write it in views")
        for number, view in enumerate(self.views, start=1):
            if not view.photo or (len(self.views) > 1 and view.world_to_camera is None):
                raise ValueError(f"view {number} needs photo, and world_to_camera if there are several")
        return self


class SourceRegionTable(Table):
    direction: Vector3
    radius_deg: Annotated[float, Field(gt=0, le=180)]

    @model_validator(mode="after")
    def _somewhere(self) -> SourceRegionTable:
        if not any(self.direction):
            raise ValueError("direction is [0, 0, 0]; give the way from the object to the lamp")
        return self


class LightingTable(Table):
    name: str
    map: str | None = None
    directional: tuple[SourceTable, ...] = ()
    near: tuple[NearSourceTable, ...] = ()
    mirror_ball: MirrorBallTable | None = None
    unknown: bool = False
    dark: bool = False
    source_regions: tuple[SourceRegionTable, ...] = ()
    recover: tuple[Recoverable, ...] | None = None

    @model_validator(mode="after")
    def _one_source_of_truth(self) -> LightingTable:
        known = [key for key in ("map", "directional", "near", "mirror_ball") if getattr(self, key)]
        if self.unknown and known:
            raise ValueError(f"unknown = true contradicts {known[0]}: remove one of them")
        if self.dark and not self.unknown:
            raise ValueError("dark = true is said of unknown light: remove it, or write unknown = true")
        if self.source_regions and not (self.unknown or self.mirror_ball):
            raise ValueError(
                "source_regions says where lamps are looked for, in unknown light or on a mirror ball, but"
                f" {' and '.join(known) or 'this lighting'} gives the light: remove it"
            )
        if self.mirror_ball and len(known) > 1:
            raise ValueError(f"mirror_ball and {known[0]} both give this lighting: remove one of them")
        if not self.unknown and not known:
            raise ValueError(
                "says nothing of the light: give map, directional, near, mirror_ball or unknown = true"
            )
        return self


class ArcTable(Table):
    centre: Vector3 = (0.0, 0.0, 0.0)
    axis: Vector3 = (0.0, 0.0, 1.0)
    radius: Positive | None = None
    start: Vector3 = (1.0, 0.0, 0.0)
    file: str | None = None

    @model_validator(mode="after")
    def _one_arc(self) -> ArcTable:
        given = self.model_fields_set & {"centre", "axis", "radius", "start", "mount"}
        if self.file is not None and given:
            raise ValueError(f"file and {min(given)} both give the arc: remove one of them")
        if self.file is None and self.radius is None:
            raise ValueError("lacks the key 'radius' (metres), or file = the gantry.json that holds the arc")
        return self


class GantryTable(ArcTable):
    mount: tuple[Vector3, Vector3, Vector3] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    step_deg: float | None = None


class PhotoTable(Table):
    file: str
    mask: str | None = None
    camera: CameraTable | None = None
    world_to_camera: Matrix4 | None = None
    gantry_angle_deg: float | None = None
    lighting: str | None = None
    exposure_s: Positive | None = None
    iso: Positive | None = None
    f_number: Positive | None = None
    polarisation: Polarisation | None = None
    held_out: bool = False

    @model_validator(mode="after")
    def _one_pose(self) -> PhotoTable:
        if self.world_to_camera is not None and self.gantry_angle_deg is not None:
            raise ValueError("world_to_camera and gantry_angle_deg both give the pose: remove one of them")
        return self


class PolarisationTable(Table):
    """Filters: shares that they pass of unpolarised light, and crossed of polarised light, over parallel ones."""

    transmission: Annotated[float, Field(gt=0, le=0.5)] = 0.5
    extinction: Annotated[float, Field(ge=0, lt=1)] | None = None


class UncertaintyTable(Table):
    """Standard deviations of what a manifest gives: degrees about each axis, metres, shares of the focal length."""

    rotation_deg: NotNegative | None = None
    position: NotNegative | None = None
    focal_length: NotNegative | None = None
    direction_deg: NotNegative | None = None
    extinction: NotNegative | None = None
    height: NotNegative | None = None
    height_correlation: Positive | None = None

    @model_validator(mode="after")
    def _noise_of_the_scan(self) -> UncertaintyTable:
        if self.height_correlation is not None and not self.height:
            raise ValueError(
                "height_correlation is over what length height varies: give height, or remove it"
            )
        return self


class Manifest(Table):
    format: Literal[1]
    name: str
    camera: CameraTable = CameraTable()
    radiometry: RadiometryTable = RadiometryTable()
    object: ObjectTable = ObjectTable()
    uncertainty: UncertaintyTable = UncertaintyTable()
    polarisation: PolarisationTable | None = None
    poses: str | None = None
    gantry: GantryTable | None = None
    light_arc: ArcTable | None = None
    lighting: tuple[LightingTable, ...] = ()
    reference: tuple[ReferenceTable, ...] = ()
    photo: tuple[PhotoTable, ...]


def read_manifest(path: Path) -> Manifest:
    """Parse and validate a manifest; ValueError names file, key and remedy."""
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror or error})") from error
    except UnicodeDecodeError as error:
        raise ValueError(
            f"{path}: is not a UTF-8 text file, as a manifest must be; give a photo set's folder or its photoset.toml"
        ) from error
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"{path}: is not valid TOML: {error}") from error
    return validated(Manifest, path, data)


def resolve(manifest: Path, path: str) -> Path:
    """`path` relative to the manifest's folder; `${NAME}` stands for an environment variable."""
    expanded = os.path.expandvars(os.path.expanduser(path))
    if "$" in expanded:
        raise ValueError(f"{manifest}: path {path!r} names an environment variable that is not set")
    return manifest.parent / expanded
