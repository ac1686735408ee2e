"""BRDFs: lobes, Fresnel's factor, and the fitted sum of a diffuse and a specular part."""
