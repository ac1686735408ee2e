"""`lightfactor factor`: light and BRDF from the same photographs, whatever the set says of the light."""
