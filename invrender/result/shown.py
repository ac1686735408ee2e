"""A saved result's numbers as people read them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from invrender.result.saved import SavedQuantity, SavedResult
from invrender.wording import parameter_lines


@dataclass(frozen=True)
class ShownNumber:
    """A number, or what stands for one that isn't there.

    label : with its unit. text : "value ± std", "-" where there is none. reason, remedy : why it isn't determined, and
    what would settle it; empty where it is.
    """

    label: str
    text: str
    status: str
    reason: str
    remedy: str


def shown_numbers(result: SavedResult) -> Iterator[ShownNumber]:
    """The numbers of a result's BRDF, channel by channel, and those that it should have and doesn't."""
    brdf = result.content.brdf
    found = {name: getattr(brdf, name) for name in ("kd", "ks", "mu", "sigma")} | brdf.form_numbers
    for name, quantity in found.items():
        why = result.finding(name)
        if quantity is None:
            if why.reason:
                yield ShownNumber(name, "-", "not needed", why.reason, why.remedy)
            continue
        for label, text in quantity_lines(name, quantity, result.is_absolute):
            yield ShownNumber(label, text, quantity.status, why.reason, why.remedy)


def quantity_lines(name: str, quantity: SavedQuantity, is_absolute: bool) -> list[tuple[str, str]]:
    """Label and text of each number of a parameter; is_absolute : as of `parameter_lines`."""
    value, std = (
        None if of is None else np.atleast_1d(np.array(of, float)) for of in (quantity.value, quantity.std)
    )
    if value is not None and std is None:
        std = np.zeros_like(value)
    return parameter_lines(name, value, std, is_absolute)
