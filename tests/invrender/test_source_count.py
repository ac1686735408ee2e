"""How many lamps light an object in the dark, where its highlights are of no form that a model has."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from invrender.brdf.form import Angles
from invrender.brdf.lobes import GGX_FORM, PLASTICS
from invrender.estimate.unknown_light import factorize_blind
from invrender.transport.diffuse_base import base_share
from recon.sampling.lightfield import LightField

from .test_blind import noisy

# A narrow core, a haze and a wide foot, above a base under an interface.
CORE, HAZE, FOOT = (0.55, 0.03), (0.3, 0.1), (0.15, 0.25)
KD, KS, MU = np.array([0.25, 0.2, 0.15]), 0.02, 1.4


def of_lamps(field: LightField, lamps: list[np.ndarray]) -> LightField:
    """A photograph of a glossy paint under lamps of one irradiance."""
    total = np.zeros_like(field.normals)
    for lamp in lamps:
        angles = Angles.between(field.normals, lamp, field.views)
        cos_i, cos_o = np.clip(angles.cos_i, 0, 1), np.clip(angles.cos_o, 0, 1)
        base = cos_i * base_share(PLASTICS[GGX_FORM], MU, cos_i, cos_o)
        lobe = sum(share * GGX_FORM.reflected(angles, MU, width) for share, width in (CORE, HAZE, FOOT))
        total += base[:, None] * KD + KS * np.asarray(lobe)[:, None]
    return replace(field, radiance=field.mean_over_rays(total))


@pytest.mark.parametrize(
    ("count", "second"),
    [
        pytest.param(3, False, marks=pytest.mark.sweep),
        pytest.param(5, True, marks=pytest.mark.sweep),
    ],
)
def test_no_lamp_repairs_a_lobe_that_the_model_lacks(
    bench: SimpleNamespace, count: int, second: bool
) -> None:
    places = [(10, 30), (-30, 20), (40, -10), (-15, -25), (25, 15)][:count]
    lamps = [[bench.direction(*place)] for place in places]
    if second:
        lamps[2].append(bench.direction(-25, 35))
    photos = [of_lamps(bench.sphere_field(0.0, 2500, 60.0, seed=k), own) for k, own in enumerate(lamps)]
    names = [str(k) for k in range(len(photos))]
    found = factorize_blind(noisy(photos, np.random.default_rng(1)), names, orders=[0])
    assert [len(light.sources.directions) for light in found.lights.values()] == [len(own) for own in lamps]
    for own, light in zip(lamps, found.lights.values(), strict=True):
        # As far as the lobe's own form leaves open.
        near = (light.sources.directions @ np.array(own).T).max(axis=1)
        assert (near > np.cos(np.radians(1.5))).all()
