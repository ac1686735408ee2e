"""Photographs of a real object in; its reflectance, the light on it, and how certain each number is, out."""
