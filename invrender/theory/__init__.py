"""Reflection as convolution: harmonics, transfer functions, what they imply."""
