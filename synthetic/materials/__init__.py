"""What surfaces are made of: BRDFs, their parameters and textures."""
