"""From calibrated photographs and a shape to light-field samples."""
