"""A mesh from silhouettes alone, where nobody scanned the object."""
