"""R02's table 5.2: forms of the reflected light field, at the same accuracy.

One lobe (microfacets of sigma 0.2) under one light. The truth is integrated over angles in C for random mirrored
directions and views. Each form is made as small as its error allows: 3%, relative RMS.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from benchmarks.papers.entry import Outcome, Workplace
from benchmarks.papers.lookups import looked_up
from benchmarks.papers.overangles import Ints, OverAngles, Singles, over_angles
from benchmarks.papers.probes import probe
from benchmarks.papers.processortime import median_seconds, seconds
from capture.lighting import latlong_directions, latlong_pixels, latlong_solid_angles
from invrender.brdf.rh01 import simplified_microfacet
from invrender.output.prefilter.figure import ball_axes
from invrender.prefilter.bounds import LightingEnergy, error_bound, sphere_angles
from invrender.prefilter.centred import CentredLobe
from invrender.prefilter.globalmap import GlobalReflectionMap, global_map
from invrender.prefilter.prefiltered import reflected
from invrender.prefilter.reflectionmap import isotropic_terms, lobe_coefficients
from recon.harmonics.basis import degrees, evaluate_harmonics
from recon.harmonics.latlong import integrate_latlong
from recon.harmonics.rotations import rotated_harmonics

Floats = NDArray[np.float64]

_SIGMA, _F, _ACCURACY = 0.2, 20, 0.03
_LIGHT_ROWS, _ROWS = 40, 64
# The table is made of an SHRM of this order, and timed by angles on a part of its pixels.
_TABLE_ORDER, _TIMED = 14, 3000
_VIEWER = np.array([0.8, -0.36, 0.48])


@dataclass(frozen=True, eq=False)
class _Form:
    """error : relative RMS. size : bytes. render : of a picture, given mirrored directions of its pixels."""

    error: float
    size: int
    render: Callable[[], object]
    said: str


@dataclass(frozen=True, eq=False)
class _Trial:
    """Random places where forms are judged. centres, views : (n, 3). truth : (n, 3)."""

    centres: Singles
    views: Singles
    truth: Singles

    @classmethod
    def of(cls, angles: OverAngles, light: Singles, count: int) -> _Trial:
        pixels, views = _random_places(len(light), count)
        truth = angles.microfacets(light, pixels, views, _SIGMA, 1e-6)
        return cls(latlong_directions(len(light)).reshape(-1, 3)[pixels].astype(np.float32), views, truth)

    def off(self, found: NDArray[np.floating]) -> float:
        """Relative RMS error of radiance (n, 3)."""
        return float(np.sqrt(np.mean((found - self.truth) ** 2) / np.mean(self.truth**2)))


def forms_compared(place: Workplace) -> Outcome:
    """Bytes, seconds and what is known of the error beforehand, of five forms."""
    quick = place.quick
    light = probe(place, "Grace Cathedral", 12 if quick else _LIGHT_ROWS).astype(np.float32)
    rows, order = (20, 6) if quick else (_ROWS, _TABLE_ORDER)
    accuracy = 0.15 if quick else _ACCURACY
    lobe = CentredLobe("whole", (simplified_microfacet(_SIGMA),), np.ones(3), True)
    with over_angles() as angles, threadpool_limits(1):
        trial = _Trial.of(angles, light, 400 if quick else 4000)
        rho, _ = lobe_coefficients(lobe.lobes[0], _F, order)
        light_power = integrate_latlong(light, 2 * _F + 8)
        lighting = light_power[: (_F + 1) ** 2]
        world = global_map(reflected(lobe, rho[None], lighting, rows))
        by_angle = _seconds_per_value(angles, light, 300 if quick else _TIMED)
        normals, _ = ball_axes(_VIEWER, 40 if quick else 200, False)
        pixels = (2 * (normals @ _VIEWER)[:, None] * normals - _VIEWER).astype(np.float32)

        tabular, table = _smallest(_tables(trial, world, pixels), accuracy)
        finest = _table(world, 12)
        values = finest.reshape(len(finest), -1)
        work: list[Callable[[], object]] = []
        made = seconds(lambda: work.append(_decomposed(values)))
        parts = _decomposed(values)
        compressed, _ = _smallest(_factored(trial, parts, finest.shape, pixels, True), accuracy)
        factored, _ = _smallest(_factored(trial, parts, finest.shape, pixels, False), accuracy)
        shrm, p = _smallest(_shrms(trial, world, pixels), accuracy)
        kept = rho[:, : p + 1, : p + 1]
        coefficients = _coefficients(trial, lighting, kept, normals)
        prefiltering = median_seconds(
            partial(_prefiltered, lobe.lobes[0], light, _F, p, rows), 1 if quick else 3, 0.01
        )
        projecting = median_seconds(partial(_expanded, lobe.lobes[0], light, _F, p), 1 if quick else 3, 0.01)
        dense = by_angle * values.size / 3
        own = by_angle * 2 * table**2 * 2 * rows**2
        found = {
            "tabular": (tabular, own, "from the dense table alone"),
            "compressed": (compressed, dense + made, "from the dense table alone"),
            "factored": (factored, dense + made, "from the dense table alone"),
            "coefficients": (coefficients, projecting, "beforehand"),
            "SHRM": (shrm, prefiltering, "beforehand"),
        }
        bound = _stated(lobe, kept, light_power, light)
        table_rows = [
            ["form", "of", "off by", "bytes", "prefilter [s]", "render a picture [s]", "error is known"]
        ]
        for name, (form, prefiltered, known) in found.items():
            render = median_seconds(form.render, 1 if quick else 3, 0.01 if quick else 0.1)
            cells = [
                name,
                form.said,
                f"{form.error:.1%}",
                f"{form.size:,}",
                f"{prefiltered:.3g}",
                f"{render:.2g}",
            ]
            table_rows.append([*cells, known])
    return Outcome(
        "SHRM: compact, quick to render, analysed beforehand, quick to compute; no other form is all of it",
        f"SHRM {shrm.size / 1e6:.1f} MB in {prefiltering:.2g} s; factored {factored.size / 1e6:.1f} MB in"
        f" {dense + made:.0f} s; tabular {tabular.size / 1e6:.0f} MB in {own:.0f} s",
        f"At {accuracy:.0%} (relative RMS over {len(trial.truth)} random directions and views, against sums over"
        f" angles), microfacets of σ = {_SIGMA} under Grace Cathedral on {len(light)} rows. Speed and analysis hold"
        f" as printed: before any map was made, the powers of light and lobe said {bound:.1%} for the SHRM."
        " Compactness holds against tables alone: factors are optimal for their table, need fewer terms than"
        " harmonics of the view, and are smaller. All but coefficients are rendered by one dynamic map of the viewer,"
        " so that R02's `Maybe` and `Yes` are equal. Tables, compressed by PCA and 8 bits or factored by SVD, are"
        f" over a distant viewer's direction; seconds of their making are those of integration in C, from"
        f" {300 if quick else _TIMED} of its values. Made of an SHRM instead, the same table takes less than a"
        " second. Coefficients are kept as L_lm and ρ_lpq, from which B_lmpq follow.",
        table=table_rows,
    )


def _smallest(forms: Iterator[tuple[_Form, int]], accuracy: float) -> tuple[_Form, int]:
    """The first of the forms, which grow, that is accurate enough; the last if none is."""
    found = None
    for found in forms:
        if found[0].error <= accuracy:
            break
    assert found is not None
    return found


def _tables(trial: _Trial, world: GlobalReflectionMap, pixels: Singles) -> Iterator[tuple[_Form, int]]:
    for side in (4, 6, 8, 12, 16, 24, 32, 40):
        maps = _table(world, side)

        def seen(maps: Singles = maps) -> Singles:
            return looked_up(_between_views(maps, _VIEWER), pixels)

        found = _each_view(trial, lambda view, maps=maps: _between_views(maps, view))
        yield _Form(trial.off(found), maps.nbytes, seen, f"{side} x {2 * side} views"), side


def _factored(
    trial: _Trial,
    parts: tuple[Singles, Singles, Singles],
    shape: tuple[int, ...],
    pixels: Singles,
    coarse: bool,
) -> Iterator[tuple[_Form, int]]:
    """A mean and factors of a table, as 8-bit whole numbers if coarse, of rising number."""
    mean, weights, maps = parts
    side = int(np.sqrt(shape[0] / 2))
    for count in (1, 2, 3, 4, 6, 8, 11, 15, 20, 26, 33, 41, 50):
        kept, small = maps[:count], weights[:, :count]
        if coarse:
            steps = np.abs(kept).max(axis=1, keepdims=True) / 127
            whole = np.round(kept / steps).astype(np.int8)
            size = whole.nbytes + small.nbytes + mean.nbytes // 4
        else:
            steps, whole, size = np.float32(1), kept, kept.nbytes + small.nbytes + mean.nbytes

        def map_of(view: Floats, small=small, whole=whole, steps=steps) -> Singles:
            turned = _between_views(small.reshape(2 * side**2, -1, 1, 1), view).ravel()
            return (mean + (turned * np.ravel(steps)) @ whole.astype(np.float32)).reshape(shape[1:])

        def seen(map_of=map_of) -> Singles:
            return looked_up(map_of(_VIEWER), pixels)

        word = "8-bit terms" if coarse else "terms"
        yield (
            _Form(
                trial.off(_each_view(trial, map_of)), size, seen, f"{count} {word}, {side} x {2 * side} views"
            ),
            count,
        )


def _shrms(trial: _Trial, world: GlobalReflectionMap, pixels: Singles) -> Iterator[tuple[_Form, int]]:
    for p in range(1, int(np.sqrt(len(world.maps)))):
        few = GlobalReflectionMap(world.maps[: (p + 1) ** 2])

        def seen(few: GlobalReflectionMap = few) -> Singles:
            return looked_up(few.seen_from(_VIEWER[None])[0], pixels)

        found = _each_view(trial, lambda view, few=few: few.seen_from(view[None])[0])
        yield _Form(trial.off(found), few.maps.nbytes, seen, f"P = {p}: {(p + 1) ** 2} terms"), p


def _coefficients(trial: _Trial, lighting: Floats, rho: Floats, normals: Floats) -> _Form:
    terms, _ = isotropic_terms(rho)

    def radiance(centres: Floats, views: Floats) -> Floats:
        # The lobe of each view, about +Z, turned to its centre, times the light.
        level = np.linalg.norm(centres[:, :2], axis=1)
        y = np.stack([-centres[:, 1] / level, centres[:, 0] / level, 0 * level], axis=-1)
        frames = np.stack([np.cross(y, centres), y, centres], axis=-1)
        basis = evaluate_harmonics(np.einsum("nkj,nk->nj", frames, views), rho.shape[1] - 1)
        l, of_term = degrees(len(rho) - 1), _places_of_orders(rho.shape[1] - 1)
        lobes = np.zeros((len(centres), len(l)))
        for k, q in enumerate(of_term):
            here = np.arange(abs(q), len(rho))
            lobes[:, here * (here + 1) + q] += basis[:, [k]] * terms[here, k]
        return rotated_harmonics(lobes, frames) @ lighting

    centres = 2 * (normals @ _VIEWER)[:, None] * normals - _VIEWER
    views = trial.views.astype(float)
    views /= np.linalg.norm(views, axis=1, keepdims=True)
    error = trial.off(radiance(latlong_unit(trial.centres), views))
    size = 4 * (lighting.size + int(np.count_nonzero(rho)))
    said = f"F = {len(rho) - 1}, P = {rho.shape[1] - 1}"
    return _Form(error, size, lambda: radiance(centres, np.broadcast_to(_VIEWER, centres.shape)), said)


def latlong_unit(directions: Singles) -> Floats:
    """Directions in double precision, of length 1 to that."""
    found = directions.astype(float)
    return np.asarray(found / np.linalg.norm(found, axis=1, keepdims=True))


def _places_of_orders(p_max: int) -> list[int]:
    return [q for p in range(p_max + 1) for q in range(-p, p + 1)]


def _each_view(trial: _Trial, map_of: Callable[[Floats], Singles]) -> Singles:
    """Radiance (n, 3) at the trial's places; each view has some of them."""
    found = np.empty_like(trial.truth)
    different, which = np.unique(trial.views, axis=0, return_inverse=True)
    for k, view in enumerate(different):
        own = np.flatnonzero(which == k)
        unit = view.astype(float) / np.linalg.norm(view.astype(float))
        found[own] = looked_up(map_of(unit), trial.centres[own])
    return found


