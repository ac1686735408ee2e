"""The candidates: what may be wrong with photographs, each in the numbers that say how much."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.lobes import GGX_FORM
from invrender.brdf.microfacet import Microfacet
from invrender.diagnostics.altered import Alteration, shown, source_parts
from invrender.diagnostics.cause import Cause, common, each
from invrender.diagnostics.remainder import Remainder, Remainders

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Cells of the surface to the object's radius, and by how much the albedo is likely to differ from one to another.
_CELLS, _PAINT = 4, 0.3
# Widths of lobes beside the fitted one, over its own; and of a matte object's, radians.
_WIDTHS, _MATTE_WIDTH = (0.4, 2.0, 4.0), 0.15
# Sizes of numbers beyond which they are unlikely: nearness, radians, powers, radii, logarithm of widths' ratio.
_NEAR, _TURN, _POWER, _SHIFT, _STRETCH = 0.15, 0.1, 0.5, 0.05, 1.0
_DIELECTRIC = 1.5
_NOWHERE = np.zeros(0, int)


def no_cause(scene: Remainders) -> Cause:
    """Nothing wrong: what the others are compared with."""
    return Cause("none", 0, (_NOWHERE,) * len(scene.photos), starts=_simpler(scene.brdf))


def candidates(scene: Remainders) -> list[Cause]:
    """All causes that the photographs could show, those with few numbers first; of a brushed lobe it isn't one."""
    found = [
        near_lamp(scene),
        *(brushed(scene, axis) for axis in range(3) if scene.brdf.form.axis is None),
        curve(scene),
        offset(scene),
        lobe(scene),
        shading(scene),
        place(scene),
        brightness(scene),
        direction(scene),
        pose(scene),
        stains(scene),
    ]
    return [cause for cause in found if cause is not None]


def near_lamp(scene: Remainders) -> Cause | None:
    """All lamps at one distance from the object; its number is the object's radius over that.

    None where the fit has sought each one's distance.
    """
    if not _has_sources(scene) or any("distance" in photo.recovered for photo in scene.photos):
        return None
    return Cause(
        "near lamp",
        1,
        common(len(scene.photos), 1),
        _NEAR,
        alter=lambda _, numbers: Alteration(nearness=float(numbers[0])),
        step=0.01,
        starts=_simpler(scene.brdf),
    )


def brushed(scene: Remainders, axis: int) -> Cause | None:
    """Highlights drawn out along circles about an axis of the world, or across; see `Alteration.stretch`."""
    if not _has_sources(scene):
        return None
    glossy = _glossy(scene.brdf)
    assert glossy.sigma is not None
    facets = replace(glossy, form=GGX_FORM, mu=glossy.mu or _DIELECTRIC)
    return Cause(
        f"brushed about {'xyz'[axis]}",
        1,
        common(len(scene.photos), 1),
        _STRETCH,
        alter=lambda _, numbers: Alteration(stretch=float(numbers[0]), axis=axis),
        step=0.05,
        starts=(facets, *(() if scene.brdf.sigma is not None else (glossy,))),
    )


def curve(scene: Remainders) -> Cause:
    """Radiance to a power; its numbers are the power less one, and how it varies with the logarithm of radiance."""
    radiance = np.concatenate([photo.field.radiance.ravel() for photo in scene.photos])
    level = float(np.sqrt(np.mean(radiance**2)))

    def finish(total: Floats, numbers: Floats) -> Floats:
        stops = np.log(np.maximum(np.abs(total), 1e-6 * level) / level)
        return np.asarray(total * np.exp(numbers[0] * stops + numbers[1] * stops**2))

    starts = _simpler(scene.brdf)
    return Cause("curve", 2, common(len(scene.photos), 2), _POWER, finish=finish, step=0.01, starts=starts)


def offset(scene: Remainders) -> Cause:
    """The same radiance added everywhere; its numbers are that, per channel."""
    columns = tuple(np.broadcast_to(np.eye(3), (len(photo.field), 3, 3)) for photo in scene.photos)
    return Cause("offset", 3, common(len(columns), 3), columns=columns)


def lobe(scene: Remainders) -> Cause:
    """Highlights of another form; its numbers are shares of Ks in lobes of other widths."""
    columns = tuple(np.stack(_lobes(scene, photo), axis=-1) for photo in scene.photos)
    size = columns[0].shape[-1]
    return Cause("lobe", size, common(len(columns), size), columns=columns)


def shading(scene: Remainders) -> Cause | None:
    """Shading that isn't Lambert's; its numbers are shares of Kd towards grazing incidence, exitance, and both."""
    if not _has_sources(scene):
        return None
    columns = tuple(_flattened(scene, photo) for photo in scene.photos)
    return Cause("shading", 3, common(len(columns), 3), columns=columns)


def place(scene: Remainders) -> Cause:
    """The object elsewhere; its numbers are the shift, in its radii.

    Its size is no candidate: it turns normals at the rim most, and what any BRDF leaves at grazing views looks alike.
    """
    shared = common(len(scene.photos), 3)
    return Cause("place", 3, shared, _SHIFT, alter=lambda _, numbers: Alteration(shift=numbers))


