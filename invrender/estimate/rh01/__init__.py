"""RH01's own procedures, as published: what ours is charted against.

There are no error bars, pixels count alike whatever their noise, and recovered light may be negative.
"""

from invrender.estimate.rh01.factors import PublishedFactors, published_factors, published_factors_direct
from invrender.estimate.rh01.known_light import PublishedBRDF, published_brdf

__all__ = [
    "PublishedBRDF",
    "PublishedFactors",
    "published_brdf",
    "published_factors",
    "published_factors_direct",
]
