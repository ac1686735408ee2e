"""New views and new light of a result: `lightfactor render`."""
