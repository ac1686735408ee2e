"""How `factor` is asked to solve: its options, checked."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from capture.source_region import SourceRegion
from invrender.estimate.unknown_light import ORDERS
from invrender.transport.lobe_table import TRANSFERS, Transfer

_HIGHEST_ORDER = 20
_LEAST_SAMPLES = 500


@dataclass(frozen=True, eq=False)
class FactorChoices:
    """orders : degrees of the lighting that are tried; of RH01's procedure l*, or none for dual lighting.

    region : where sources may be; None for where the set says. transfer : what the lobe makes of the light. ladder :
    whether simpler models are tried. published : RH01's own procedure instead of ours. samples : pixels of all
    photographs.
    """

    orders: tuple[int, ...] = ORDERS
    region: SourceRegion | None = None
    transfer: Transfer = "exact"
    ladder: bool = True
    published: bool = False
    samples: int = 60_000

    def document(self) -> dict[str, Any]:
        """The choices as JSON-ready data."""
        region = self.region
        return {
            "procedure": "published" if self.published else "ours",
            "orders": list(self.orders),
            "transfer": self.transfer,
            "ladder": self.ladder,
            "samples": self.samples,
            "source_region": None
            if region is None
            else {
                "direction": region.directions[0].tolist(),
                "radius_deg": float(np.degrees(region.radii[0])),
            },
        }


def read_choices(
    order: str | None, region: str | None, transfer: str | None, ladder: bool, published: bool, samples: int
) -> FactorChoices:
    """The options as the user typed them; ValueError says which is wrong, and what it may be."""
    if published:
        given = ([] if transfer is None else ["--transfer"]) + ([] if ladder else ["--no-ladder"])
        if given:
            raise ValueError(
                f"{given[0]} has no place in RH01's procedure, which --published asks for: leave one of them out"
            )
    if transfer is not None and transfer not in TRANSFERS:
        raise ValueError(f"--transfer is {transfer!r}; it must be one of {', '.join(TRANSFERS)}")
    if samples < _LEAST_SAMPLES:
        raise ValueError(f"--samples is {samples}; take {_LEAST_SAMPLES} or more")
    chosen: Transfer = "mirror" if published else "exact"
    chosen = next((name for name in TRANSFERS if name == transfer), chosen)
    orders = () if published and order is None else _orders(order)
    if published and len(orders) > 1:
        raise ValueError(
            f"--order is {order!r}; RH01's procedure takes one degree, at which the light's harmonics end, as 12"
        )
    return FactorChoices(orders, _region(region), chosen, ladder and not published, published, samples)


def _orders(text: str | None) -> tuple[int, ...]:
    if text is None:
        return ORDERS
    try:
        orders = sorted({int(part) for part in text.replace(",", " ").split()})
    except ValueError as error:
        raise ValueError(f"--order is {text!r}; give one degree, or several as 4,8,12") from error
    wrong = [order for order in orders if not 1 <= order <= _HIGHEST_ORDER]
    if wrong or not orders:
        raise ValueError(
            f"--order is {text!r}; degrees of the lighting are 1 to {_HIGHEST_ORDER}, one or several as 4,8,12"
        )
    return tuple(orders)


def _region(text: str | None) -> SourceRegion | None:
    if text is None:
        return None
    form = "AZIMUTH,ELEVATION,RADIUS in degrees, as -20,25,15"
    try:
        azimuth, elevation, radius = (float(part) for part in text.split(","))
    except ValueError as error:
        raise ValueError(f"--source-region is {text!r}; give {form}") from error
    limits = (
        ("azimuth", azimuth, -360, 360),
        ("elevation", elevation, -90, 90),
        ("radius", radius, 0, 180),
    )
    for name, value, low, high in limits:
        if not low <= value <= high or (name == "radius" and value == 0):
            least = "above 0" if name == "radius" else f"{low}"
            raise ValueError(
                f"--source-region is {text!r}: its {name} is {value:g} degrees, but must be {least} to {high}; give"
                f" {form}"
            )
    turn, rise = np.radians([azimuth, elevation])
    level = np.cos(rise)
    direction = np.array([level * np.cos(turn), level * np.sin(turn), np.sin(rise)])
    return SourceRegion(direction, np.radians([radius]))
