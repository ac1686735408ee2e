"""Colour charts: what their patches reflect, where they lie in a photograph, and a camera's colours from them."""
