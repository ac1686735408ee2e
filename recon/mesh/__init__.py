"""A triangle mesh: its shape, rays to it, diffuse transfer under its shadows."""
