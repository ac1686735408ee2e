"""A plan in words and a table, for the terminal."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from rich.markup import escape
from rich.table import Table

from invrender.estimate.quantities import CAUSES, limits
from invrender.estimate.uncertainty import FINEST
from invrender.plan.advice import Advice
from invrender.plan.candidates import AddedPhoto
from invrender.plan.document import gauge
from invrender.plan.experiment import Experiment, angles_deg
from invrender.plan.light_prospect import HALF, LightProspect
from invrender.plan.planning import Plan
from invrender.plan.prospect import Expected, worth_improving
from invrender.wording import with_error

Floats = NDArray[np.float64]

QUANTITY_HEADINGS = ("quantity", "value ± expected std", "relative", "status", "limited most by")
# Of many lightings so many are printed; plan.json has them all.
_SHOWN = 3
# A photograph that leaves more than this of the worst quantity's standard deviation isn't worth its while.
_LITTLE = 0.95


def quantity_table(plan: Plan) -> Table:
    """Quantity, truth, expected standard deviation, status, what limits it; of many lightings' the worst off."""
    table = Table(
        *QUANTITY_HEADINGS, title=f"{escape(plan.experiment.name)}: what will be known", title_justify="left"
    )
    for row in quantity_rows(plan):
        table.add_row(*map(escape, row))
    return table


def quantity_rows(plan: Plan) -> list[tuple[str, ...]]:
    """The cells of that table, by `QUANTITY_HEADINGS`."""
    return [
        (
            one.label,
            _with_std(one),
            "" if one.is_direction else _share(one.relative),
            one.quantity.status,
            limits(one.shares, most=2),
        )
        for one in shown_quantities(plan)
    ]


def shown_quantities(plan: Plan) -> list[Expected]:
    """The BRDF's quantities and those of the lightings, if these are many of the worst off."""
    own = [one for one in plan.expected if "/" not in one.name]
    of_light = [one for one in plan.expected if "/" in one.name]
    lightings = list(dict.fromkeys(one.name.split("/")[0] for one in of_light))
    if len(lightings) > _SHOWN:
        worst = max(of_light, key=lambda one: one.rank).name.split("/")[0]
        of_light = [one for one in of_light if one.name.split("/")[0] == worst]
    return own + of_light


def sentences(plan: Plan, advice: Advice) -> Iterator[str]:
    """All that is to be said beneath the table."""
    experiment = plan.experiment
    count = len(experiment.views)
    yield (
        f"{count} photograph{'s' * (count > 1)}, of which `process` would take {plan.fit_samples} pixels."
        f" Scale: {gauge(experiment)}."
    )
    yield (
        f"In the deviations is what `process` always counts, {FINEST:.3%} of Kd + Ks, of mu, sigma and of the light,"
        " beside the noise."
    )
    if experiment.gauge_light is not None and experiment.brdf.sigma is None:
        yield "A matte object in unknown light shows only the products of Kd and light: Kd itself stays open."
    for reason, remedy in dict.fromkeys(
        (one.quantity.reason, one.quantity.remedy) for one in plan.expected if one.quantity.reason
    ):
        labels = ", ".join(one.label for one in plan.expected if one.quantity.reason == reason)
        yield f"{labels}: {reason}. To settle it: {remedy}."
    for prospect in plan.lights[:_SHOWN]:
        yield _light_sentence(prospect)
    if plan.lights:
        yield from _light_cautions(plan)
    yield from _close_sources(experiment)
    if len(plan.lights) > _SHOWN:
        yield f"So for {len(plan.lights) - _SHOWN} lightings more; the table shows the one that is worst off."
    yield from _advice_sentences(plan, advice)
    yield from _calibration_sentences(plan)
    for note in experiment.notes:
        yield f"Note: {note}."
    if count * experiment.sensor.exposures == 1:
        yield "Note: `process` fits two photographs or more, so that one can judge the fit to the other."


