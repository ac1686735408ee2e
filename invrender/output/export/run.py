"""The command `export` at work: a result to files, what is lost on the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from capture.camera import Camera
from capture.files.documents import write_json
from capture.files.outfolder import result_folder
from capture.lighting import Lighting
from capture.terminal import console, leave_cleanly_when_stopped
from invrender.output.export.document import export_document, lost, warnings
from invrender.output.export.gltf import write_gltf
from invrender.output.export.gltf_target import GLTF
from invrender.output.export.mapping import Mapping, map_brdf
from invrender.output.export.material import ExportedBRDF, material_of
from invrender.output.export.materialx import write_materialx
from invrender.output.export.materialx_target import STANDARD_SURFACE
from invrender.output.export.mitsuba import write_mitsuba
from invrender.output.export.mitsuba_target import MITSUBA
from invrender.output.export.shape import Shape, result_shape
from invrender.output.export.target import Target
from invrender.output.export.texels import strongest, texels_of
from invrender.output.render.run import parse_assumed
from invrender.output.render.source_set import find_photoset
from invrender.output.render.view import new_optics, parse_view, seen_from
from invrender.result.document import FORMAT
from invrender.result.saved import SavedResult, nearest, read_result

TARGETS: dict[str, tuple[Target, ...]] = {
    "gltf": (GLTF,),
    "mitsuba": MITSUBA,
    "materialx": (STANDARD_SURFACE,),
}
# The first is in every export.
EXPORT_FILES = ("export.json", "*.glb", "*.xml", "*.mtlx", "*.obj", "*.exr")
_DEFAULT_VIEW = "0,20"


@dataclass(frozen=True)
class ExportOptions:
    """The options of the command, as given; see its help."""

    result: Path
    out: Path
    form: str
    light: bool = False
    lighting: str | None = None
    albedo: str | None = None
    assume: tuple[str, ...] = ()
    view: str | None = None
    photoset: Path | None = None


def run_export(options: ExportOptions) -> None:
    """Export what the options ask for and print what a user should know of it."""
    _check_options(options)
    leave_cleanly_when_stopped()
    result = read_result(options.result)
    if result.content.format != FORMAT:
        raise ValueError(
            f"{result.path}: its format is {result.content.format}; this version of lightfactor reads {FORMAT}: run"
            " `lightfactor process` again, or take the version that wrote it"
        )
    material = material_of(result, parse_assumed(options.assume), options.albedo)
    photoset = find_photoset(result, options.photoset)
    shape = result_shape(result, photoset)
    if material.textures is not None and (material.textures.at_vertices or shape.mesh.uv is None):
        how = "from vertex to vertex of" if material.textures.at_vertices else "by the texture coordinates of"
        raise ValueError(
            f"{result.path}: Kd and Ks vary {how} {shape.file}, and exported textures need coordinates without overlap:"
            " unwrap the mesh in another program, and run `lightfactor process` again with that mesh"
        )
    lighting = _lighting(result, material, options)
    camera = _camera(shape, options)
    # Of metal in places, formats end before the mean's numbers, times so much.
    most = 1.0 if material.textures is None else strongest(texels_of(material.textures, material.brdf.ks))
    mapping = map_brdf(material.brdf, TARGETS[options.form], most)
    with result_folder(options.out, EXPORT_FILES) as folder:
        if options.form == "gltf":
            written = write_gltf(folder, result.content.name, shape, material, mapping, lighting)
        elif options.form == "mitsuba":
            assert lighting is not None
            written = write_mitsuba(folder, shape, material, mapping, lighting, camera)
        else:
            written = write_materialx(folder, shape, material, mapping)
        notes = [*material.notes, *shape.warnings, *written.notes, *warnings(mapping)]
        inputs = [result.path, *([] if shape.file is None else [shape.file])]
        write_json(
            folder / "export.json",
            export_document(result, options.form, material, mapping, written, lighting, notes, inputs),
        )
    _print(result, options, mapping, written.files, notes)


def _check_options(options: ExportOptions) -> None:
    if options.form not in TARGETS:
        raise ValueError(
            f"--format {options.form}: there is no such format; {nearest(options.form, TARGETS)}"
        )
    if options.form == "materialx" and (options.light or options.lighting):
        raise ValueError("--format materialx: a material has no light; leave out --light and --lighting")
    if options.form == "gltf" and options.lighting and not options.light:
        raise ValueError("--lighting names a lighting to be exported; give --light, too")
    if options.form != "mitsuba" and options.view:
        raise ValueError(f"--format {options.form}: has no camera; leave out --view")


def _lighting(result: SavedResult, material: ExportedBRDF, options: ExportOptions) -> Lighting | None:
    """The lighting that is exported, in the material's scale."""
    if options.form == "materialx" or (options.form == "gltf" and not options.light):
        return None
    return material.under(result.read_lighting(result.lighting(options.lighting)))


def _camera(shape: Shape, options: ExportOptions) -> Camera:
    view = parse_view(options.view or _DEFAULT_VIEW)
    return seen_from(new_optics(None, shape.radius, None, None), view, shape.centre, shape.radius)


def _print(
    result: SavedResult, options: ExportOptions, mapping: Mapping, files: Sequence[str], notes: Sequence[str]
) -> None:
    console.print(
        f"{result.content.name} for {options.form}: {', '.join(str(options.out / file) for file in files)}",
        soft_wrap=True,
        markup=False,
    )
    for sentence in lost(mapping):
        console.print(sentence, markup=False)
    for note in notes:
        console.print(f"Note: {note}", style="yellow", markup=False)
