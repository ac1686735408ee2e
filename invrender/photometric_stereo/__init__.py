"""Photometric stereo: normals, albedo and the shared lobe from one camera's photographs under many lamps."""
