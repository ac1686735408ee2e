"""What a candidate for the cause of residuals is: some numbers, and what photographs would show with them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.microfacet import Microfacet
from invrender.diagnostics.altered import NOTHING, Alteration

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

Alter = Callable[[int, Floats], Alteration]
Finish = Callable[[Floats, Floats], Floats]


@dataclass(frozen=True, eq=False)
class Cause:
    """Something that may be wrong, in numbers that are zero where it isn't.

    name : its key. touches : per photograph, which of the numbers change it. count : how many there are.
    size : of the numbers, beyond which they are unlikely; None for any.
    columns : per photograph, radiance (n, 3, own) per unit of each of its own numbers, of a cause that adds some.
    Other causes change the prediction: alter says what is otherwise in a photograph, by its place in the set and all
    numbers; finish what the camera reports, (n, 3), of the radiance (n, 3) that reaches it and the numbers. step : of
    differences by each number. starts : BRDFs, besides the fit's, from which to search.
    """

    name: str
    count: int
    touches: tuple[Ints, ...]
    size: float | None = None
    columns: tuple[Floats, ...] | None = None
    alter: Alter = lambda _, __: NOTHING
    finish: Finish | None = None
    step: float = 0.003
    starts: Sequence[Microfacet] = ()


@dataclass(frozen=True, eq=False)
class CauseFit:
    """A cause as it explains photographs best.

    energy : (photos,), weighted squares left in samples that a fit of this cause, BRDF and light hasn't seen. pattern :
    (n, 3) per photograph, radiance that is the cause's. left : (n, 3), what is left of the photograph then. brdf : the
    one about which all is linear. best : the one that fits best with the cause.
    """

    cause: Cause
    numbers: Floats
    brdf: Microfacet
    energy: Floats
    pattern: tuple[Floats, ...]
    left: tuple[Floats, ...]
    best: Microfacet


def common(photos: int, count: int) -> tuple[Ints, ...]:
    """`Cause.touches` of numbers that all photographs share."""
    return (np.arange(count),) * photos


def each(photos: int, count: int) -> tuple[Ints, ...]:
    """`Cause.touches` of so many numbers per photograph."""
    return tuple(np.arange(count * k, count * (k + 1)) for k in range(photos))
