"""What users should know of a fit under unknown light, in sentences: lamps that may be two, elsewhere, or no points.

And what hinges on the form of the lobe.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from capture.wording import some_of
from invrender.estimate.unknown_light.cross_validation import photo_counts
from invrender.estimate.unknown_light.projection import BlindFit
from invrender.estimate.unknown_light.source_ambiguity import SourceAmbiguity
from invrender.estimate.unknown_light.start import Search
from invrender.estimate.unknown_light.uncertainty import BlindUncertainty

# Of highlights, what may be left unexplained before a warning is due.
_NOTABLE_MISFIT = 0.05
# Lamps that are named one by one where they look wide; more of them have one warning.
_FEW = 3


def remarks(
    search: Search,
    fit: BlindFit,
    split: BlindFit | None,
    certainty: BlindUncertainty,
    sides: SourceAmbiguity | None,
    names: Sequence[str],
) -> tuple[str, ...]:
    """Warnings, each of them with what would help; split : as of `with_seconds`. names : of the lightings."""
    return (
        *_of_regions(search, fit, names),
        *_of_split(split, fit, names),
        *_of_sides(sides, names),
        *_of_widths(certainty, fit, names),
        *_of_rivals(certainty, fit),
        *_of_lonely(search, fit, names),
    )


def _of_regions(search: Search, fit: BlindFit, names: Sequence[str]) -> tuple[str, ...]:
    empty = [repr(names[number]) for number in sorted(search.regions) if number not in fit.state.owners]
    if not empty:
        return ()
    return (
        f"no lamp was found in the source region of lighting {some_of(empty)}, and none was looked for elsewhere: its"
        " light is taken to be without lamps. If that is wrong, make the region larger, or remove it",
    )


def _of_split(split: BlindFit | None, fit: BlindFit, names: Sequence[str]) -> tuple[str, ...]:
    if split is None:
        return ()
    state, warnings = split.state, []
    for number in range(len(names)):
        ways = state.under(number).directions
        if len(ways) > len(fit.state.under(number).directions):
            near = ", ".join(f"{x:.2f}" for x in ways[-1])
            where = f" in lighting {names[number]!r}" if len(names) > 1 else ""
            warnings.append(
                f"light near ({near}){where} looks like a second source, but is nearer to another than the lobe is wide"
                f" ({np.degrees(state.sigma or 0):.1f} degrees): the two are treated as one"
            )
    return tuple(warnings)


def _of_sides(sides: SourceAmbiguity | None, names: Sequence[str]) -> tuple[str, ...]:
    if sides is None:
        return ()
    state, warnings = sides.fit.state, []
    for index in np.flatnonzero(sides.open).tolist():
        near = ", ".join(f"{x:.2f}" for x in state.directions[index])
        where = f" in lighting {names[state.owners[index]]!r}" if len(names) > 1 else ""
        warnings.append(
            f"the lamp near ({near}){where} may as well be on the opposite side: a Lambertian object shows both alike"
            " where other light makes up for the difference (RH01, section 5.1), so its direction is undetermined;"
            " photograph a glossier object, or a mirror ball, under the same light"
        )
    return tuple(warnings)


def _of_widths(certainty: BlindUncertainty, fit: BlindFit, names: Sequence[str]) -> tuple[str, ...]:
    warnings = []
    wide = np.flatnonzero(certainty.radii)
    if len(wide) > _FEW:
        least, most = np.degrees([certainty.radii[wide].min(), certainty.radii.max()])
        warnings.append(
            f"{len(wide)} lamps are no points: they look like discs of {least:.1f} to {most:.1f} degrees' radius, or"
            " the material is none of the models; error bars are widened by what such a width changes"
        )
    for index in wide.tolist() if len(wide) <= _FEW else []:
        near = ", ".join(f"{x:.2f}" for x in fit.state.directions[index])
        where = f" in lighting {names[fit.state.owners[index]]!r}" if len(names) > 1 else ""
        warnings.append(
            f"the lamp near ({near}){where} is no point: it looks like a disc of"
            f" {np.degrees(certainty.radii[index]):.1f} degrees' radius, or the material is none of the models; error"
            " bars are widened by what such a width changes"
        )
    if certainty.misfit >= _NOTABLE_MISFIT:
        warnings.append(
            f"{certainty.misfit:.0%} of the lamps' highlights is left unexplained, more than noise is: windows and"
            " lamps that are no points look like a wider lobe (sigma is then too large), and so does another material;"
            " error bars are widened by as much. Measure the light, or photograph under a smaller lamp"
        )
    return tuple(warnings)


def _of_rivals(certainty: BlindUncertainty, fit: BlindFit) -> tuple[str, ...]:
    if not certainty.other_mu or fit.state.mu is None:
        return ()
    others = " and ".join(f"{name} ({mu:.3f})" for name, mu in certainty.other_mu.items())
    return (
        f"mu hinges on the form of the lobe: {others} explains the photographs as well as {fit.state.form.name}"
        f" ({fit.state.mu:.3f}) does; error bars are widened by as much",
    )


def _of_lonely(search: Search, fit: BlindFit, names: Sequence[str]) -> tuple[str, ...]:
    """A warning where lightings of more than uniform light have one photograph each."""
    counts = photo_counts(search.designs)
    lonely = [repr(names[number]) for number in sorted(counts) if counts[number] == 1]
    if not lonely or not fit.l_max:
        return ()
    some = some_of(lonely)
    return (
        f"a single photograph was taken under lighting {some}: its light takes up whatever the BRDF's formula does not"
        " explain, which the error bars don't hold; add a photograph from another side, or write dark = true if there"
        " were lamps only",
    )
