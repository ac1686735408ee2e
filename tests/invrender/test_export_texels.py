"""Textures as other programs get them."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_array_equal

from invrender.output.export.texels import texels_of
from invrender.result.saved_textures import SavedTextures


def test_texels_of_which_nothing_is_known_are_those_of_their_nearest_neighbour() -> None:
    known = np.array([[1.0, 0.0, 0.0, 0.0, 0.5]])
    kd = known[..., None] * np.array([[[0.1, 0.2, 0.3], [9, 9, 9], [9, 9, 9], [9, 9, 9], [0.4, 0.5, 0.6]]])
    everywhere = np.full((1, 1, 3), 0.05)
    textures = SavedTextures(kd, everywhere, np.zeros_like(kd), np.zeros_like(everywhere), known)
    found = texels_of(textures, np.full(3, 0.05))
    assert_array_equal(found.kd[0, [1, 3]], kd[0, [0, 4]])
    assert (found.kd > 0).all()
    # What doesn't vary stays, and what is known everywhere.
    assert_array_equal(found.strength, np.ones_like(kd))
    whole = SavedTextures(kd, kd, kd, kd, None)
    assert_array_equal(texels_of(whole, np.ones(3)).kd, kd)
