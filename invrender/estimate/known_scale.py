"""What references of known reflectance say of a set under lightings of which something is known."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture.lighting import Lighting
from invrender.estimate.quantities import ReferenceScore
from invrender.estimate.reference_scale import ReferenceGauge, ReferenceScale, check_under, places_of
from invrender.transport.transfer import LightElement, diffuse_transfer, light_elements
from recon.reference import Reference

Floats = NDArray[np.float64]
Elements = Mapping[str, Sequence[LightElement]]

# A given light and a reference that differ by more deviations, and by more than this share, contradict each other.
_APART, _NOTABLE = 3.0, 0.03


@dataclass(frozen=True, eq=False)
class KnownScale:
    """The scale of a set under lightings of which something is known.

    gauge : that references fix; None where none are there, or light is given. factor : (3,), of Kd and Ks by it.
    scores : of each reference. remarks : sentences.
    """

    gauge: ReferenceGauge | None
    factor: Floats
    scores: tuple[ReferenceScore, ...]
    remarks: tuple[str, ...]


def known_scale(
    references: Sequence[Reference], strengths: Mapping[str, Floats], elements: Elements
) -> KnownScale:
    """What references say of the scale of a fit; strengths, elements : of lightings by name, (e, 3) for e elements.

    Where light is given the references are witnesses: a sentence says so if they contradict it. Raises ValueError for a
    reference on which no light falls, or under a lighting of no fitted photograph.
    """
    if not references:
        return KnownScale(None, np.ones(3), (), ())
    check_under(references, strengths)

    def per_strength(reference: Reference, normals: Floats) -> list[Floats]:
        own = elements[reference.lighting]
        return [diffuse_transfer(_at(element, reference), normals) for element in own]

    def falls(reference: Reference, normals: Floats) -> Floats:
        parts = per_strength(reference, normals)
        return np.asarray(sum(of * by for of, by in zip(parts, strengths[reference.lighting], strict=True)))

    scale = ReferenceScale.of(references, falls)
    if any(element.name == "known" for name in strengths for element in elements[name]):
        remarks = (*scale.remarks, *_contradiction(scale))
        return KnownScale(None, np.ones(3), scale.scores(np.ones(3)), remarks)

    def reached(reference: Reference) -> dict[str, Floats]:
        parts = per_strength(reference, reference.normals)
        return {
            f"{reference.lighting}/{element.name}": reference.over_shown(reference.mean(part))
            for element, part in zip(elements[reference.lighting], parts, strict=True)
        }

    gauge = ReferenceGauge(scale, tuple(map(reached, references)))
    return KnownScale(gauge, scale.factor, scale.scores(scale.factor), scale.remarks)


def given_scale(references: Sequence[Reference], lightings: Mapping[str, Lighting]) -> KnownScale:
    """What references say of lightings as they are given, by name: those that fitted photographs are under."""
    elements = {name: light_elements(lighting) for name, lighting in lightings.items()}
    ones = {name: np.ones((len(own), 3)) for name, own in elements.items()}
    return known_scale(references, ones, elements)


def _at(element: LightElement, reference: Reference) -> LightElement:
    return element.at(places_of(reference, element.directions))


def _contradiction(scale: ReferenceScale) -> list[str]:
    """A sentence if given light sends references more or less than they show; none if it doesn't."""
    off = np.abs(np.log(scale.factor))
    if not ((off > _APART * scale.own_std) & (off > _NOTABLE)).any():
        return []
    shown = ", ".join(f"{1 / of - 1:+.0%}" for of in scale.factor)
    return [
        f"By {scale.named} other light falls than is given: {shown} of it (red, green, blue), more than the reference's"
        f" own {scale.own_std.mean():.0%}. The given light was kept. Check the exposures, the light's unit, and whether"
        " something shades the reference or it glints."
    ]
