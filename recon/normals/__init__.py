"""Normal maps: their files, and the surface that has the normals."""
