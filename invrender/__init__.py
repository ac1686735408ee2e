"""From light-field samples to reflectance, lighting and their uncertainty."""
