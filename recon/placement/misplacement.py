"""What would explain that a mesh isn't where photographs show it: the mistakes that are commonly made, one by one."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product

import numpy as np
from numpy.typing import NDArray

from capture.camera import Camera
from recon.mesh.bodies import MeshBody, body_coverage
from recon.placement.conventions import other_conventions, signed_axes

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
# Turns a camera as it is given into one that sees the mesh, as it is given, as it would be seen without a mistake.
Mend = Callable[[Camera], Camera]

# Overlap (intersection over union) of mesh and mask below which they don't show the same thing; and below which
# the fit deserves a warning.
MIN_OVERLAP, GOOD_OVERLAP = 0.8, 0.95
# Pixels of a photograph that are looked at for each of many explanations.
_PIXELS = 10_000
# Overlaps that differ by less are as good as each other.
_ALIKE = 0.01
# Factors by which units are commonly mistaken: metres for mm, cm; inches for mm, cm; and the like.
_UNIT_FACTORS = {
    0.001: "millimetres taken for metres",
    1000.0: "metres taken for millimetres",
    0.01: "centimetres taken for metres",
    100.0: "metres taken for centimetres",
    0.1: "millimetres taken for centimetres",
    10.0: "centimetres taken for millimetres",
    0.0254: "inches taken for metres",
    25.4: "inches taken for millimetres",
    2.54: "inches taken for centimetres",
}
INVERTED = "the mask is inverted: it must be white where the object is, and black around it"
_MASK_FAULTS: Mapping[str, Callable[[Mask], Mask]] = {
    INVERTED: lambda inside: ~inside,
    "the mask looks mirrored, right and left exchanged: are the photographs, too?": lambda inside: inside[
        :, ::-1
    ],
    "the mask looks stored from the bottom up: are the photographs, too?": lambda inside: inside[::-1],
}
_ELSE = "check world_to_camera, mesh_to_world, unit and the mask, or let `lightfactor align` place the mesh"


@dataclass(frozen=True, eq=False)
class Look:
    """One photograph at every `stride`-th row and column: its camera, where its mask is white, (h, w), or None."""

    label: str
    camera: Camera
    stride: int
    inside: Mask | None

    def overlap(self, body: MeshBody, camera: Camera | None = None) -> float:
        """Intersection over union of the mask and what the camera, or another one, sees of a mesh."""
        assert self.inside is not None
        return overlap(body_coverage(body, camera or self.camera, self.stride), self.inside)

    def coarse(self) -> Look:
        """The same at fewer pixels."""
        step = max(stride_of(self.camera, _PIXELS) // self.stride, 1)
        inside = None if self.inside is None else self.inside[::step, ::step]
        return replace(self, stride=self.stride * step, inside=inside)


def overlap(one: Mask, other: Mask) -> float:
    """Intersection over union, 0 where both are empty."""
    union = (one | other).sum()
    return float((one & other).sum() / union) if union else 0.0


def stride_of(camera: Camera, pixels: int) -> int:
    """Every how many rows and columns about so many pixels are looked at."""
    return max(int(np.sqrt(camera.width * camera.height / pixels)), 1)


def common_mistake(body: MeshBody, mesh_to_world: Floats, looks: Sequence[Look]) -> str:
    """What would make a mesh fit all of several photographs that don't show it where it lies, and what to do.

    mesh_to_world : (4, 4), where the body's mesh was put: wrong units and axes are about its own origin.
    """
    looks = [look.coarse() for look in looks if look.inside is not None]
    if not looks:
        return _ELSE
    if fault := _mask_fault(body, looks):
        return fault
    if _least_overlap(_inside_out(body), looks) >= MIN_OVERLAP:
        return (
            "it would fit if its faces were turned over: the mesh is inside out; flip its faces and normals"
        )
    mistakes = _mistakes(mesh_to_world)
    turns = dict(_turns(mesh_to_world))
    both = {
        f"{first}; and {second}": partial(_one_after_the_other, mend, turn)
        for (first, mend), (second, turn) in product(mistakes.items(), turns.items())
    }
    for mends in (mistakes, {f"it would fit if {text}": turn for text, turn in turns.items()}, both):
        # Each mend is given up with the first photograph that it doesn't make fit.
        fits = {text: _least_overlap(body, looks, mend) for text, mend in mends.items()}
        best = max(fits.values())
        if best >= MIN_OVERLAP:
            return next(text for text, fit in fits.items() if fit >= best - _ALIKE)
    return wrong_size(body, mesh_to_world, looks, MIN_OVERLAP) or _ELSE


def single_mistake(body: MeshBody, look: Look, right: Sequence[Look]) -> str:
    """What may be wrong with one photograph that doesn't show a mesh which others, `right`, show where it lies."""
    if look.inside is not None:
        look = look.coarse()
        if fault := _mask_fault(body, [look]):
            return fault
        for name, convert in other_conventions().items():
            if look.overlap(body, _reposed(convert, look.camera)) >= MIN_OVERLAP:
                return f"the pose looks like {name}"
        for other in right:
            if look.overlap(body, other.camera) >= GOOD_OVERLAP:
                return f"its mask is what the camera of {other.label} sees: are photographs, masks or poses exchanged?"
    others = f"{len(right)} other photographs show" if len(right) > 1 else "another photograph shows"
    return (
        f"{others} the mesh where it lies: check this one's mask and world_to_camera, and whether it shows the object"
        " at all"
    )


