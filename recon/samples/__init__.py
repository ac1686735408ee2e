"""From a photo set and a shape to light-field samples."""
