"""What crossed filters pass of the lobe, from points of a texture: their Kd and Ks give way to it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from capture.polarisation import Extinction
from invrender.brdf.form import LobeForm
from invrender.estimate.extinction import PassedLobe, stepped
from invrender.estimate.textured.fit import richest_fit
from invrender.estimate.textured.search import SolvedPoints
from invrender.estimate.textured.texel_observations import TexelRows


def improve_textured_extinction(
    photos: Mapping[LobeForm, Sequence[TexelRows]],
    crossed: NDArray[np.bool_],
    points: int,
    extinction: Extinction,
) -> tuple[Extinction, LobeForm]:
    """The extinction a step further under known light, and the form of the lobe that it takes for granted.

    photos : rows of so many points, in forms to choose from. crossed : (photos,), which were taken through crossed
    filters. mu and sigma stay as they are: what they change in the lobe is alike through both filters.
    """
    model, point, stack = richest_fit(photos, points)
    here = SolvedPoints.of(model, stack, point)
    through = crossed[stack.photo][:, None]
    # The columns of crossed photographs hold twice the extinction.
    by_extinction = np.where(through, here.ks * here.s / extinction.value, 0.0)
    corner, right = here.shared_equations([by_extinction])
    seen = PassedLobe(stack.tiles, by_extinction, here.residual, stack.weight)
    return stepped(extinction, corner, right, [seen]), model.form
