"""Which of the candidates explains what a fit leaves, by evidence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.microfacet import Microfacet
from invrender.diagnostics.cause import CauseFit
from invrender.diagnostics.causefit import fit_cause, glance
from invrender.diagnostics.causes import candidates, no_cause
from invrender.diagnostics.linearised import light_columns
from invrender.diagnostics.remainder import Remainders, noise_energy
from invrender.estimate.evidence import of_rival

Floats = NDArray[np.float64]

# Of what is left beyond noise, the share that a cause must explain to be named, and by how much more than one of fewer
# numbers to be preferred to it.
_NAMED, _MORE = 0.4, 0.05
# Of what the best candidate explains to the first order, the share from which on another is looked at closely.
_LIKELY = 0.5
# Share that a cause which is linear must explain for none to be looked at closely.
_SETTLED = 0.95
# Of all that was left beyond noise, the share that must remain for a further cause to be looked for.
_REMAINS = 0.1
# What must be left beyond noise (RMS) to ask for a cause: of the radiance, and of the noise.
_NOTABLE, _OF_NOISE = 0.005, 0.5
# Logarithm of the ratio of widths from which on highlights are drawn out.
_LEAST_STRETCH = 0.15
# Causes that are no property of the surface, and move what is found of it.
_FAULTS = frozenset({"near lamp", "curve", "offset", "place", "brightness", "direction", "pose"})
# Causes that are named one after the other, each for what those before leave.
_MOST = 2


@dataclass(frozen=True, eq=False)
class Finding:
    """A cause that explains much of what is left.

    share : of what is left beyond noise, 0 to 1, in samples that its fit hasn't seen. alike : names of causes that
    explain about as much. photo : place of the photograph that shows it best. without : the BRDF that fits best without
    the cause.
    """

    fit: CauseFit
    share: float
    alike: tuple[str, ...]
    photo: int
    without: Microfacet

    def instead(self, brdf: Microfacet) -> Microfacet:
        """What a BRDF that was fitted without a fault of the photographs would be with it.

        The same where the cause is the surface's own: its forms and patches are in the error bars already. Photographs
        that differ in brightness don't determine which of them is right. Where the surface explains as much as a fault,
        each is as likely, and the BRDF moves by the RMS of both.
        """
        name, (within, without) = self.fit.cause.name, (self.fit.best, self.without)
        part = 1.0 if _FAULTS.issuperset(self.alike) else of_rival(1.0)
        if name == "brightness":
            scale = 1 + part * float(np.std(self.fit.numbers))
            return replace(brdf, kd=scale * brdf.kd, ks=scale * brdf.ks)
        if name not in _FAULTS:
            return brdf
        kd = np.maximum(brdf.kd + part * (within.kd - without.kd), 0)
        ks = np.maximum(brdf.ks + part * (within.ks - without.ks), 0)
        moved = replace(brdf, kd=kd, ks=ks)
        if brdf.sigma is not None and within.sigma is not None and without.sigma is not None:
            moved = replace(moved, sigma=brdf.sigma * (within.sigma / without.sigma) ** part)
        if brdf.mu is not None and within.mu is not None and without.mu is not None:
            moved = replace(moved, mu=1 + (brdf.mu - 1) * ((within.mu - 1) / (without.mu - 1)) ** part)
        return moved


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What a fit leaves beyond noise, and why.

    unexplained : relative RMS, samples counting as in the fit. findings : the best first; none where nothing stands
    out. shares : of each candidate, by its name. scene : what the findings are about.
    """

    scene: Remainders
    unexplained: float
    findings: tuple[Finding, ...]
    shares: dict[str, float]


def lamp_distance(diagnosis: Diagnosis) -> float | None:
    """How far from the object's centre its lamps seem to be, metres; None where they aren't the first cause."""
    fit = diagnosis.findings[0].fit
    return diagnosis.scene.radius / float(fit.numbers[0]) if fit.cause.name == "near lamp" else None


