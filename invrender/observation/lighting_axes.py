"""Whether known light, its map or its lamps would explain photographs far better in other axes, turned or mirrored.

Light is smoothed, shadows are left out, grazing views too, and the BRDF is any sum of a Lambertian part and lobes of
three widths: a rough judge, but a quick one that other faults don't mislead.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from capture.lighting import Lighting
from recon.harmonics.basis import clamped_cosine_transfer, degrees, evaluate_harmonics, to_degree
from recon.harmonics.complex import project_sources
from recon.harmonics.latlong import highest_degree, map_coefficients
from recon.harmonics.rotations import rotated_harmonics
from recon.placement.conventions import signed_axes
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]

# Degree to which light is looked at, and widths of lobes (rad), of which the narrowest is about what that resolves.
_L_MAX = 20
_WIDTHS = (0.1, 0.2, 0.4)
# Samples of each photograph that are looked at, and their least cosine of the exitant angle: grazing views are most of
# what such a sum of terms can't show (15% of a glossy lump's radiance with them, 5% without).
_SAMPLES, _LEAST_COS = 150, 0.5
# Of what is left unexplained (RMS), what other axes may leave at most to be believed; and of what likelier ones leave.
_FAR_BETTER, _BETTER = 0.6, 0.95
_OPPOSITE, _UPSIDE_DOWN = -np.eye(3), np.diag([1.0, 1.0, -1.0])


def other_frame(fields: Sequence[LightField], lightings: Sequence[Lighting]) -> str | None:
    """A sentence that says in which axes the light would explain photographs far better, None if in no others.

    lightings : the known one of each photograph.
    """
    thinned = [_thinned(field) for field in fields]
    lightings = [light for field, light in zip(thinned, lightings, strict=True) if len(field)]
    fields = [field for field in thinned if len(field)]
    if not fields:
        return None
    radiance = np.concatenate([field.radiance for field in fields])
    parts = {
        "its map": [_map_light(each) for each in lightings],
        "its lamps": [_lamps(each) for each in lightings],
    }
    parts = {name: lights for name, lights in parts.items() if any(light.any() for light in lights)}
    frames = _frames()
    shown = {name: _shown(fields, lights, frames) for name, lights in parts.items()}
    given = _left(radiance, [terms[0] for terms in shown.values()])
    best, found = _FAR_BETTER * given, None
    for turned in [tuple(parts), *((name,) for name in parts if len(parts) > 1)]:
        for k, frame in enumerate(frames):
            left = _left(radiance, [terms[k if name in turned else 0] for name, terms in shown.items()])
            if left < best:
                best, found = _BETTER * left, (turned, frame, left)
    if found is None:
        return None
    turned, frame, left = found
    what = " and ".join(turned) if len(turned) < len(parts) else "it"
    return (
        f"The light seems to be in other axes than the cameras: by a rough estimate it would leave {left:.0%} of the"
        f" radiance instead of {given:.0%} (RMS) if {what} were {_named(frame)}."
    )


def _thinned(field: LightField) -> LightField:
    steep = np.flatnonzero(field.cos_exitant >= _LEAST_COS)
    keep = np.zeros(len(field), bool)
    keep[steep[np.linspace(0, len(steep) - 1, min(len(steep), _SAMPLES)).astype(int)]] = True
    return field.where(keep)


def _map_light(lighting: Lighting) -> Floats:
    """Harmonic coefficients ((l + 1)^2, 3) of a lighting's map, zero without one."""
    if lighting.radiance_map is None:
        return np.zeros(((_L_MAX + 1) ** 2, 3))
    degree = min(_L_MAX, highest_degree(len(lighting.radiance_map)))
    return to_degree(map_coefficients(lighting.radiance_map, degree), _L_MAX)


def _lamps(lighting: Lighting) -> Floats:
    return np.asarray(project_sources(lighting.directions, lighting.irradiances, _L_MAX))


def _frames() -> list[Floats]:
    """The given axes, then all others (3, 3) that axes can be taken to, likelier ones before others."""

    def unlikely(frame: Floats) -> tuple[float, ...]:
        upright = frame[2, 2] == 1
        plain = np.array_equal(frame, _OPPOSITE) or np.array_equal(frame, _UPSIDE_DOWN)
        return 0 if upright else 1 if plain else 2, -np.linalg.det(frame).round(), -np.trace(frame)

    return sorted(signed_axes(), key=unlikely)


def _shown(fields: Sequence[LightField], lights: Sequence[Floats], frames: Sequence[Floats]) -> Floats:
    """What each term of the BRDF reflects (frames, n, terms, 3) of turned light; one light per photograph."""
    l = degrees(_L_MAX)
    kernels = np.stack(
        [clamped_cosine_transfer(_L_MAX)[l], *(np.exp(-((width * l) ** 2)) for width in _WIDTHS)]
    )
    rows = np.concatenate([light.T for light in lights])
    # Light at w is, turned, at frame w; a frame that mirrors is a turn and a reflection at the origin.
    turned = np.stack(
        [
            rotated_harmonics(rows * np.where(l % 2, hand, 1), hand * frame)
            for frame, hand in ((frame, round(np.linalg.det(frame))) for frame in frames)
        ]
    ).reshape(len(frames), len(lights), 3, -1)
    found = []
    for k, field in enumerate(fields):
        means = [field.mean_over_rays(evaluate_harmonics(d, _L_MAX)) for d in (field.normals, field.mirrored)]
        terms = [
            means[min(place, 1)] @ (kernel * turned[:, k]).reshape(-1, len(l)).T
            for place, kernel in enumerate(kernels)
        ]
        found.append(np.stack(terms).reshape(len(kernels), len(field), len(frames), 3).transpose(2, 1, 0, 3))
    return np.concatenate(found, axis=1)


def _left(radiance: Floats, terms: Sequence[Floats]) -> float:
    """Relative RMS that the best BRDF leaves of the radiance (n, 3) under the sum of parts of the light."""
    together = np.asarray(sum(terms))
    squares = sum(nnls(together[:, :, c], radiance[:, c])[1] ** 2 for c in range(3))
    return float(np.sqrt(squares / (radiance**2).sum()))


def _named(frame: Floats) -> str:
    """What `frame` does, in words."""
    if np.array_equal(frame, _OPPOSITE):
        return "pointing the other way (directions are from the object to the light)"
    if np.array_equal(frame, _UPSIDE_DOWN):
        return "upside down"
    turned = np.linalg.det(frame) > 0
    if frame[2, 2] == 1 and turned:
        degrees_ = np.degrees(np.arctan2(frame[1, 0], frame[0, 0]))
        return f"turned by {degrees_:.0f} degrees about +Z (from +X towards +Y)"
    to = ", ".join(f"{'-' if row.sum() < 0 else ''}{'xyz'[int(np.abs(row).argmax())]}" for row in frame)
    return f"{'turned' if turned else 'mirrored'}, what it has at (x, y, z) being at ({to})"