def _light_sentence(prospect: LightProspect) -> str:
    count = (prospect.l_max + 1) ** 2
    lacking = [l for l, share in enumerate(prospect.shares) if share < HALF]
    highest = prospect.highest
    how_far = f"determined up to degree {highest}" if highest >= 0 else "undetermined from degree 0 on"
    if highest == prospect.l_max:
        how_far += ", the highest asked for"
    rest = f", undetermined in degree{'s' * (len(lacking) > 1)} {_ranges(lacking)}" if lacking else ""
    return (
        f"Light {prospect.name!r} is {how_far}{rest}: {prospect.effective_rank:.0f} of {count} coefficients per"
        f" channel. Mirrored rays look at {prospect.reached:.0%} of all directions."
    )


def _light_cautions(plan: Plan) -> Iterator[str]:
    """What is taken for granted of unknown light, and what of it a real object would not show."""
    highest = max(prospect.l_max for prospect in plan.lights)
    yield (
        f"All this takes it that unknown light has nothing above degree {highest}, its sources apart: a higher --degree"
        " shows what light with more detail would leave of it."
    )
    if plan.experiment.brdf.sigma is None:
        yield (
            "Of degrees above 2 a matte object shows traces, less than 1% of the light's energy: errors of the model"
            " that no noise stands for drown them."
        )


def _close_sources(experiment: Experiment) -> Iterator[str]:
    """What to beware of where sources of unknown light are nearer than the lobe is wide, twice sigma."""
    lobe = 2 * (experiment.brdf.sigma or 0.0)
    for light in experiment.lights:
        directions = light.lighting.directions
        for (i, one), (j, other) in combinations(enumerate(directions, 1), 2):
            apart = float(np.arccos(np.clip(one @ other, -1, 1)))
            if not light.known and apart < lobe:
                yield (
                    f"Sources {i} and {j} of {light.lighting.name!r} are {np.degrees(apart):.1f} degrees apart and the"
                    f" lobe {np.degrees(lobe):.1f} wide: they look like one, and what is said of them holds only for a"
                    " fit that is given both."
                )


def _ranges(numbers: Sequence[int]) -> str:
    """Rising numbers, runs of them as 3 to 7."""
    runs: list[list[int]] = []
    for number in numbers:
        if runs and number == runs[-1][-1] + 1:
            runs[-1].append(number)
        else:
            runs.append([number])
    return ", ".join(str(run[0]) if len(run) == 1 else f"{run[0]} to {run[-1]}" for run in runs)


def _advice_sentences(plan: Plan, advice: Advice) -> Iterator[str]:
    target = advice.target
    trials = (("view", advice.view), ("lamp", advice.lamp))
    helps = any(_helps(plan, target, trial.best) for _, trial in trials)
    if target.quantity.status != "undetermined" and not helps:
        twice = _outcome(_named(plan.repeated, target.name))
        yield (
            f"Most is to be gained for {target.label}, {_outcome(target)}, and that is little: no single photograph"
            f" more makes a difference, and all of them taken twice bring {twice}."
        )
        return
    yield f"Worst off is {target.label}: {_outcome(target)}. What more photographs would make of it:"
    yield f"- Every photograph taken twice: {_outcome(_named(plan.repeated, target.name))}."
    for kind, trial in trials:
        best, above = trial.best, trial.best_above
        if not _helps(plan, target, best):
            after = best.named(target.name)
            settles = (
                "settles it"
                if after.quantity.status == "undetermined"
                else f"helps: {_outcome(after)} at best"
            )
            yield f"- No single {kind} more {settles}."
            continue
        text = f"- One {kind} more, {_place(plan, best)}: {_brings(plan, target, best)}."
        if not best.place.above_horizon and above.place.above_horizon and _helps(plan, target, above):
            text += f" Above the horizon, {_where(above)}: {_brings(plan, target, above)}."
        yield text


