"""Two results side by side, or a result beside the truth: `lightfactor compare`."""
