"""All that a live picture is made of: a surface, its reflectance, lights, a camera."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from capture.lighting import Lighting
from invrender.brdf.microfacet import Microfacet
from invrender.output.live.few_faces import with_few_faces
from invrender.output.live.live_light import LiveLight, live_light
from invrender.output.live.live_material import LiveReflectance, live_reflectances
from invrender.output.live.lobe_volume import LobeVolume, lobe_volume
from invrender.output.render.photographer import Photographer
from invrender.output.render.view import DEFAULT_VIEW, View, ViewCamera
from invrender.transport.diffuse_base import interface_transmittance
from recon.mesh.bodies import MeshBody
from recon.mesh.tessellated import tessellated
from recon.mesh.trianglemesh import TriangleMesh

Floats = NDArray[np.float64]

# Entries of the table of what the interface transmits, over even cosines.
_ENTRIES = 64


@dataclass(frozen=True, eq=False)
class LiveScene:
    """A subject that a browser draws.

    mesh : its surface in the world, metres; centre and radius of a sphere that holds it. has_shadows : whether rays are
    traced. transmitted : (64,), what the interface transmits at even cosines 0 to 1. optics : the camera. first_view :
    where it stands at the start. notes : what a user should know of it, in sentences.
    """

    name: str
    mesh: TriangleMesh
    centre: Floats
    radius: float
    has_shadows: bool
    kd: LiveReflectance
    ks: LiveReflectance
    brdf: Microfacet
    volume: LobeVolume
    transmitted: NDArray[np.float16]
    lights: tuple[LiveLight, ...]
    optics: ViewCamera
    first_view: View
    notes: tuple[str, ...] = ()


def live_scene(
    studio: Photographer, lightings: Iterable[Lighting], first_view: View = DEFAULT_VIEW
) -> LiveScene:
    """A photographer's subject under lightings, for a browser.

    A mesh of more faces than browsers draw with ease is simplified, which a note says. ValueError for a brushed lobe,
    a mesh whose seams leave too many faces, and a lighting that is dark.
    """
    brdf = studio.material.brdf
    if brdf.form.axis is not None:
        raise ValueError(
            f"{studio.result.path}: its lobe is brushed, and reflection maps are of lobes that look the same from all"
            " azimuths; render it with `lightfactor render`"
        )
    studio, notes = with_few_faces(studio)
    subject = studio.subject
    body = subject.body
    mesh = body.mesh if isinstance(body, MeshBody) else tessellated(subject.centre, subject.radius)
    kd, ks = live_reflectances(studio.material, len(mesh.vertices))
    transmitted = interface_transmittance(brdf.form, brdf.mu, np.linspace(0, 1, _ENTRIES))
    return LiveScene(
        studio.result.content.name,
        mesh,
        subject.centre,
        subject.radius,
        subject.shadows is not None,
        kd,
        ks,
        brdf,
        lobe_volume(brdf),
        transmitted.astype(np.float16),
        tuple(live_light(replace(studio, lighting=lighting), lighting, mesh) for lighting in lightings),
        studio.optics(),
        first_view,
        notes,
    )
