"""Camera intrinsics from photographs of boards."""
