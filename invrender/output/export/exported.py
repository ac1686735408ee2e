"""A result written for another program. No options as text, no terminal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from capture.camera import Camera
from capture.files.documents import write_json
from capture.files.outfolder import result_folder
from invrender.output.export.document import export_document, warnings
from invrender.output.export.gltf import write_gltf
from invrender.output.export.gltf_target import GLTF
from invrender.output.export.mapping import Mapping, map_brdf
from invrender.output.export.material import ExportedBRDF, material_of
from invrender.output.export.materialx import NODES, write_materialx
from invrender.output.export.materialx_target import OPEN_PBR, STANDARD_SURFACE
from invrender.output.export.mitsuba import write_mitsuba
from invrender.output.export.mitsuba_target import MITSUBA
from invrender.output.export.shape import Shape, result_shape
from invrender.output.export.target import Target
from invrender.output.export.texels import strongest, texels_of
from invrender.output.render.view import DEFAULT_VIEW, View, new_optics, seen_from
from invrender.result.document import FORMAT
from invrender.result.saved import SavedResult, nearest
from invrender.result.source_set import find_photoset

TARGETS: dict[str, tuple[Target, ...]] = {
    "gltf": (GLTF,),
    "mitsuba": MITSUBA,
    "materialx": (STANDARD_SURFACE,),
    "openpbr": (OPEN_PBR,),
}
# The page of `html.export_page`, whose material is the result's own.
PAGE_FORM = "html"
# The first is in every export.
EXPORT_FILES = ("export.json", "*.glb", "*.xml", "*.mtlx", "*.obj", "*.exr", "*.html", "normals.png")


@dataclass(frozen=True, eq=False)
class ExportedResult:
    """What was exported.

    mapping : the material in the target's numbers, and what is lost by that. notes : sentences.
    """

    files: tuple[Path, ...]
    mapping: Mapping
    notes: tuple[str, ...]


def export_result(
    result: SavedResult,
    out: Path,
    form: str,
    *,
    light: bool = False,
    lighting: str | None = None,
    albedo: Sequence[float] | None = None,
    assumed: dict[str, float] | None = None,
    view: View | None = None,
    photoset: Path | None = None,
) -> ExportedResult:
    """Write a result into the folder `out` in a format of `TARGETS`; an earlier export there is replaced.

    light : glTF also has the light. lighting : which, where there are several. albedo : one number or three, of a
    result in a relative gauge. assumed : values of mu or sigma that are undetermined. view : of Mitsuba's camera.
    photoset : the set that the result was made from, looked for around it if None.
    ValueError where these don't go together, or the result leaves something open.
    """
    _check(form, light, lighting, view)
    if result.content.format != FORMAT:
        raise ValueError(
            f"{result.path}: its format is {result.content.format}; this version of lightfactor reads {FORMAT}: run"
            " `lightfactor process` again, or take the version that wrote it"
        )
    material = material_of(result, assumed or {}, albedo)
    if material.brdf.form.axis is not None:
        raise ValueError(
            f"{result.path}: its lobe is brushed, with two widths, which exports don't have yet; render it with"
            " `lightfactor render`"
        )
    shape = result_shape(result, find_photoset(result, photoset))
    _check_coordinates(result, material, shape)
    shown = None
    if form == "mitsuba" or (form == "gltf" and light):
        shown = material.under(result.read_lighting(result.lighting(lighting)))
    # Of metal in places, formats end before the mean's numbers, times so much.
    most = 1.0 if material.textures is None else strongest(texels_of(material.textures, material.brdf.ks))
    mapping = map_brdf(material.brdf, TARGETS[form], most)
    with result_folder(out, EXPORT_FILES) as folder:
        if form == "gltf":
            written = write_gltf(folder, result.content.name, shape, material, mapping, shown)
        elif form == "mitsuba":
            assert shown is not None
            camera = _camera(shape, view or DEFAULT_VIEW)
            written = write_mitsuba(folder, shape, material, mapping, shown, camera)
        else:
            written = write_materialx(folder, shape, material, mapping, NODES[form])
        notes = (*material.notes, *shape.warnings, *written.notes, *warnings(mapping))
        inputs = [result.path, *([] if shape.file is None else [shape.file])]
        document = export_document(result, form, material, mapping, written, shown, notes, inputs)
        write_json(folder / "export.json", document)
    return ExportedResult(tuple(out / file for file in written.files), mapping, notes)


def check_form(form: str) -> None:
    """ValueError for a format that no result is written in, the page aside."""
    if form not in TARGETS:
        raise ValueError(f"--format {form}: there is no such format; {nearest(form, [*TARGETS, PAGE_FORM])}")


def _check(form: str, light: bool, lighting: str | None, view: View | None) -> None:
    check_form(form)
    if form in NODES and (light or lighting):
        raise ValueError(f"--format {form}: a material has no light; leave out --light and --lighting")
    if form == "gltf" and lighting and not light:
        raise ValueError("--lighting names a lighting to be exported; give --light, too")
    if form != "mitsuba" and view:
        raise ValueError(f"--format {form}: has no camera; leave out --view")


def _check_coordinates(result: SavedResult, material: ExportedBRDF, shape: Shape) -> None:
    if material.textures is not None and (material.textures.at_vertices or shape.mesh.uv is None):
        how = "from vertex to vertex of" if material.textures.at_vertices else "by the texture coordinates of"
        raise ValueError(
            f"{result.path}: Kd and Ks vary {how} {shape.file}, and exported textures need coordinates without overlap:"
            " unwrap the mesh in another program, and run `lightfactor process` again with that mesh"
        )


def _camera(shape: Shape, view: View) -> Camera:
    return seen_from(new_optics(None, shape.radius, None, None), view, shape.centre, shape.radius)
