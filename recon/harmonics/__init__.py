"""Spherical harmonics: real and complex bases, rotations, lat-long transforms."""
