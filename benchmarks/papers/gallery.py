"""R02's fig. 5.1: one shape in several lights and of several BRDFs, each frame by one reflection map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from benchmarks.papers.entry import Outcome, Workplace
from benchmarks.papers.lookups import looked_up
from benchmarks.papers.measuredorders import bagher_lobes, cornell_lobes
from benchmarks.papers.probes import probe
from benchmarks.papers.processortime import median_seconds
from invrender.brdf.rh01 import simplified_microfacet
from invrender.output.prefilter.brdfs import chosen_brdf
from invrender.output.prefilter.figure import draw_picture
from invrender.prefilter.centred import CentredBrdf, CentredLobe, specular_lobe
from invrender.prefilter.prefiltered import PrefilteredLight, prefilter
from recon.mesh.rays import RayTracer
from recon.mesh.trianglemesh import TriangleMesh
from synthetic.shapes import doll
from synthetic.shapes.cat import REACH, cat_field
from synthetic.shapes.doll import doll_mesh
from synthetic.shapes.meshing import mesh_implicit

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

# The paper's cube map of 64 x 64 x 6 has as many pixels as a lat-long map of 111 rows; F = 20 as there.
_ORDERS, _ROWS = (20, 3), 110
# Fibres take more orders of the view [R02, section 5.7.1].
_FIBRES = 8
_VIEWER = np.array([0.72, 0.6, 0.35]) / np.linalg.norm([0.72, 0.6, 0.35])


@dataclass(frozen=True, eq=False)
class _Object:
    """A mesh that distant viewers see.

    normals : (v, 3), of its vertices. side : pixels of a picture. reach : metres, of the sphere that holds it.
    """

    tracer: RayTracer
    normals: Floats
    side: int
    reach: float

    @classmethod
    def of(cls, mesh: TriangleMesh, side: int, reach: float) -> _Object:
        return cls(RayTracer(mesh.vertices, mesh.faces), mesh.normals, side, reach)

    def seen_from(self, viewer: Floats) -> tuple[Singles, NDArray[np.bool_]]:
        """Normals (n, 3), unit, of the pixels that show it, and which these are, (side, side)."""
        right = np.cross([0.0, 0, 1], viewer)
        right /= np.linalg.norm(right)
        up = np.cross(viewer, right)
        x, y = np.meshgrid(*2 * [((np.arange(self.side) + 0.5) / self.side * 2 - 1) * self.reach])
        origins = (x[..., None] * right - y[..., None] * up + 2 * self.reach * viewer).reshape(-1, 3)
        hits = self.tracer.first_hits(origins, np.broadcast_to(-viewer, origins.shape))
        inside = hits.faces >= 0
        corners = self.normals[self.tracer.faces[hits.faces[inside]]]
        normals = np.einsum("nk,nkc->nc", hits.weights[inside], corners)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        return normals.astype(np.float32), inside.reshape(self.side, self.side)


def gallery(place: Workplace) -> Outcome:
    """R02's fig. 5.1: the cat in the lights that are there, of five BRDFs, and how many frames a second that is."""
    if place.quick:
        # A coarse mesh of the cat would be none.
        cat = _Object.of(doll_mesh(0.008), 40, doll.REACH)
    else:
        cat = _Object.of(mesh_implicit(cat_field, REACH, 0.0012), 240, REACH)
    brdfs = _brdfs(place)
    names = ("Grace Cathedral",) if place.quick else ("Grace Cathedral", "Uffizi", "Pisa")
    lights = {name: probe(place, name, 16 if place.quick else 64) for name in names}
    rows, kept = 24 if place.quick else _ROWS, dict[str, PrefilteredLight]()
    figure = Figure(figsize=(8.4, 2.8 * len(lights) + 0.3), layout="constrained")
    panels = figure.subplots(len(lights), len(brdfs), squeeze=False)
    normals, inside = cat.seen_from(_VIEWER)
    for row, (where, light) in zip(panels, lights.items(), strict=True):
        for axes, (name, brdf) in zip(row, brdfs.items(), strict=True):
            found = prefilter(light, brdf, orders=_orders(brdf, place.quick), rows=rows)
            kept[name] = found
            values = shaded(found, normals, _VIEWER)
            picture = np.full((*inside.shape, 3), np.nan)
            picture[inside] = values
            shown = picture[inside.any(axis=1)][:, inside.any(axis=0)]
            draw_picture(axes, shown, float(np.percentile(values, 99)), name if where == names[0] else "")
        row[0].text(-0.05, 0.5, where, rotation=90, va="center", ha="right", transform=row[0].transAxes)
    found, fibres = kept[next(iter(brdfs))], kept[name]
    p = found.lobes[0].orders[1]
    with threadpool_limits(1):
        of_map = median_seconds(lambda: found.lobes[0].seen_from(_VIEWER))
        shading = median_seconds(lambda: shaded(found, normals, _VIEWER))
        slower = median_seconds(lambda: shaded(fibres, normals, _VIEWER))
        rays = median_seconds(lambda: cat.seen_from(_VIEWER))
    size = f"{cat.side} x {cat.side} pixels, {inside.sum()} of the cat"
    return Outcome(
        "about 30 frames per second (Pentium IV, Geforce2 GTS)",
        f"{1 / shading:.0f} frames per second of shading, {1 / (shading + rays):.0f} with rays to the mesh ({size})",
        f"One core, numpy, no GPU. A frame is one sum of {(p + 1) ** 2} maps of {rows} x {2 * rows} pixels (eq."
        f" 5.35, {1e3 * of_map:.1f} ms), as many pixels as the paper's cube map, and one lookup per pixel. Fibres"
        f" take P = {fibres.lobes[0].orders[1]} (R02, section 5.7.1) and reach {1 / slower:.0f} frames per second."
        " R02's lookups and shape are the graphics card's, and its pictures' size isn't printed. St. Peter's, the"
        " eucalyptus grove and CURET's materials aren't available: Pisa, MERL's orange paint and red fabric (Bagher's"
        " fits) stand in. Krylon blue is Cornell's measurement, its view factor kept out of the maps.",
        place.save(figure, "r02-fig5.1"),
    )


