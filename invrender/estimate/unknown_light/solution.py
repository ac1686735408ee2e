"""What factorization under wholly unknown lighting hands on, and the radiance that it predicts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from dataclasses import field as defaulted

import numpy as np
from numpy.typing import NDArray

from capture.lighting import Lighting, cosines, seen_from
from invrender.brdf.form import Angles, LobeForm, part_width
from invrender.brdf.fresnel import normalised_fresnel
from invrender.brdf.lobes import RH01_FORM
from invrender.brdf.microfacet import Microfacet
from invrender.estimate.noise import NoiseModel, Weights
from invrender.estimate.quantities import Quantity
from invrender.estimate.unknown_light.cross_validation import BlindCandidate
from invrender.estimate.unknown_light.identifiability import quantities_of
from invrender.estimate.unknown_light.lamp_frame import LampFrame
from invrender.estimate.unknown_light.lighting_design import LightingDesign, pooled
from invrender.estimate.unknown_light.projection import BlindFit, light_scale
from invrender.estimate.unknown_light.start import Search
from invrender.estimate.unknown_light.uncertainty import BlindUncertainty
from invrender.transport.diffuse_base import interface_transmittance, sky_factors
from invrender.transport.form_table import form_radiance
from invrender.transport.lobe_table import Transfer, specular_radiance
from invrender.transport.visibility import Shadows
from recon.harmonics.basis import degree_of, evaluate_harmonics
from recon.harmonics.complex import project_sources
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]

GAUGE = (
    "no light is known, so the overall scale of light against reflectance is free in each channel: Kd + Ks = 1 in each,"
    " and lighting is in units of the photographs over that"
)


@dataclass(frozen=True, eq=False)
class BlindSources:
    """Sources: directions (k, 3) unit, irradiances (k, 3) and their standard deviations, as `centre` sees them.

    direction_std_deg : (k,) degrees, along the worse of two ways. closeness, closeness_std : (k,), 1 / metres, 0 of
    sources far away; None where all are. centre : (3,) metres, of the object.
    """

    directions: Floats
    irradiances: Floats
    irradiance_std: Floats
    direction_std_deg: Floats
    closeness: Floats | None = None
    closeness_std: Floats | None = None
    centre: Floats = defaulted(default_factory=lambda: np.zeros(3))

    @property
    def lighting(self) -> Lighting:
        """Nothing but the sources, with strengths to be recovered."""
        return Lighting(
            "sources",
            None,
            self.directions,
            np.maximum(self.irradiances, 0),
            recover_irradiance=True,
            direction_std_deg=self.direction_std_deg,
            closeness=self.closeness,
            closeness_std=self.closeness_std,
            centre=self.centre,
        )


@dataclass(frozen=True, eq=False)
class BlindLight:
    """One recovered lighting, in the solution's gauge.

    coefficients, coefficients_std : ((l_max + 1)^2, 3), of the light without its sources, at index l*l + l + m.
    sources : those found. degree_shares : (l_max + 1,), mean share of what is known of a coefficient that comes from
    the photographs. determined_degree : the degree up to which these, not the prior, determine it; -1 if not even the
    mean. doubt : why degrees of it aren't determined, and what would help; None if all are.
    """

    coefficients: Floats
    coefficients_std: Floats
    sources: BlindSources
    degree_shares: Floats
    determined_degree: int
    doubt: Quantity | None

    @property
    def normalised_coefficients(self) -> Floats:
        """The whole light's coefficients ((l_max + 1)^2, 3), sources included, over those of degree 0."""
        total, sources = self.coefficients, self.sources
        if len(sources.directions):
            l_max = degree_of(len(total))
            total = total + project_sources(sources.directions, sources.irradiances, l_max)
        return np.asarray(total / total[0])

    @property
    def numbers(self) -> tuple[Floats, Floats]:
        """Coefficients and then the sources' irradiances, (p, 3), and their standard deviations."""
        sources = self.sources
        return (
            np.vstack([self.coefficients, sources.irradiances]),
            np.vstack([self.coefficients_std, sources.irradiance_std]),
        )

    def with_std(self, std: Floats) -> BlindLight:
        """The same light with other standard deviations (p, 3) of its `numbers`."""
        size = len(self.coefficients)
        sources = replace(self.sources, irradiance_std=std[size:])
        return replace(self, coefficients_std=std[:size], sources=sources)

    def times(self, scale: Floats) -> BlindLight:
        """The same light, brighter by factors (3,)."""
        sources = replace(
            self.sources,
            irradiances=self.sources.irradiances * scale,
            irradiance_std=self.sources.irradiance_std * scale,
        )
        coefficients, std = self.coefficients * scale, self.coefficients_std * scale
        return replace(self, coefficients=coefficients, coefficients_std=std, sources=sources)


