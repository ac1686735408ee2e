"""The reflected light field as linear columns per photograph, whatever mu and sigma turn out to be.

[RH01, eq. 24] for one channel and one photograph is

    B = sum_e x_e ( Kd sum_i b_i(mu) d_ei + Ks sum_kj a_k(mu) c_j(sigma) m_ekj )

with lighting elements e of strength x_e, diffuse transfers d_ei and specular transfers m_ekj that hold
neither mu nor sigma: Fresnel's factor is a short sum in k, the lobe is interpolated between nodes j. So it is for
every form of the specular part; only the m_ekj differ. Above a Lambertian base there is one d_e, and b is 1; what an
interface transmits is a short sum in i.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from dataclasses import field as defaulted
from functools import cached_property
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from capture.parallel import parallel_map
from capture.tasks.stage import stage_results
from invrender.brdf.form import LobeForm, Numbers
from invrender.brdf.lobes import RH01_FORM
from invrender.transport.column_basis import ColumnBasis, basis_of, whole_range
from invrender.transport.diffuse_base import base_columns, base_size, base_weights
from invrender.transport.form_transfer import forms_transfer
from invrender.transport.transfer import LightElement
from invrender.transport.visibility import Rays, RayVisibility, Shadows, seen_specular
from recon.sampling.lightfield import LightField, blocks, joined, pools

Floats = NDArray[np.float64]
# Of each lighting, by name.
Elements = Mapping[str, Sequence[LightElement]]

# What is kept of columns until the result is there.
COLUMNS_STAGE = "columns"
# Memory then doesn't grow with a photograph's rays.
_RAYS_AT_A_TIME = 4096


@dataclass(frozen=True, eq=False)
class PhotoColumns:
    """The columns of one photograph's samples.

    lighting : name of its lighting. elements : names of the lighting's elements.
    columns : (channels, n, elements, q) float32; channels is 1 where all share them. The first of the last axis are the
        d, one of a Lambertian base, then m with j fastest.
    field : the samples. form : of the specular part. shadows : that they were made with, if any. basis : what m are
        tabulated for.
    """

    lighting: str
    elements: tuple[str, ...]
    columns: NDArray[np.float32]
    field: LightField
    form: LobeForm = RH01_FORM
    shadows: Shadows | None = None
    basis: ColumnBasis = defaulted(default_factory=whole_range)

    @property
    def radiance(self) -> Floats:
        return self.field.radiance

    def less(self, radiance: Floats) -> PhotoColumns:
        """The same samples without a part (n, 3) of their radiance."""
        return replace(self, field=self.field.less(radiance))

    def where(self, keep: NDArray[np.bool_]) -> PhotoColumns:
        """The samples marked by a mask (n,)."""
        return replace(self, columns=self.columns[:, keep], field=self.field.where(keep))


def sample_count(photos: Sequence[PhotoColumns]) -> int:
    """How many samples photographs have together."""
    return sum(len(photo.field) for photo in photos)


def together(photos: Sequence[PhotoColumns]) -> PhotoColumns:
    """Photographs under one lighting as one, in columns of one form."""
    if len(photos) == 1:
        return photos[0]
    columns = np.concatenate([photo.columns for photo in photos], axis=1)
    return replace(photos[0], columns=columns, field=joined([photo.field for photo in photos]))


def pooled_columns(
    photos: Sequence[PhotoColumns], weights: Sequence[Floats]
) -> Iterator[tuple[PhotoColumns, Floats]]:
    """Photographs with weights (n, ...) of their samples, those under one lighting with few samples as one."""
    for pool in pools([photo.field for photo in photos], [photo.lighting for photo in photos]):
        yield together([photos[k] for k in pool]), np.concatenate([weights[k] for k in pool])


def photo_columns(
    lighting: str,
    elements: Sequence[LightElement],
    field: LightField,
    form: LobeForm = RH01_FORM,
    shadows: Shadows | None = None,
    diffuse: NDArray[np.float32] | None = None,
    basis: ColumnBasis | None = None,
) -> PhotoColumns:
    """Columns of a photograph's samples under a lighting given by its elements.

    shadows : of a mesh, if it has any. diffuse : (channels, n, elements), d of a Lambertian base if it is known.
    basis : `basis_of` the form if None.
    """
    basis = basis or basis_of(form)
    (columns,) = _columns(elements, field, (form,), shadows, diffuse, basis)
    return PhotoColumns(lighting, _names(elements), columns, field, form, shadows, basis)


def _names(elements: Sequence[LightElement]) -> tuple[str, ...]:
    return tuple(element.name for element in elements)


def _columns(
    elements: Sequence[LightElement],
    field: LightField,
    forms: Sequence[LobeForm],
    shadows: Shadows | None,
    diffuse: NDArray[np.float32] | None,
    basis: ColumnBasis,
) -> list[NDArray[np.float32]]:
    """Columns of a field's samples, of each form; fields of the arguments as of `columns_of_forms`."""
    nodes, fresnel = basis.sigmas, basis.functions(forms[0])
    channels = max(element.channels for element in elements)
    tabulated = {form: basis.tabulated(form) for form in forms}
    lobes = list(dict.fromkeys(chain.from_iterable(tabulated.values())))
    of_lobe = fresnel(np.ones(1)).shape[-1] * len(nodes)
    size = of_lobe * len(tabulated[forms[0]])
    shape = channels, len(field), len(elements)
    # By lobe and size of the base, which separates the kinds of base; forms that share both share columns.
    found = {
        (tabulated[form], base_size(form)): np.empty((*shape, base_size(form) + size), np.float32)
        for form in forms
    }
    bases = {base_size(form): form for form in forms}
    for block, part in blocks(field, _RAYS_AT_A_TIME):
        for e, element in enumerate(elements):
            visible = None if shadows is None else shadows.visible(element, part)

            means: NDArray[np.floating] = np.zeros((len(part), len(lobes), of_lobe, channels))
            for light, field_seen, its in _by_rays(element, part, visible) if size else []:

                def gather(
                    light: LightElement, rays: Rays, seen: LightField = field_seen
                ) -> NDArray[np.floating]:
                    here = light.at(seen.positions[rays])
                    return forms_transfer(lobes, here, seen.normals[rays], seen.views[rays], nodes, fresnel)

                specular = seen_specular(light, its, gather)
                own = field_seen.mean_over_rays(specular.reshape(len(specular), len(lobes), of_lobe, -1))
                means = means + own
            means = part.filtered(means)
            below: dict[int, NDArray[np.floating]] = {}
            for first, form in bases.items():
                if first == 1 and diffuse is not None:
                    below[1] = diffuse[:, block, e, None]
                else:
                    here = element.at(part.positions)
                    base = base_columns(form, here, part.normals, part.views, visible)
                    below[first] = part.mean_over_rays(base).transpose(2, 0, 1)
            for (held, first), columns in found.items():
                columns[:, block, e, :first] = below[first]
                for k, lobe in enumerate(held):
                    place = slice(first + k * of_lobe, first + (k + 1) * of_lobe)
                    columns[:, block, e, place] = means[:, lobes.index(lobe)].transpose(2, 0, 1)
    return [found[tabulated[form], base_size(form)] for form in forms]