def brightness(scene: Remainders) -> Cause:
    """Photographs as a whole brighter or darker; its numbers are by what share, of each."""
    columns = tuple(_total(scene, photo)[..., None] for photo in scene.photos)
    return Cause("brightness", len(columns), each(len(columns), 1), columns=columns)


def direction(scene: Remainders) -> Cause | None:
    """Sources elsewhere; its numbers are two turns of each source of each lighting, radians."""
    places: dict[str, Ints] = {}
    count = 0
    for photo in scene.photos:
        if photo.lighting not in places and "direction" not in photo.recovered:
            places[photo.lighting] = np.arange(count, count + 2 * len(photo.directions))
            count += 2 * len(photo.directions)
    if not count:
        return None
    touches = tuple(places.get(photo.lighting, _NOWHERE) for photo in scene.photos)

    def alter(k: int, numbers: Floats) -> Alteration:
        return Alteration(turns=numbers[touches[k]].reshape(-1, 2)) if len(touches[k]) else Alteration()

    return Cause("direction", count, touches, _TURN, alter=alter)


def pose(scene: Remainders) -> Cause:
    """Cameras elsewhere; its numbers are shifts of the object against each of them, in its radii."""
    touches = each(len(scene.photos), 3)
    return Cause(
        "pose",
        3 * len(touches),
        touches,
        _SHIFT,
        alter=lambda k, numbers: Alteration(shift=numbers[touches[k]]),
    )


def stains(scene: Remainders) -> Cause:
    """An albedo that varies over the surface; its numbers are shares of Kd by which each cell of it differs."""
    cells = [_cells(scene, photo) for photo in scene.photos]
    names, number = np.unique(np.concatenate(cells), return_inverse=True)
    columns, touches = [], []
    ends = np.cumsum([len(own) for own in cells])[:-1]
    for photo, own in zip(scene.photos, np.split(number, ends), strict=True):
        here, which = np.unique(own, return_inverse=True)
        varied = np.zeros((len(own), 3, len(here)))
        varied[np.arange(len(own)), :, which] = scene.brdf.kd * shown(scene, photo, scene.brdf)[0]
        columns.append(varied)
        touches.append(here)
    return Cause("stains", len(names), tuple(touches), _PAINT, columns=tuple(columns))


def _has_sources(scene: Remainders) -> bool:
    return any(len(photo.directions) for photo in scene.photos)


def _simpler(brdf: Microfacet) -> tuple[Microfacet, ...]:
    """Simpler BRDFs than one that a fit under a wrong model chose, which may have bent it to the cause."""
    if brdf.sigma is None and not brdf.form.interface:
        return ()
    matte = Microfacet(brdf.kd, np.zeros(3), None, None)
    if brdf.sigma is None:
        return (matte,)
    over = replace(brdf, form=brdf.form.lobe)
    return (matte, replace(over, sigma=_MATTE_WIDTH), *((over,) if brdf.form.interface else ()))


def _glossy(brdf: Microfacet) -> Microfacet:
    """A BRDF, with a lobe if it has none."""
    if brdf.sigma is not None and brdf.ks.any():
        return brdf
    return replace(brdf, ks=np.full(3, brdf.kd.mean()), sigma=_MATTE_WIDTH)


def _total(scene: Remainders, photo: Remainder) -> Floats:
    diffuse, specular = shown(scene, photo, scene.brdf)
    return np.asarray(scene.brdf.kd * diffuse + scene.brdf.ks * specular)


def _lobes(scene: Remainders, photo: Remainder) -> list[Floats]:
    brdf = _glossy(scene.brdf)
    assert brdf.sigma is not None
    widths = _WIDTHS if brdf is scene.brdf else (*_WIDTHS, 1.0)
    sigmas = [min(width * brdf.sigma, 1.0) for width in widths]
    return [brdf.ks * shown(scene, photo, replace(brdf, sigma=sigma))[1] for sigma in sigmas]


def _flattened(scene: Remainders, photo: Remainder) -> Floats:
    field = photo.field
    total = np.zeros((len(field), 3, 3))
    leaving = 1 - np.clip((field.normals * field.views).sum(axis=1), 0, 1)[:, None]
    for k, towards in enumerate(photo.directions):
        here = scene.brdf.kd * source_parts(scene, photo, scene.brdf, k, field)[0]
        arriving = 1 - np.clip(field.normals @ towards, 0, 1)[:, None]
        parts = (here * arriving, here * leaving, here * arriving * leaving)
        total += np.stack([field.mean_over_rays(part) for part in parts], axis=-1)
    return total


def _cells(scene: Remainders, photo: Remainder) -> Ints:
    """A number (n,) for the cell of space that each sample's first ray lies in, the same in all photographs."""
    field = photo.field
    first = np.searchsorted(field.ray_sample, np.arange(len(field)))
    cell = np.floor((field.positions[first] - scene.centre) / scene.radius * _CELLS).astype(int)
    return np.asarray(cell @ np.array([1_000_000, 1000, 1]))
