"""The schema of `[[reference]]` in `photoset.toml`."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from capture.files.tables import Positive, Reflectance, Table, Vector3

Pixel = tuple[float, float]


class ReferenceTable(Table):
    """Something of known reflectance in a photograph: a flat card, a sphere, or a colour chart."""

    photo: str
    region: tuple[Pixel, ...] = ()
    centre: Vector3 | None = None
    radius: Positive | None = None
    chart: str | None = None
    reflectance: Reflectance | None = None
    # Shares of the reflectance.
    reflectance_std: Annotated[float, Field(ge=0, lt=1)] = 0.03
    normal: Vector3 | None = None
    normal_std_deg: Annotated[float, Field(ge=0, le=90)] | None = None
    size: tuple[Positive, Positive] | None = None
    position: Vector3 | None = None

    @model_validator(mode="after")
    def _one_kind(self) -> ReferenceTable:
        kinds = {"region": self.region, "centre": self.centre, "chart": self.chart}
        given = [key for key, value in kinds.items() if value]
        if len(given) != 1:
            raise ValueError(
                f"gives {' and '.join(given) or 'no place'}: give one of region (a card's corners, pixels), centre with"
                " radius (a sphere, metres) and chart"
            )
        if (self.centre is None) != (self.radius is None):
            raise ValueError("a sphere needs centre and radius, metres in the world: give both")
        if (self.chart is None) == (self.reflectance is None):
            raise ValueError(
                "reflectance is for cards and spheres: a chart has its own; remove it"
                if self.chart
                else "lacks the key 'reflectance': one number, or [r, g, b], above 0 and at most 1"
            )
        return self

    @model_validator(mode="after")
    def _one_way_to_face(self) -> ReferenceTable:
        flat = [
            key for key in ("normal", "normal_std_deg", "size", "position") if getattr(self, key) is not None
        ]
        if self.centre is not None and flat:
            raise ValueError(f"{flat[0]} is for flat references: a sphere has all normals; remove it")
        if self.normal is not None and not any(self.normal):
            raise ValueError("normal is [0, 0, 0]; give the way that the reference faces, in the world")
        if self.normal is not None and self.size is not None:
            raise ValueError("normal and size both say how the reference is turned: remove one of them")
        if self.region and self.normal is None and self.size is None:
            raise ValueError(
                "lacks the way that the card faces: give normal, in the world, or size = [width, height] in metres,"
                " if region names its four corners"
            )
        if self.region and len(self.region) < 3:
            raise ValueError(f"region has {len(self.region)} corners; give three or more, pixels [x, y]")
        if self.size is not None and len(self.region) != 4:
            raise ValueError(
                f"size is of a card whose four corners region names, but that has {len(self.region)}: give normal"
            )
        if self.normal_std_deg is not None and self.normal is None:
            raise ValueError("normal_std_deg is the deviation of normal: give that, or remove it")
        if self.position is not None and self.normal is None:
            raise ValueError("position goes with normal: corners and charts say themselves where they are")
        return self