def _by_rays(
    element: LightElement, field: LightField, visible: RayVisibility | None
) -> list[tuple[LightElement, LightField, RayVisibility | None]]:
    """An element's sources with all rays of samples, and its map with as few as show it; and what these see of it."""
    means = None if element.prepared_map is None else field.neighbours(element.prepared_map.even)
    if means is None:
        return [(element, field, visible)]
    rest = element.without_sources, field.averaged(means), None if visible is None else visible.of_map(means)
    if not len(element.directions):
        return [rest]
    return [(element.sources_alone, field, None if visible is None else visible.of_sources), rest]


def all_columns(
    lightings: Sequence[str],
    elements: Elements,
    fields: Sequence[LightField],
    form: LobeForm = RH01_FORM,
    shadows: Shadows | None = None,
    diffuse: Sequence[NDArray[np.float32]] | None = None,
    basis: ColumnBasis | None = None,
) -> list[PhotoColumns]:
    """`photo_columns` of each photograph, as tasks of a stage, those with few samples made together.

    lightings : the name of each one's. elements : of lightings by their names. diffuse : the column d of each, of a
    Lambertian base. basis : `basis_of` the form if None.
    """
    return columns_of_forms(lightings, elements, fields, (form,), shadows, diffuse, basis)[form]


def columns_of_forms(
    lightings: Sequence[str],
    elements: Elements,
    fields: Sequence[LightField],
    forms: Sequence[LobeForm],
    shadows: Shadows | None = None,
    diffuse: Sequence[NDArray[np.float32]] | None = None,
    basis: ColumnBasis | None = None,
) -> dict[LobeForm, list[PhotoColumns]]:
    """`all_columns` of several forms of facets, or of one form of any kind: facets look at the same rays of light.

    So do brushed forms of one window. What the tasks return is kept as of `stage_results`.
    """
    made = _Made(lightings, elements, fields, forms, shadows, diffuse, basis or basis_of(forms[0]))
    return made.by_form(stage_results(COLUMNS_STAGE, made, made.pools, made.named))


