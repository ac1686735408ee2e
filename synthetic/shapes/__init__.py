"""Surfaces: a sphere, a cat sculpture, a turned doll, meshes."""