def _random_places(rows: int, count: int) -> tuple[Ints, Singles]:
    """Pixels (n,) of a map, as often as they are large, and views (n, 3), n / 40 different ones."""
    rng = np.random.default_rng(5)
    size = np.broadcast_to(latlong_solid_angles(rows), (rows, 2 * rows)).ravel()
    pixels = rng.choice(len(size), count, p=size / size.sum()).astype(np.int32)
    views = rng.normal(size=(max(count // 40, 1), 3))
    views /= np.linalg.norm(views, axis=1, keepdims=True)
    return pixels, np.ascontiguousarray(np.tile(views, (-(-count // len(views)), 1))[:count], np.float32)


def _table(world: GlobalReflectionMap, side: int) -> Singles:
    """Maps (2 side^2, 3, H, 2H) of viewers all around, on a lat-long grid of `side` rows."""
    return world.seen_from(latlong_directions(side).reshape(-1, 3))


def _between_views(maps: Singles, view: Floats) -> Singles:
    """The map of a view between four of a lat-long grid's, linear."""
    side = int(np.sqrt(len(maps) / 2))
    row, column = (float(each[0]) - 0.5 for each in latlong_pixels(view[None], side))
    total = 0
    for down in (0, 1):
        for right in (0, 1):
            r, c = int(np.floor(row)) + down, int(np.floor(column)) + right
            share = (1 - abs(row - r)) * (1 - abs(column - c))
            if not 0 <= r < side:  # over a pole
                r, c = int(np.clip(r, 0, side - 1)), c + side
            total = total + np.float32(share) * maps[r * 2 * side + c % (2 * side)]
    return np.asarray(total)


def _decomposed(values: Singles) -> tuple[Singles, Singles, Singles]:
    """Mean (m,), weights (n, k) and maps (k, m), the strongest first, of a table (n, m): its SVD."""
    mean = values.mean(axis=0)
    centred = values - mean
    # By the smaller matrix of products, in double precision.
    _, vectors = np.linalg.eigh((centred @ centred.T).astype(float))
    weights = vectors[:, ::-1][:, :60].astype(np.float32)
    return mean, weights, weights.T @ centred


def _seconds_per_value(angles: OverAngles, light: Singles, count: int) -> float:
    """Of integration over angles, per direction and view, of all channels, at the paper's 5%."""
    pixels, views = _random_places(len(light), count)
    return median_seconds(lambda: angles.microfacets(light, pixels, views, _SIGMA), 3, 0) / count


def _expanded(lobe, light: Singles, f: int, p: int) -> tuple[Floats, Floats]:
    return lobe_coefficients(lobe, f, p)[0], integrate_latlong(light, f)


def _prefiltered(lobe, light: Singles, f: int, p: int, rows: int) -> GlobalReflectionMap:
    rho, lighting = _expanded(lobe, light, f, p)
    centred = CentredLobe("whole", (lobe,), np.ones(3), True)
    return global_map(reflected(centred, rho[None], lighting, rows))


def _stated(lobe: CentredLobe, rho: Floats, coefficients: Floats, light: Singles) -> float:
    """The relative RMS error over all directions and views that the powers of light and lobe say."""
    # Over the sphere of views about the centre: the angle to the normal is half of theirs.
    cos_view, weights = sphere_angles(24)
    cos_angles = np.sqrt((1 + cos_view) / 2)
    bound = error_bound(lobe, rho[None], LightingEnergy.of(coefficients, light), cos_angles, weights)
    return float(np.sqrt((bound.picture_rms**2).sum() / (bound.picture_reflected**2).sum()))
