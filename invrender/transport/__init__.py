"""Transport: what a BRDF makes of light, visibility and interreflection included."""