@dataclass(frozen=True, eq=False)
class _Made:
    """Makes columns of photographs under one lighting, of each form; as of `columns_of_forms`."""

    lightings: Sequence[str]
    elements: Elements
    fields: Sequence[LightField]
    forms: Sequence[LobeForm]
    shadows: Shadows | None
    diffuse: Sequence[NDArray[np.float32]] | None
    basis: ColumnBasis

    @cached_property
    def pools(self) -> list[list[int]]:
        """Places of photographs that are worked on at once."""
        return pools(self.fields, self.lightings)

    def __call__(self, pool: Sequence[int]) -> list[NDArray[np.float32]]:
        """Columns of the samples of photographs, by their places, one after the other."""
        elements, field = self.elements[self.lightings[pool[0]]], joined([self.fields[k] for k in pool])
        known = None if self.diffuse is None else np.concatenate([self.diffuse[k] for k in pool], axis=1)
        return _columns(elements, field, self.forms, self.shadows, known, self.basis)

    def named(self, pool: Sequence[int]) -> str:
        """Photographs in words."""
        return f"what samples of {len(pool)} photographs under {self.lightings[pool[0]]!r} reflect"

    def by_form(self, results: Iterable[list[NDArray[np.float32]]]) -> dict[LobeForm, list[PhotoColumns]]:
        """What was made of all pools, photograph by photograph."""
        found: list[list[PhotoColumns]] = [[] for _ in self.forms]
        for pool, wholes in zip(self.pools, results, strict=True):
            ends = np.cumsum([len(self.fields[k]) for k in pool])[:-1]
            for own, form, whole in zip(found, self.forms, wholes, strict=True):
                parts = np.split(whole, ends, axis=1)
                own += [self._photo(k, form, part) for k, part in zip(pool, parts, strict=True)]
        order = np.argsort([k for pool in self.pools for k in pool])
        return {form: [own[place] for place in order] for own, form in zip(found, self.forms, strict=True)}

    def _photo(self, k: int, form: LobeForm, columns: NDArray[np.float32]) -> PhotoColumns:
        name = self.lightings[k]
        names = _names(self.elements[name])
        return PhotoColumns(name, names, columns, self.fields[k], form, self.shadows, self.basis)


def columns_of(
    forms: Sequence[LobeForm], photos: Sequence[PhotoColumns], elements: Elements
) -> dict[LobeForm, list[PhotoColumns]]:
    """The same samples with columns of other forms: of several of facets, or of one."""
    return columns_of_forms(
        [photo.lighting for photo in photos],
        elements,
        [photo.field for photo in photos],
        forms,
        photos[0].shadows,
        [photo.columns[..., 0] for photo in photos],
    )


def columns_under(elements: Elements, photos: Sequence[PhotoColumns], form: LobeForm) -> list[PhotoColumns]:
    """The same samples under other light, its elements by the lightings' names, in columns of a form.

    They are kept nowhere: each step of a search has its own.
    """
    names, fields = [photo.lighting for photo in photos], [photo.field for photo in photos]
    made = _Made(names, elements, fields, (form,), photos[0].shadows, None, basis_of(form))
    return made.by_form(parallel_map(made, made.pools))[form]


def column_weights(
    mu: float | Floats | None,
    sigma: float | Floats,
    form: LobeForm = RH01_FORM,
    numbers: Numbers | None = None,
    basis: ColumnBasis | None = None,
) -> Floats:
    """What columns count for in the transfers of base and lobe, (q, 2); at several mu and sigma, (f, q, 2).

    numbers : as of `ColumnBasis.weights`. basis : `basis_of` the form if None.
    """
    specular = (basis or basis_of(form)).weights(mu, sigma, form, numbers)
    size = base_size(form)
    result = np.zeros((*specular.shape[:-1], size + specular.shape[-1], 2))
    result[..., :size, 0] = base_weights(form, mu, (numbers or {}).get("coat"))
    result[..., size:, 1] = specular
    return result