@dataclass(frozen=True, eq=False)
class BlindSolution:
    """BRDF and lightings of a homogeneous body, up to a scale per channel (`gauge`).

    model : name of the chosen candidate. brdf_share : (3,) specular share s = Ks / (Kd + Ks). mu, sigma : None where
    the model lacks them; sigma in radians. form : of the lobe. lights : by name, in the order in which photographs
    first name them. quantities : "kd_normalised", "ks_normalised", "mu", "sigma". covariance, covariance_names : of the
    shares, mu, sigma and the sources' turns (radians). candidates, chosen : the ladder. noise, weights : as in `noise`,
    weights per photograph. transfer : of the lobe, that the fit went by.
    """

    model: str
    brdf_share: Floats
    mu: float | None
    sigma: float | None
    form: LobeForm
    lights: Mapping[str, BlindLight]
    quantities: Mapping[str, Quantity]
    covariance: Floats
    covariance_names: tuple[str, ...]
    candidates: tuple[BlindCandidate, ...]
    chosen: int
    noise: NoiseModel
    weights: tuple[Weights, ...]
    gauge: str
    warnings: tuple[str, ...]
    certainty: BlindUncertainty
    transfer: Transfer = "exact"

    @property
    def l_max(self) -> int:
        """Degree of the lightings."""
        return self.candidates[self.chosen].fit.l_max

    @property
    def light(self) -> BlindLight:
        """The only lighting; raises ValueError where there are several."""
        if len(self.lights) > 1:
            raise ValueError(f"there are {len(self.lights)} lightings; name one of {', '.join(self.lights)}")
        return next(iter(self.lights.values()))


def sources_of(fit: BlindFit, certainty: BlindUncertainty, lighting: int, frame: LampFrame) -> BlindSources:
    """The sources of one lighting of a fit, by its number."""
    size, own = (fit.l_max + 1) ** 2, fit.state.owners == lighting
    closeness = closeness_std = None
    if fit.state.under(lighting).near:
        closeness = fit.state.sources[own, 3] / frame.radius
        closeness_std = certainty.closeness_std(fit.state)[own] / frame.radius
    return BlindSources(
        fit.state.directions[own],
        fit.light[lighting][size:],
        certainty.light_std[lighting][size:],
        certainty.directions_std_deg(fit.state)[own],
        closeness,
        closeness_std,
        frame.centre,
    )


def with_certainty(
    solution: BlindSolution, certainty: BlindUncertainty, designs: Sequence[LightingDesign]
) -> BlindSolution:
    """A solution with other standard deviations; designs : of its samples, or some of them."""
    fit = solution.candidates[solution.chosen].fit
    lights = {}
    for number, (name, light) in enumerate(solution.lights.items()):
        size, std = len(light.coefficients), certainty.light_std[number]
        sources = sources_of(fit, certainty, number, designs[0].frame)
        lights[name] = replace(light, coefficients_std=std[:size], sources=sources)
    return replace(
        solution,
        lights=lights,
        quantities=quantities_of(fit, certainty, designs),
        covariance=certainty.covariance,
        certainty=certainty,
    )


