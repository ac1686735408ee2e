"""Scene files: small TOML files that describe a photographic staging."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from capture.files.tables import Table, validated
from capture.manifest import UncertaintyTable
from synthetic.scenes.schema import (
    BallTable,
    CalibrationTable,
    EffortTable,
    FaultsTable,
    MaterialTable,
    SceneCamera,
    SceneGantry,
    SceneLighting,
    SceneObject,
    SensorTable,
    TurntableTable,
    ViewTable,
)


class SceneFile(Table):
    format: Literal[1]
    name: str
    description: str = ""
    seed: Annotated[int, Field(ge=0)] = 0
    object: SceneObject
    material: MaterialTable | None = None
    lighting: tuple[SceneLighting, ...]
    camera: SceneCamera
    gantry: SceneGantry | None = None
    turntable: TurntableTable | None = None
    view: tuple[ViewTable, ...] = ()
    sensor: SensorTable = SensorTable()
    faults: FaultsTable = FaultsTable()
    uncertainty: UncertaintyTable = UncertaintyTable()
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
                raise ValueError(f"has two [[lighting]] tables named {name!r}; names must differ")
        self._check_lightings_used(names)
        self._check_errors()
        if self.calibration is not None and self.sensor.file == "exr":
            raise ValueError(
                "has [calibration], photographs of a camera, but the sensor writes EXR: give [sensor] file = 'png', ..."
            )
        if any(table.given == "ball" for table in self.lighting) and self.mirror_ball is None:
            raise ValueError("gives a lighting by 'ball': add a [mirror_ball] table")
        if self.material is None and self.object.shape != "doll":
            raise ValueError("lacks the table [material]; only the doll brings its own, painted")
        if self.material is not None:
            self.material.check_weights(painted=self.object.shape == "doll")
        return self

    def _check_lightings_used(self, names: list[str]) -> None:
        tables = {"[gantry]": self.gantry, "[turntable]": self.turntable}
        used = {where: table.lighting for where, table in tables.items() if table is not None}
        used |= {f"[[view]] {number}": view.lighting for number, view in enumerate(self.view, start=1)}
        for where, name in used.items():
            if name is not None and name not in names:
                raise ValueError(
                    f"names lighting {name!r} in {where}; there are {', '.join(map(repr, names))}"
                )
        for name in names:
            if name not in {other or names[0] for other in used.values()}:
                raise ValueError(
                    f"has a lighting {name!r} under which nothing is photographed: write lighting = {name!r} in"
                    " [gantry], [turntable] or a [[view]], or remove it"
                )

    def _check_errors(self) -> None:
        meshes = {"mesh_m", "mesh_correlation_m", "misaligned_deg", "misaligned_m"}
        given = self.faults.model_fields_set & meshes
        if given and self.object.shape == "sphere":
            raise ValueError(
                f"has {min(given)} in [faults], which is for meshes, but shows a sphere: remove it"
            )
        if self.uncertainty.height and self.object.shape == "sphere":
            raise ValueError(
                "has height in [uncertainty], of a mesh's vertices, but shows a sphere: remove it"
            )
        sources = any(table.directional or table.lamp for table in self.lighting)
        if self.uncertainty.direction_deg and not sources:
            raise ValueError("has direction_deg in [uncertainty], but no lighting has sources: remove it")


def read_scene_file(path: Path) -> SceneFile:
    """Parse and validate a scene file; ValueError names file, key and remedy."""
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror or error})") from error
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ValueError(f"{path}: is not valid TOML: {error}") from error
    return validated(SceneFile, path, data)
