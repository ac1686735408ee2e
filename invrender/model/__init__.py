"""The model of the reflected light field: BRDF, transfer of lighting, prediction."""
