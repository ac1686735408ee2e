"""Light prefiltered for a BRDF, as files: maps, coefficients, orders, and how far they can be off."""