def _calibration_sentences(plan: Plan) -> Iterator[str]:
    """Which calibration is worth improving, of those whose errors the scene states."""
    ranked = worth_improving(plan.expected)
    if not ranked:
        return
    cause, gain = ranked[0]
    if gain < 1 / _LITTLE:
        yield (
            "No calibration is worth improving: twice as sure as [uncertainty] says, none makes a notable difference."
        )
        return
    improved = [
        f"{one.label} {_bar(one, one.improved(cause))} in place of {_bar(one, one.std)}"
        for one in plan.expected
        if one.causes
        and one.quantity.status != "undetermined"
        and float(np.min(one.improved(cause) / one.std)) < _LITTLE
    ]
    yield f"Worth improving first: {CAUSES[cause]}. Twice as sure, they leave {'; '.join(improved)}."


def _helps(plan: Plan, target: Expected, candidate: AddedPhoto) -> bool:
    """Whether a candidate settles something, or makes the target's deviation notably smaller."""
    now = sum(one.quantity.status == "undetermined" for one in plan.expected)
    left, _ = candidate.score(target.name)
    after = candidate.named(target.name)
    return left < now or (
        after.quantity.status != "undetermined" and after.relative < _LITTLE * target.relative
    )


def _where(candidate: AddedPhoto) -> str:
    azimuth, elevation = angles_deg(candidate.place.direction)
    return f"azimuth {azimuth:.0f}, elevation {elevation:.0f} degrees"


def _place(plan: Plan, candidate: AddedPhoto) -> str:
    experiment = plan.experiment
    lighting = experiment.lights[candidate.place.view.light].lighting.name
    if candidate.irradiance is None:
        return f"from {_where(candidate)}, {experiment.distance:.2g} m away, under {lighting!r}"
    strength = ", ".join(f"{value:.2g}" for value in candidate.irradiance)
    return (
        f"small, in addition to {lighting!r}, towards {_where(candidate)}, of irradiance [{strength}], photographed"
        f" from where photograph {candidate.place.view.name} is"
    )


def _brings(plan: Plan, target: Expected, candidate: AddedPhoto) -> str:
    """What a candidate does to the target, and which other quantities it settles."""
    text = _outcome(candidate.named(target.name))
    pairs = list(zip(plan.expected, candidate.expected, strict=True))
    settled = [
        one.label
        for one, then in pairs
        if one.quantity.status == "undetermined" != then.quantity.status and one.name != target.name
    ]
    still = [
        then.label for _, then in pairs if then.quantity.status == "undetermined" and then.name != target.name
    ]
    if settled and candidate.named(target.name).quantity.status == "undetermined":
        text = f"leaves it undetermined, but settles {', '.join(settled)}"
    elif settled:
        text += f"; it settles {', '.join(settled)} too"
    if still:
        text += f"; {', '.join(still)} stay{'s' * (len(still) == 1)} undetermined"
    return text


def _named(expected: Sequence[Expected], name: str) -> Expected:
    return next(one for one in expected if one.name == name)


def _outcome(one: Expected) -> str:
    """How well a quantity will be known, or that it won't."""
    if one.quantity.status == "undetermined":
        return "undetermined"
    text = _with_std(one) if one.is_direction else _bar(one, one.std)
    return f"{text}, weak" if one.quantity.status == "weak" else text


def _bar(one: Expected, std: Floats) -> str:
    """The largest of a quantity's standard deviations (k,), as a number and as a share; of a direction in degrees."""
    if one.is_direction:
        return f"± {np.degrees(std[0]):.2g} degrees"
    worst = int(np.argmax(std / one.size))
    return f"± {std[worst]:.2g} ({_share(float(std[worst] / one.size[worst]))})"


def _share(relative: float) -> str:
    return f"{relative:.2%}" if relative < 0.1 else f"{relative:.0%}"


def _with_std(one: Expected) -> str:
    if one.is_direction:
        return f"± {np.degrees(one.std[0]):.2g} degrees"
    texts = [with_error(value, std) for value, std in zip(one.truth, one.std, strict=True)]
    return texts[0] if len(set(texts)) == 1 else "\n".join(texts)
