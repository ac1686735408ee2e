"""Transport: what a BRDF makes of light, visibility and interreflection included.

All modules take light as a sequence of `transfer.LightElement` and samples as a `LightField`. Which to use:

- `predict`: radiance of samples from a BRDF and light, as the fits see it.
- `columns`: the same, linear in Kd, Ks and the light's strengths, for fits that search mu and sigma; `column_basis`
  says at which of these transfers are tabulated.
- `shading`: radiance with its slopes in the BRDF's numbers, for renders with error bars.
- `cached_shader`, `reflected`: radiance of very many pixels, from maps that are prepared once.
- `lobe_table`, `form_table`, `harmonic_rows`: lobes as filters of harmonic light, where light is unknown.
- `visibility`, `radiosity`: what a mesh hides from itself, and what its parts send each other.

They rest on `transfer` (RH01's lobe), `form_transfer` (any form), `half_vectors` (the integral over a map) and
`diffuse_base` (what lies under the lobe).
"""