def wrong_size(body: MeshBody, mesh_to_world: Floats, looks: Sequence[Look], least: float) -> str | None:
    """The sentence for a mesh that overlaps all masks by `least` if seen larger or smaller; None if it doesn't."""
    for sized in (partial(_sized, mesh_to_world), _zoomed):
        factor = _area_factor(body, looks[0], sized)
        if factor is not None and _least_overlap(body, looks, partial(sized, factor), least):
            return (
                f"it would fit if it were {factor:.3g} times as large: check the mesh's size and [object] unit, the"
                " camera's focal length, and whether masks are drawn too large or too small"
            )
    return None


def _least_overlap(
    body: MeshBody, looks: Sequence[Look], mend: Mend | None = None, least: float = MIN_OVERLAP
) -> float:
    """The least overlap of all photographs, their cameras mended; 0 as soon as one falls short."""
    found = 1.0
    for look in looks:
        found = min(found, look.overlap(body, look.camera if mend is None else mend(look.camera)))
        if found < least:
            return 0.0
    return found


def _mask_fault(body: MeshBody, looks: Sequence[Look]) -> str | None:
    """What is wrong with masks that would fit if they were inverted or mirrored, or that say nothing."""
    masks = [look.inside for look in looks if look.inside is not None]
    if all(inside.all() for inside in masks):
        return "its mask is white all over; it must be zero where the object isn't"
    for fault, mended in _MASK_FAULTS.items():
        meant = [replace(look, inside=mended(inside)) for look, inside in zip(looks, masks, strict=True)]
        if _least_overlap(body, meant) >= MIN_OVERLAP:
            return fault
    return None


def _mistakes(mesh_to_world: Floats) -> Mapping[str, Mend]:
    """By what is to be said of them, the mends of wrong units and of other conventions of poses."""
    found: dict[str, Mend] = {}
    for factor, mistake in _UNIT_FACTORS.items():
        found[
            f"it would fit if it were {factor:g} times as large: {mistake}? set unit in [object], or give poses in"
            " metres if it is they that aren't"
        ] = partial(_sized, mesh_to_world, factor)
    for factor, mistake in _UNIT_FACTORS.items():
        found[
            f"it would fit if the cameras' positions were {factor:g} times as large: {mistake}? give world_to_camera"
            " in metres"
        ] = partial(_moved_away, factor)
    for name, convert in other_conventions().items():
        found[f"the pose looks like {name}"] = partial(_reposed, convert)
    return found


def _turns(mesh_to_world: Floats) -> Iterator[tuple[str, Mend]]:
    """The 23 turns of a mesh's own axes that take axes to axes, with what is to be said of them.

    Those that take +Y to +Z come first: many formats have +Y up.
    """
    for turn in sorted(signed_axes(), key=lambda matrix: -matrix[2, 1]):
        if np.linalg.det(turn) < 0 or np.array_equal(turn, np.eye(3)):
            continue
        inner = np.eye(4)
        inner[:3, :3] = turn
        place = mesh_to_world @ inner
        # Adding zero makes -0 a 0.
        rows = ", ".join(f"[{', '.join(f'{value:.6g}' for value in row)}]" for row in place.round(9) + 0.0)
        why = " (+Y is up in its file, as in most GLB)" if turn[2, 1] == 1 else ""
        yield (
            f"its axes were turned{why}: write mesh_to_world = [{rows}] into [object]; lights must be given"
            " in the axes of the cameras",
            partial(_as_if_placed, mesh_to_world, place),
        )


def _as_if_placed(was: Floats, place: Floats, camera: Camera) -> Camera:
    """The camera that sees a mesh at `was` as this one would see it at `place`, both rigid (4, 4)."""
    return camera.posed(camera.world_to_camera @ place @ np.linalg.inv(was))


def _sized(mesh_to_world: Floats, factor: float, camera: Camera) -> Camera:
    """The camera that sees the mesh as this one would see it scaled about its own origin.

    world_to_camera . mesh_to_world . diag(f, f, f, 1) projects as it does divided by f.
    """
    of_mesh = camera.world_to_camera @ mesh_to_world
    of_mesh[:3, 3] /= factor
    return camera.posed(of_mesh @ np.linalg.inv(mesh_to_world))


def _zoomed(factor: float, camera: Camera) -> Camera:
    return camera.zoomed(factor)


def _moved_away(factor: float, camera: Camera) -> Camera:
    pose = camera.world_to_camera.copy()
    pose[:3, 3] *= factor
    return camera.posed(pose)


def _reposed(convert: Callable[[Floats], Floats], camera: Camera) -> Camera:
    return camera.posed(convert(camera.world_to_camera))


def _one_after_the_other(first: Mend, second: Mend, camera: Camera) -> Camera:
    return second(first(camera))


def _area_factor(body: MeshBody, look: Look, sized: Callable[[float, Camera], Camera]) -> float | None:
    """By what the mesh must be enlarged to fill a mask; None if it isn't seen."""
    assert look.inside is not None
    factor, wanted = 1.0, float(look.inside.sum())
    for _ in range(4):
        area = float(body_coverage(body, sized(factor, look.camera), look.stride).sum())
        if not area:
            return None
        factor *= float(np.sqrt(wanted / area))
    return factor


def _inside_out(body: MeshBody) -> MeshBody:
    mesh = body.mesh
    return MeshBody(replace(mesh, faces=mesh.faces[:, ::-1], normals=-mesh.normals))
