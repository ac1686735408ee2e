"""Where a mesh stands in the photographs' world: from picks, from a cloud of points, from silhouettes."""
