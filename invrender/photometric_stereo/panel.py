"""A result of photometric stereo for other programs: a flat panel with albedo and a normal map."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from capture.camera import Camera
from capture.files.documents import input_hashes, read_json, software, write_json
from capture.files.imagefile import read_exr_layers, read_pixels
from capture.files.outfolder import result_folder
from capture.files.tables import LenientTable
from capture.terminal import console, leave_cleanly_when_stopped
from invrender.brdf.microfacet import Microfacet
from invrender.output.export.document import lost, lost_document, warnings
from invrender.output.export.exported import EXPORT_FILES, PAGE_FORM, TARGETS, check_form
from invrender.output.export.gltf import write_gltf
from invrender.output.export.mapping import map_brdf
from invrender.output.export.material import ExportedBRDF
from invrender.output.export.materialx import NODES, write_materialx
from invrender.output.export.shape import Shape
from invrender.photometric_stereo.shading import ASSUMED_MU
from invrender.result.saved import RESULT_NAME, saved_form
from invrender.result.saved_textures import SavedTextures
from recon.mesh.trianglemesh import TriangleMesh
from recon.normals.integration import pixel_rays
from recon.normals.normalmap import picture_axes
from recon.normals.saved import read_seen_normals

Floats = NDArray[np.float64]
Triple = tuple[float, float, float]
_WHAT = "`lightfactor process` writes such results of photo sets with [object] shape = 'normals'"


class _Number(LenientTable):
    value: float


class _Channels(LenientTable):
    value: Triple


class _Albedo(LenientTable):
    file: str


class _Brdf(LenientTable):
    model: str
    albedo: _Albedo
    ks: _Channels | None
    sigma: _Number | None
    form_numbers: dict[str, _Number]


class _Content(LenientTable):
    name: str
    brdf: _Brdf


@dataclass(frozen=True, eq=False)
class ExportedPanel:
    """What was exported : files, and sentences on what is lost and what to know."""

    files: tuple[Path, ...]
    said: tuple[str, ...]
    notes: tuple[str, ...]


def export_panel(source: Path, out: Path, form: str) -> ExportedPanel:
    """Write a result of normals into the folder `out` as a flat panel in the object's plane.

    form : "gltf", "materialx" or "openpbr". Kd is its base colour, the shared lobe its roughness, the normals its
    normal map (right, up, towards the viewer).
    """
    path = source / RESULT_NAME if source.is_dir() else source
    content = read_json(path, _Content, ("name", "brdf"), _WHAT)
    seen = read_seen_normals(path, 1.0)
    albedo_file = path.parent / content.brdf.albedo.file
    kd = read_pixels(albedo_file).astype(float) / np.pi
    kd_std = read_exr_layers(albedo_file)["std"].astype(float) / np.pi
    inside = seen.normal_map.inside
    brdf = _reflectance(content.brdf, kd[inside].mean(axis=0))
    ks = np.broadcast_to(brdf.ks, (1, 1, 3))
    textures = SavedTextures(kd, ks, kd_std, np.zeros_like(ks), inside.astype(float))
    material = ExportedBRDF(brdf, textures, np.ones(3), {}, ())
    mapping = map_brdf(brdf, TARGETS[form])
    panel = _panel(seen.camera, seen.depth)
    centre = panel.vertices.mean(axis=0)
    shape = Shape(panel, centre, float(np.linalg.norm(panel.vertices[0] - centre)), False)
    upright = np.where(inside[..., None], seen.normal_map.normals, [0.0, 0.0, 1.0])
    codes = np.round((upright + 1) / 2 * 255).astype(np.uint8)
    with result_folder(out, EXPORT_FILES) as folder:
        if form in NODES:
            written = write_materialx(folder, shape, material, mapping, NODES[form], codes)
        else:
            written = write_gltf(folder, content.name, shape, material, mapping, None, codes)
        notes = (*written.notes, *warnings(mapping), f"The refractive index is assumed to be {ASSUMED_MU}.")
        document = {
            "format": 1,
            "name": content.name,
            "exported_as": form,
            "files": list(written.files),
            "material": {"model": mapping.target.model, "parameters": dict(written.parameters)},
            "lost": lost_document(mapping),
            "notes": list(notes),
            "inputs": input_hashes([path, albedo_file]),
            "software": software(),
        }
        write_json(folder / "export.json", document)
    return ExportedPanel(tuple(out / file for file in written.files), tuple(lost(mapping)), notes)


def run_panel(source: Path, out: Path, form: str) -> None:
    """Export a result of normals and print what a user should know of it."""
    leave_cleanly_when_stopped()
    if form != PAGE_FORM:
        check_form(form)
    if form != "gltf" and form not in NODES:
        raise ValueError(
            f"--format {form}: {source} holds normals without a body. gltf, materialx and openpbr make a panel of it;"
            f" for {form} make a mesh with `lightfactor integrate` and process that"
        )
    exported = export_panel(source, out, form)
    console.print(f"A panel for {form}: {', '.join(map(str, exported.files))}", soft_wrap=True, markup=False)
    for sentence in exported.said:
        console.print(sentence, markup=False)
    for note in exported.notes:
        console.print(f"Note: {note}", style="yellow", markup=False)


def _reflectance(saved: _Brdf, kd: Floats) -> Microfacet:
    if saved.ks is None or saved.sigma is None:
        return Microfacet(kd, np.zeros(3), None, None)
    form = saved_form(saved.model, {name: of.value for name, of in saved.form_numbers.items()})
    return Microfacet(kd, np.array(saved.ks.value), ASSUMED_MU, saved.sigma.value, form)


def _panel(camera: Camera, depth: float) -> TriangleMesh:
    """Two triangles in the world that a camera's picture covers at a depth, with the picture's coordinates."""
    # Outer corners of the pictures' corner pixels, counterclockwise from the lower left as the viewer sees them.
    across, down = np.array([0, 1, 1, 0]), np.array([1, 1, 0, 0])
    pixels = np.column_stack([across * camera.width, down * camera.height])
    origins, directions = pixel_rays(camera, pixels[:, 1] - 0.5, pixels[:, 0] - 0.5)
    axes = picture_axes(camera)
    vertices = (origins + depth * directions) @ axes + camera.centre
    normals = np.broadcast_to(axes[2], (4, 3))
    return TriangleMesh(
        vertices, np.array([[0, 1, 2], [0, 2, 3]]), normals, np.column_stack([across, 1 - down])
    )
