"""Scenes of a sphere that are planned, as text, and what is planned of samples of one."""

from __future__ import annotations

import numpy as np

from invrender.brdf.microfacet import Microfacet
from invrender.plan.experiment import PlannedLight
from invrender.plan.shown import PlannedObject
from invrender.plan.unknowns import unknowns_of
from recon.mesh.bodies import SphereBody
from recon.sphere.sphere import Sphere
from synthetic.materials.rh01 import RH01_MATERIALS, radiometric

TEFLON = radiometric(RH01_MATERIALS["teflon"])
BRDF = Microfacet(TEFLON.kd, TEFLON.ks, TEFLON.mu, TEFLON.sigma)
MATTE = Microfacet(TEFLON.kd, np.zeros(3), None, None)
BALL = SphereBody(Sphere(np.zeros(3), 0.02, np.zeros((4, 4))))
LAMP = "directional = [{ azimuth_deg = 0, elevation_deg = 4, irradiance = 2.0 }]"
SOFT = "area = [{ azimuth_deg = 110, elevation_deg = 60, radiance = 1.0, width_deg = 60 }]"
SKY = "area = [{ azimuth_deg = 110, elevation_deg = 40, radiance = 1.5, width_deg = 20 }]"


def scene(light: str, views: str, material: str = 'name = "teflon"', more: str = "") -> str:
    """A sphere of 30 px: a fit takes all of its pixels, however many photographs there are."""
    return f"""format = 1
name = "bench"
[object]
shape = "sphere"
[material]
{material}
[[lighting]]
name = "lab"
{light}
[camera]
width = 80
height = 60
focal_px = 900
{views}
{more}
"""


GANTRY = "[gantry]\nphotos = 7\nstep_deg = 25\n"


def columns_of(brdf: Microfacet, light: PlannedLight, fields, degree: int = 3):
    unknowns = unknowns_of(brdf, [light], degree, None)
    return unknowns, list(PlannedObject(BALL, [light], unknowns, degree).shown(0, fields))
