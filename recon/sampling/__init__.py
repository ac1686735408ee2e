"""Light-field samples: photographs of a body to geometry and radiance."""