def _orders(brdf: CentredBrdf, quick: bool) -> tuple[int, int]:
    f, p = (6, 2) if quick else _ORDERS
    return f, p if brdf.axis == "normal" or quick else _FIBRES


def shaded(found: PrefilteredLight, normals: Singles, viewer: Floats) -> Singles:
    """Radiance (n, 3) of normals (n, 3) for a distant viewer: one map per lobe, looked up about its centre."""
    total = np.zeros((len(normals), 3), np.float32)
    for each in found.lobes:
        axes = _combed(normals) if found.brdf.axis == "tangent" else normals
        towards = viewer.astype(np.float32)
        centres = 2 * (axes @ towards)[:, None] * axes - towards if each.lobe.mirrored else axes
        total += looked_up(each.seen_from(viewer), centres)
    return total


def _combed(normals: Singles) -> Singles:
    """Tangents (n, 3), unit, straight down along the surface."""
    down = normals * normals[:, 2:] - np.array([0, 0, 1], np.float32)
    return np.asarray(down / np.maximum(np.linalg.norm(down, axis=1, keepdims=True), 1e-6))


def _brdfs(place: Workplace) -> dict[str, CentredBrdf]:
    folder = place.real("brdf")
    merl = bagher_lobes(folder)

    def whole(name: str, lobes) -> CentredBrdf:
        return CentredBrdf(name, (specular_lobe("whole", lobes, np.ones(3)),))

    microfacets = CentredLobe("whole", (simplified_microfacet(0.15),), np.ones(3), True)
    found = {"microfacets, σ = 0.15": CentredBrdf("microfacets", (microfacets,))}
    if not place.quick:
        found["krylon blue"] = whole("krylon blue", cornell_lobes(folder, "krylon_blue"))
        found["orange paint"] = whole("orange paint", merl["orange-paint"])
    found["red fabric"] = whole("red fabric", merl["red-fabric"])
    found["fibres (Kajiya-Kay)"] = chosen_brdf("kajiya-kay:32", {}).brdf
    return found
