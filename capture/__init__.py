"""From the shutter to linear radiance: photo sets, cameras, decoding, known lighting."""
