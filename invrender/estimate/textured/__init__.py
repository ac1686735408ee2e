"""Reflectance that varies over a mesh: Kd and Ks as textures, under known light [RH01, section 6.4]."""
