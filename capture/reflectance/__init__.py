"""Measured BRDFs of others: what files of gonioreflectometers and BRDF databases hold."""