def diagnose(scene: Remainders, in_any_case: bool = False) -> Diagnosis | None:
    """Why photographs aren't what the fit predicts; None where they are, to the noise.

    in_any_case : whether to look for causes of however little.
    """
    total = sum(float((p.weight * p.field.radiance**2).sum()) for p in scene.photos)

    def beyond_noise(energy: Floats, noise: Floats) -> tuple[float, bool]:
        """What is left beyond noise, RMS relative to the radiance, and whether it asks for a cause."""
        left = float(np.sqrt(max((energy - noise).sum(), 0) / total))
        return left, left > max(_NOTABLE, _OF_NOISE * float(np.sqrt(noise.sum() / total)))

    as_fitted = tuple(photo.residual for photo in scene.photos)
    energy = [(p.weight * p.residual**2).sum() for p in scene.photos]
    if not in_any_case and not beyond_noise(np.array(energy), _noise(scene, as_fitted))[1]:
        return None
    findings: list[Finding] = []
    shares: dict[str, float] = {}
    unexplained, rest = 0.0, scene
    for _ in range(_MOST):
        base = fit_cause(rest, no_cause(rest), light_columns(rest), (rest.few, light_columns(rest.few)))
        noise = _noise(rest, base.left)
        beyond = base.energy - noise
        left, notable = beyond_noise(base.energy, noise)
        if not findings:
            unexplained = left
            if not notable and not (in_any_case and beyond.sum() > 0):
                return None
        elif not notable or left**2 < _REMAINS * unexplained**2:
            break
        rest = replace(rest, brdf=base.brdf)
        fits = _fits(rest, base, float(beyond.sum()))
        explained = {fit.cause.name: float((base.energy - fit.energy).sum() / beyond.sum()) for fit in fits}
        shares = shares or explained
        found = _best(fits, explained, base)
        if found is None:
            break
        findings.append(found)
        rest = replace(rest, brdf=found.fit.brdf).less(found.fit.pattern)
    return Diagnosis(scene, unexplained, tuple(findings), shares)


def _fits(scene: Remainders, base: CauseFit, beyond: float) -> list[CauseFit]:
    """All candidates; of those that the prediction isn't linear in, the likely ones as they fit best.

    beyond : weighted squares that are left beyond noise.
    """
    light, few = light_columns(scene), scene.few
    quick = few, light_columns(few)
    glances = [glance(scene, cause, light) for cause in candidates(scene)]
    gains = [float((base.energy - fit.energy).sum()) for fit in glances]
    if glances[int(np.argmax(gains))].cause.columns is not None and max(gains) > _SETTLED * beyond:
        return glances
    found = []
    for fit, gain in zip(glances, gains, strict=True):
        curved = fit.cause.columns is None and gain >= _LIKELY * max(gains)
        found.append(fit_cause(scene, fit.cause, light, quick) if curved else fit)
    return found


def _noise(scene: Remainders, left: Sequence[Floats]) -> Floats:
    """Weighted squares (photos,) that noise alone leaves of residuals (n, 3) per photograph."""
    pairs = zip(scene.photos, left, strict=True)
    return np.array([noise_energy(photo.field, own * np.sqrt(photo.weight)) for photo, own in pairs])


def _best(fits: Sequence[CauseFit], shares: dict[str, float], base: CauseFit) -> Finding | None:
    """The cause of the fewest numbers that explains nearly as much as the best; None if none explains enough."""
    possible = [fit for fit in fits if _credible(fit)]
    most = max(shares[fit.cause.name] for fit in possible)
    good = [fit for fit in possible if shares[fit.cause.name] >= max(most - _MORE, _NAMED)]
    if not good:
        return None
    fit = min(good, key=lambda one: (one.cause.count, -shares[one.cause.name]))
    alike = tuple(other.cause.name for other in good if other is not fit)
    gains = base.energy - fit.energy
    return Finding(fit, min(shares[fit.cause.name], 1.0), alike, int(gains.argmax()), base.best)


def _credible(fit: CauseFit) -> bool:
    """Whether a cause's number can be what it stands for: no lamp beyond infinity, no metal brushed hardly at all."""
    if fit.cause.name == "near lamp":
        return bool(fit.numbers[0] > 0)
    return not fit.cause.name.startswith("brushed") or bool(abs(fit.numbers[0]) > _LEAST_STRETCH)