def weighed_search(
    solution: BlindSolution,
    photos: Sequence[LightField],
    lighting_of: Sequence[str],
    shadows: Shadows | None,
) -> Search:
    """Photographs weighed as a solution has them; prepared for uniform light."""
    numbers = [list(solution.lights).index(name) for name in lighting_of]
    together, designs = pooled(photos, numbers, solution.transfer, shadows)
    weights, trust = (
        [np.concatenate([getattr(solution.weights[k], name) for k in pool]) for pool in together]
        for name in ("weight", "trust")
    )
    return Search(designs, weights, trust, light_scale(designs))


def predict_blind(
    solution: BlindSolution,
    field: LightField,
    light: BlindLight | None = None,
    shadows: Shadows | None = None,
) -> Floats:
    """Radiance (n, 3) of a photograph's samples in a recovered light (the only one if None), in photographs' units.

    shadows : of a mesh on itself, if it has any.
    """
    base, lobe = predict_parts(solution, field, light, shadows)
    return base + lobe


def predict_parts(
    solution: BlindSolution,
    field: LightField,
    light: BlindLight | None = None,
    shadows: Shadows | None = None,
) -> tuple[Floats, Floats]:
    """`predict_blind` in two parts, (n, 3) each: what the base sends, and the lobe."""
    state = solution.candidates[solution.chosen].fit.state
    light = solution.light if light is None else light
    sources = light.sources.lighting.sources
    directions, factors = seen_from(sources, field.positions)
    strengths = light.sources.irradiances
    exitant = np.clip(np.einsum("nk,nk->n", field.normals, field.views), 0, 1)
    falling = np.clip(cosines(field.normals, directions), 0, 1)
    total, lobe = sky_parts(state.brdf, light.coefficients, field, shadows, solution.transfer)
    lit = np.broadcast_to(factors, falling.shape)
    if shadows is not None:
        lit = lit * np.transpose([shadows.lit(field, source) for source in sources]).reshape(lit.shape)
    falling = falling * interface_transmittance(state.form, state.mu, falling) * lit
    total += interface_transmittance(state.form, state.mu, exitant)[:, None] * (falling @ strengths)
    if state.sigma is not None:
        for direction, strength, seen in zip(np.moveaxis(directions, -2, 0), strengths, lit.T, strict=True):
            angles = Angles.between(field.normals, direction, field.views)
            highlight = field.filtered(state.form.reflected(angles, state.mu, state.sigma) * seen)
            lobe += highlight[:, None] * strength
    return np.asarray(field.mean_over_rays((1 - state.specular_share) * total)), np.asarray(
        field.mean_over_rays(state.specular_share * lobe)
    )


def sky_parts(
    brdf: Microfacet, lighting: Floats, field: LightField, shadows: Shadows | None, transfer: Transfer
) -> tuple[Floats, Floats]:
    """What rays (m, 3) reflect of harmonic light ((l_max + 1)^2, 3) per unit of Kd, and of Ks, through filters."""
    exitant, l_max = np.clip(field.ray_cosines, 0, 1), degree_of(len(lighting))
    passed = sky_factors(brdf.form, brdf.mu, l_max)
    base = evaluate_harmonics(field.normals, l_max) @ (passed[:, None] * lighting)
    if shadows is not None:
        base = base - shadows.hidden(field, lighting)
    base = base * interface_transmittance(brdf.form, brdf.mu, exitant)[:, None]
    if brdf.sigma is None:
        return base, np.zeros_like(base)
    lobe = field.filtered(_reflected(brdf, brdf.sigma, field, lighting, transfer))
    return base, lobe if shadows is None else lobe * field.reflected_visible[:, None]


def _reflected(
    brdf: Microfacet, sigma: float, field: LightField, lighting: Floats, transfer: Transfer
) -> Floats:
    """What each ray (m, 3) sees of harmonic light in the lobe, per unit of Ks."""
    if brdf.form is not RH01_FORM:
        return np.asarray(
            sum(
                share
                * form_radiance(field, lighting, brdf.form.lobe, brdf.mu, float(part_width(factor, sigma)))
                for share, factor in brdf.form.parts
            )
        )
    cos = np.einsum("nk,nk->n", field.normals, field.views)
    return normalised_fresnel(brdf.mu, cos)[:, None] * specular_radiance(field, lighting, sigma, transfer)
